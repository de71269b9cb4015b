"""What the drive commanded, row by row, and how well that is known."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.data.run import Run
from hil_forceps.diagnosis.preparation.decoding import Expected, decoded, on_lines
from hil_forceps.diagnosis.preparation.resolution import resolution_of
from hil_forceps.diagnosis.state_space.advance import STEPS
from hil_forceps.model.drive_law import KI, LIMIT, SAMPLE_TIME, DriveState, law_current, law_vector
from hil_forceps.rig import Rig

Vector = NDArray[np.float64]


class Command(NamedTuple):
    """Commands of a run: the first of row k acts from row k on."""

    current_A: Vector  # n · samples, one behind the other
    samples: int  # of the drive in a row
    variance: Vector  # n [A²]: of their mean over a row
    bias_sd_A: float  # of a part that stays: the integral at the start
    bias_variance: Vector  # n [A²]: of what a row adds to that part
    shown_A: Vector  # n: the measured current, NaN where the command was made of it and it is no evidence of its own


WITHIN_LIMIT = 0.97  # of a current's limit: less is not clipped, noise and all
MEDIAN_DEVIATION = math.sqrt(0.5 * math.pi)  # of a median, over that of a mean: Gaussian noise
INTEGRAL_ROUNDS = 3  # the median of what is left is then as far off as its noise makes it
SAME_LOSS_ROWS = 100  # over which a slow angle loses the same to its recording
_SETTLING_TIMES = 6.0  # of the derivative's filter: exp(−6) of what it began with is left


def samples_in_a_row(run: Run, rig: Rig) -> int:
    """Return how many samples of the drive a row of equally spaced ones is; 0 where that is none of 1, 2 and 4.

    The steps of a row don't divide otherwise (`state_space.advance.STEPS`).
    """
    time_s, drive = run.columns["time_s"], rig.require_drive()
    return _samples(float(time_s[-1] - time_s[0]) / (time_s.size - 1), drive.sample_time_s)


def _samples(period_s: float, sample_time_s: float) -> int:
    samples = round(period_s / sample_time_s)
    fits = samples >= 1 and STEPS % samples == 0
    return samples if fits and math.isclose(samples * sample_time_s, period_s, rel_tol=1e-3) else 0


def by_law(
    rig: Rig, noise_A: float, rows: tuple[Vector, Vector, Vector], period_s: float, expected: Expected | None = None
) -> Command:
    """Return the law's commands on recorded references, angles and currents (`rows`).

    Of a drive that samples between rows they are decoded; `expected`: its angle there, as far as that is known.
    ValueError where a row isn't 1, 2 or 4 samples of the drive.
    """
    drive = rig.require_drive()
    reference, encoder, current = rows
    samples = _samples(period_s, drive.sample_time_s)
    if samples == 0:
        raise ValueError(f"rows every {period_s} s are no 1, 2 or 4 samples of {drive.sample_time_s} s")
    law = law_vector(drive)
    began = first_integral(law, rows, samples, noise_A)
    if samples == 1:
        start = DriveState(began.value_rad_s, float("nan"), 0.0, float(current[0]))
        command, shown = law_current(law, reference, encoder, start), current
        # A drive without counts reads its angle finer than it is recorded, and its integral adds up what is lost there.
        lost = 0.0 if rig.encoder.counts_per_rev is not None else resolution_of([encoder]) / math.sqrt(12.0)
        per_row = drive.ki_A_per_rad_s * drive.sample_time_s * lost * math.sqrt(SAME_LOSS_ROWS)
        variance, bias_variance = np.zeros(encoder.size), np.full(encoder.size, per_row**2)
    else:
        found = decoded(law, samples, rig.encoder.quantum_rad, noise_A, period_s, rows, expected, began.value_rad_s)
        command, shown = found.command_A, np.where(found.sure, current, np.nan)
        variance, bias_variance = found.variance, found.bias_variance
    settling = max(2, math.ceil(_SETTLING_TIMES / (2.0 * math.pi * drive.derivative_cutoff_Hz * period_s)))
    # Before the filter of the derivative has forgotten what it began with, the command is known as well as measured.
    if drive.kd_A_s_per_rad > 0.0:
        variance[: min(settling, variance.size - 1)] = float(np.ptp(current[: settling + 2])) ** 2
    bias_sd_A = drive.current_limit_A if drive.ki_A_per_rad_s > 0.0 else 0.0
    if began.forgotten < encoder.size:
        bias_variance[began.forgotten] += began.deviation_A**2
    return Command(command, samples, variance, bias_sd_A, bias_variance, shown)


class FirstIntegral(NamedTuple):
    """The drive's integral at the first row, by currents that are within its limit."""

    value_rad_s: float
    deviation_A: float  # of the current that it commands
    forgotten: int  # row from which the integral hangs on its limit, not on where it began; the run's length if none


def first_integral(law: Vector, rows: tuple[Vector, Vector, Vector], samples: int, noise_A: float) -> FirstIntegral:
    """Return where the integral began: what limits do hangs on it. What is left is a bias of the command."""
    count = rows[0].size
    if law[KI] <= 0.0:
        return FirstIntegral(0.0, 0.0, count)
    reference, encoder = (on_lines(values, samples) for values in rows[:2])
    shown = rows[2][1:]
    within = np.abs(shown) < WITHIN_LIMIT * law[LIMIT]
    summed = np.cumsum(reference - encoder) * law[SAMPLE_TIME]
    integral, told, forgotten = 0.0, np.empty(0, dtype=np.intp), count
    for _ in range(INTEGRAL_ROUNDS):
        start = DriveState(integral, float("nan"), 0.0, float(rows[2][0]))
        command = law_current(law, reference, encoder, start)[samples - 1 :: samples][: shown.size]
        clamped = np.abs(integral + summed) >= law[LIMIT] / law[KI]
        forgotten = int(np.argmax(clamped)) // samples if clamped.any() else count
        told = np.flatnonzero((within & (np.abs(command) < law[LIMIT]))[:forgotten])
        if told.size == 0:
            break
        integral += float(np.median((shown - command)[told])) / law[KI]
    deviation_A = MEDIAN_DEVIATION * noise_A / math.sqrt(told.size) if told.size else float(law[LIMIT])
    return FirstIntegral(integral, deviation_A, forgotten)
