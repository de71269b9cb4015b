"""What is known of the drive of a run: its law, where its integral began, and which references it followed."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.data.run import Run
from hil_forceps.diagnosis.preparation.resolution import resolution_of
from hil_forceps.diagnosis.state_space.advance import STEPS
from hil_forceps.model.drive_law import KI, LIMIT, DriveState, integral_without_limit, law_current, law_vector
from hil_forceps.rig import Rig

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Driven(NamedTuple):
    """The drive of a run with n rows, as the filter takes it."""

    samples: int  # of the drive in a row
    law: Vector  # `model.drive_law.law_vector`
    first_integral_rad_s: float  # at the first row
    references_rad: Matrix  # n · samples × 3: what it may have followed (`references_between`)
    reference_variance: Vector  # n [rad²]: of the one at a row
    command_variance: Vector  # n [A²]: of the mean of the commands over a row
    integral_sd_A: float  # of what the integral commands at the start
    integral_variance: Vector  # n [A²]: of what a row adds to the error of that
    span_A: float  # of its commands


UNCLIPPED_SHARE = 0.97  # of a current's limit: less is not clipped, noise and all
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


def driven(run: Run, lost: Mask, rig: Rig, noise_A: float) -> Driven:
    """Return what is known of a run's drive; `lost` rows tell nothing of its reference.

    ValueError where a row isn't 1, 2 or 4 samples of the drive.
    """
    drive, columns = rig.require_drive(), run.columns
    reference, encoder, current = (columns[name] for name in ("theta_m_ref_rad", "theta_m_rad", "current_A"))
    count, samples = encoder.size, samples_in_a_row(run, rig)
    period_s = float(columns["time_s"][-1] - columns["time_s"][0]) / (count - 1)
    if samples == 0:
        raise ValueError(f"rows every {period_s} s are no 1, 2 or 4 samples of {drive.sample_time_s} s")
    law = law_vector(drive)
    began = first_integral(law, (reference, encoder, current), samples, noise_A)
    # A lost row's reference is on the line between its neighbours, give or take the way of a row.
    variance = np.where(lost, np.gradient(reference) ** 2 / 3.0, 0.0)
    # A drive without counts reads its angle finer than it is recorded, and its integral adds up what is lost there.
    loss = 0.0 if rig.encoder.counts_per_rev is not None else resolution_of([encoder]) / math.sqrt(12.0)
    per_row = drive.ki_A_per_rad_s * drive.sample_time_s * loss * math.sqrt(SAME_LOSS_ROWS)
    command_variance, integral_variance = np.zeros(count), np.full(count, per_row**2)
    settling = max(2, math.ceil(_SETTLING_TIMES / (2.0 * math.pi * drive.derivative_cutoff_Hz * period_s)))
    # Before the filter of the derivative has forgotten what it began with, the command is known as well as measured.
    if drive.kd_A_s_per_rad > 0.0:
        command_variance[: min(settling, count - 1)] = float(np.ptp(current[: settling + 2])) ** 2
    integral_sd_A = drive.current_limit_A if drive.ki_A_per_rad_s > 0.0 else 0.0
    if began.forgotten < count:
        integral_variance[began.forgotten] += began.deviation_A**2
    return Driven(
        samples,
        law,
        began.value_rad_s,
        references_between(reference, samples),
        variance,
        command_variance,
        integral_sd_A,
        integral_variance,
        float(np.ptp(commands_on_lines(law, (reference, encoder, current), samples, began.value_rad_s))),
    )


def references_between(reference_rad: Vector, samples: int) -> Matrix:
    """Return what a drive may follow at each of its samples (n · samples × 3): held, on a line, ahead.

    A host's references arrive when they arrive: before the first sample behind a row, behind the last, or in between.
    """
    ahead = np.repeat(np.append(reference_rad[1:], reference_rad[-1]), samples)
    ahead[::samples] = reference_rad
    return np.column_stack((np.repeat(reference_rad, samples), on_lines(reference_rad, samples), ahead))


def mean_reference(references_rad: Matrix, timing: Matrix) -> Vector:
    """Return the mean of what a drive may have followed (n · samples), `timing` (n × 3) being how likely each is."""
    samples = references_rad.shape[0] // timing.shape[0]
    return np.asarray(np.sum(np.repeat(timing, samples, axis=0) * references_rad, axis=1))


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
    within = np.abs(shown) < UNCLIPPED_SHARE * law[LIMIT]
    summed = integral_without_limit(law, reference, encoder)
    integral, told, forgotten = 0.0, np.empty(0, dtype=np.intp), count
    for _ in range(INTEGRAL_ROUNDS):
        command = commands_on_lines(law, rows, samples, integral)[samples - 1 :: samples][: shown.size]
        clamped = np.abs(integral + summed) >= law[LIMIT] / law[KI]
        forgotten = int(np.argmax(clamped)) // samples if clamped.any() else count
        told = np.flatnonzero((within & (np.abs(command) < law[LIMIT]))[:forgotten])
        if told.size == 0:
            break
        integral += float(np.median((shown - command)[told])) / law[KI]
    deviation_A = MEDIAN_DEVIATION * noise_A / math.sqrt(told.size) if told.size else float(law[LIMIT])
    return FirstIntegral(integral, deviation_A, forgotten)


def commands_on_lines(law: Vector, rows: tuple[Vector, Vector, Vector], samples: int, integral_rad_s: float) -> Vector:
    """Return about what the law commanded: with references and counts on lines between rows."""
    reference, encoder = (on_lines(values, samples) for values in rows[:2])
    return law_current(law, reference, encoder, DriveState(integral_rad_s, float("nan"), 0.0, float(rows[2][0])))


def on_lines(values: Vector, samples: int) -> Vector:
    """Return values at each sample of the drive, on lines between rows."""
    return np.asarray(np.interp(np.arange(values.size * samples) / samples, np.arange(values.size), values))
