"""Deviation and colour of the sensors' noise, from fourth differences of what is measured: no model of the plant.

A fourth difference over s rows takes away all that is slow. Of first-order autoregressive noise of variance σ² and
correlation ρ from row to row it has the variance σ² (70 − 112 ρˢ + 56 ρ²ˢ − 16 ρ³ˢ + 2 ρ⁴ˢ); two spacings give both. A
third spacing, between them, distinguishes such noise from fast motion, as of a loop that hunts over a coarse count: the
variance of autoregressive noise rises most at small s, that of a smooth motion rises with s⁸ at first.
Variances are taken from medians, so that breaks of a load and the ringing behind them have no say, and only where the
motor hardly accelerates.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import optimize
from scipy.ndimage import uniform_filter1d

from hil_forceps.data.run import Run
from hil_forceps.diagnosis.preparation.command import commands_on_lines, first_integral, samples_in_a_row
from hil_forceps.diagnosis.preparation.resolution import resolution_of
from hil_forceps.diagnosis.state_space.drive.unseen_counts import VISIBLE_COUNT_DEVIATIONS, count_current_A
from hil_forceps.diagnosis.state_space.layout import Noise
from hil_forceps.model.drive_law import law_vector
from hil_forceps.rig import Rig

Vector = NDArray[np.float64]

NEAR_ROWS, MIDDLE_ROWS, FAR_ROWS = 1, 2, 12  # rows between the values of a difference
BINOMIAL = (1.0, -4.0, 6.0, -4.0, 1.0)
MEDIAN_OF_SQUARE = 0.4549364  # of a unit Gaussian: median of χ² with one degree of freedom
COLOUR_DEVIATIONS = (
    5.0  # deviations of the ratio of both variances: white noise seems coloured less often than 1 in 10⁶
)
MIN_CORRELATION, MAX_CORRELATION = 0.5, 0.99  # less is what lively motion leaves in the differences
QUIET_SHARE = 0.3  # of the rows: those with the least acceleration
SMOOTHING_ROWS = 21  # of the encoder, so that its counting is no acceleration
COLUMNS = ("theta_j_rad", "tau_w_N_m", "current_A")
EDGE_SHARE = 0.1  # of a step: how sharp the edges of a quantised channel are taken to be
# Of what a channel spans: no sensor is taken to be better. Integrators agree to a ten-thousandth, load cells are linear
# to a thousandth.
MIN_DEVIATION_SHARES = (1e-4, 1e-3, 1e-4)


def sensor_noise(runs: Sequence[Run], rig: Rig) -> Noise:
    """Return the noise of jaw sensor, load cell and measured current; what the data can't tell, as the rig has it."""
    known = (rig.noise.theta_j_rad, rig.noise.tau_w_N_m, rig.noise.current_A)
    courses: tuple[Callable[[Run], Vector | None], ...] = (
        lambda run: run.columns.get("theta_j_rad"),
        lambda run: run.columns.get("tau_w_N_m"),
        lambda run: _current_beside_law(run, rig),
    )
    deviation, correlation, resolution = np.zeros(3), np.zeros(3), np.zeros(3)
    least = least_deviations(runs)
    for channel, (name, course) in enumerate(zip(COLUMNS, courses, strict=True)):
        told = [(run, values) for run in runs if (values := course(run)) is not None]
        deviation[channel], correlation[channel] = autoregressive_noise(told) if told else (known[channel], 0.0)
        step = resolution_of([run.columns[name] for run in runs if name in run.columns])
        if deviation[channel] < step:  # the same value again and again is no new evidence
            before = math.sqrt(max(deviation[channel] ** 2 - step**2 / 12.0, 0.0))
            deviation[channel], correlation[channel] = max(before, EDGE_SHARE * step), 0.0
            resolution[channel] = step
        if deviation[channel] < least[channel] and resolution[channel] == 0.0:
            deviation[channel], correlation[channel] = least[channel], 0.0
    return Noise(deviation, correlation, resolution)


