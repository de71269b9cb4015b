"""What the drive commanded, row by row, and how well that is known."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.model.drive_law import DriveState, law_current, law_vector
from hil_forceps.rig import Rig

Vector = NDArray[np.float64]


class Command(NamedTuple):
    """Commands of a run; that of row k acts from row k to row k + 1."""

    current_A: Vector  # n
    variance: Vector  # n [A²]
    bias_sd_A: float  # of a part that is the same in all rows: the integral at the start
    measured: bool  # the measured current is no more than this: it is no measurement beside it


_SETTLING_TIMES = 6.0  # of the derivative's filter: exp(−6) of what it began with is left


def by_law(rig: Rig, reference_rad: Vector, encoder_rad: Vector, current_A: Vector, period_s: float) -> Command:
    """Return the law's commands on recorded angles; a drive that samples more often reads them on straight lines."""
    drive = rig.require_drive()
    samples = round(period_s / drive.sample_time_s)
    start = DriveState(0.0, float("nan"), 0.0, float(current_A[0]))
    if samples <= 1:
        command = law_current(law_vector(drive), reference_rad, encoder_rad, start)
    else:
        command = _between_rows(rig, reference_rad, encoder_rad, start, samples)
    ki, limit = drive.ki_A_per_rad_s, drive.current_limit_A
    settling = max(2, math.ceil(_SETTLING_TIMES / (2.0 * math.pi * drive.derivative_cutoff_Hz * period_s)))
    variance = np.zeros(command.size)
    # Before the filter of the derivative has forgotten what it began with, the command is known as well as measured.
    first = slice(0, min(settling, command.size - 1))
    if drive.kd_A_s_per_rad > 0.0:
        variance[first] = float(np.ptp(current_A[: settling + 2])) ** 2
    if samples > 1:
        variance += _variance_between(command, current_A, rig.noise.current_A)
    # Between rows the drive counted what no row shows: the current then tells of those counts, and of no parameter.
    return Command(command, variance, limit if ki > 0.0 else 0.0, measured=samples > 1)


def _between_rows(rig: Rig, reference: Vector, encoder: Vector, start: DriveState, samples: int) -> Vector:
    n = encoder.size
    at = np.arange(n * samples) / samples
    rows = np.arange(n, dtype=np.float64)
    fine = law_current(
        law_vector(rig.require_drive()), np.interp(at, rows, reference), np.interp(at, rows, encoder), start
    )
    return np.asarray(fine.reshape(n, samples).mean(axis=1))


def _variance_between(command: Vector, current: Vector, noise_sd_A: float) -> float:
    """Return how far commands on interpolated angles are from what was measured, beyond the sensor's noise."""
    error = current[1:] - command[:-1]
    return max(0.0, float(np.var(error)) - noise_sd_A**2)


def by_measurement(current_A: Vector, noise_variance: float) -> Command:
    """Return the measured current as the command: the drive's law isn't known."""
    # A row's current is the one commanded a row earlier.
    command = np.concatenate((current_A[1:], current_A[-1:]))
    return Command(command, np.full(command.size, noise_variance), 0.0, measured=True)