def least_deviations(runs: Sequence[Run]) -> Vector:
    """Return the deviations (3) that no sensor of these runs is taken to be better than."""
    spans = [
        max((float(np.ptp(run.columns[name])) for run in runs if name in run.columns), default=0.0) for name in COLUMNS
    ]
    return np.maximum(np.multiply(MIN_DEVIATION_SHARES, spans), 1e-12)


def _current_beside_law(run: Run, rig: Rig) -> Vector | None:
    """Return the measured current without what the law commands; None where that isn't known.

    Between rows it isn't where the rounding of counts shows in the current.
    """
    columns = run.columns
    if rig.drive is None or not {"current_A", "theta_m_ref_rad"} <= columns.keys():
        return None
    samples, law = samples_in_a_row(run, rig), law_vector(rig.drive)
    rounding_A = count_current_A(law, rig.encoder.quantum_rad) / math.sqrt(6.0)  # of a count, and of the line there
    if samples == 0 or (samples > 1 and rounding_A > VISIBLE_COUNT_DEVIATIONS * rig.noise.current_A):
        return None
    rows = (columns["theta_m_ref_rad"], columns["theta_m_rad"], columns["current_A"])
    command = commands_on_lines(law, rows, samples, first_integral(law, rows, samples, 0.0).value_rad_s)
    return np.asarray(rows[2][1:] - command[samples - 1 :: samples][:-1])


def autoregressive_noise(told: Sequence[tuple[Run, Vector]]) -> tuple[float, float]:
    """Return deviation and correlation from row to row; the correlation is 0 where the noise is white to chance."""
    near, middle, far = (_difference_variance(told, spacing) for spacing in (NEAR_ROWS, MIDDLE_ROWS, FAR_ROWS))
    if near <= 0.0:
        return 0.0, 0.0
    rows = QUIET_SHARE * sum(values.size for _, values in told)
    # A variance from the median of n squares is known to 2.3/√n, and to twice that where neighbours hang together.
    by_chance = COLOUR_DEVIATIONS * np.sqrt(2.0) * 4.6 / np.sqrt(rows)
    if far / near < 1.0 + by_chance:
        return float(np.sqrt(near / 70.0)), 0.0
    correlation = _correlation(far / near)
    is_motion = middle / near < _share(correlation, MIDDLE_ROWS) / _share(correlation, NEAR_ROWS) - by_chance
    if correlation < MIN_CORRELATION or is_motion:
        return float(np.sqrt(near / 70.0)), 0.0
    return float(np.sqrt(near / _share(correlation, NEAR_ROWS))), correlation


def _difference_variance(told: Sequence[tuple[Run, Vector]], spacing: int) -> float:
    """Return the variance of fourth differences over so many rows where the motor is quiet."""
    squares, loud = [], []
    for run, values in told:
        smooth = uniform_filter1d(run.columns["theta_m_rad"], SMOOTHING_ROWS)[: values.size]
        n = values.size - 4 * spacing
        if n > 0:
            difference = sum(c * values[i * spacing : i * spacing + n] for i, c in enumerate(BINOMIAL))
            squares.append(np.square(difference))
            loud.append(np.abs(np.gradient(np.gradient(smooth)))[2 * spacing : -2 * spacing])
    if not squares:
        return 0.0
    every, loudness = np.concatenate(squares), np.concatenate(loud)
    quiet = np.argsort(loudness, kind="stable")[: max(1, round(QUIET_SHARE * loudness.size))]
    return float(np.median(every[quiet])) / MEDIAN_OF_SQUARE


def _share(correlation: float, spacing: int) -> float:
    kept = correlation**spacing
    return 70.0 - 112.0 * kept + 56.0 * kept**2 - 16.0 * kept**3 + 2.0 * kept**4


def _correlation(ratio: float) -> float:
    """Return the correlation at which both variances have this ratio."""

    def misfit(correlation: float) -> float:
        return _share(correlation, FAR_ROWS) / _share(correlation, NEAR_ROWS) - ratio

    if misfit(MAX_CORRELATION) <= 0.0:
        return MAX_CORRELATION
    return float(optimize.brentq(misfit, 0.0, MAX_CORRELATION))
