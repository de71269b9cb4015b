"""What the drive commanded, row by row, and how well that is known."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.preparation.decoding import Expected, decoded
from hil_forceps.diagnosis.preparation.resolution import resolution_of
from hil_forceps.diagnosis.state_space.advance import STEPS
from hil_forceps.model.drive_law import DriveState, law_current, law_vector
from hil_forceps.rig import Rig
from hil_forceps.runs.table import Run

Vector = NDArray[np.float64]


class Command(NamedTuple):
    """Commands of a run: the first of row k acts from row k on."""

    current_A: Vector  # n · samples, one behind the other
    samples: int  # of the drive in a row
    variance: Vector  # n [A²]: of their mean over a row
    bias_sd_A: float  # of a part that stays: the integral at the start
    bias_variance: Vector  # n [A²]: of what a row adds to that part
    shown_A: Vector  # n: the measured current, NaN where the command was made of it and it is no evidence of its own


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
    if samples == 1:
        start = DriveState(0.0, float("nan"), 0.0, float(current[0]))
        command, shown = law_current(law, reference, encoder, start), current
        # A drive without counts reads its angle finer than it is recorded, and its integral adds up what is lost there.
        lost = 0.0 if rig.encoder.counts_per_rev is not None else resolution_of([encoder]) / math.sqrt(12.0)
        per_row = drive.ki_A_per_rad_s * drive.sample_time_s * lost * math.sqrt(SAME_LOSS_ROWS)
        variance, bias_variance = np.zeros(encoder.size), np.full(encoder.size, per_row**2)
    else:
        counts = rig.encoder.counts_per_rev
        quantum = 2.0 * math.pi / counts if counts is not None else 0.0
        found = decoded(law, samples, quantum, noise_A, period_s, rows, expected)
        command, shown = found.command_A, np.where(found.sure, current, np.nan)
        variance, bias_variance = found.variance, found.bias_variance
    settling = max(2, math.ceil(_SETTLING_TIMES / (2.0 * math.pi * drive.derivative_cutoff_Hz * period_s)))
    # Before the filter of the derivative has forgotten what it began with, the command is known as well as measured.
    if drive.kd_A_s_per_rad > 0.0:
        variance[: min(settling, variance.size - 1)] = float(np.ptp(current[: settling + 2])) ** 2
    bias_sd_A = drive.current_limit_A if drive.ki_A_per_rad_s > 0.0 else 0.0
    return Command(command, samples, variance, bias_sd_A, bias_variance, shown)


def by_measurement(current_A: Vector, noise_variance: float) -> Command:
    """Return the measured current as the command: the drive's law isn't known."""
    # A row's current is the one commanded a row earlier.
    command = np.concatenate((current_A[1:], current_A[-1:]))
    n = command.size
    return Command(command, 1, np.full(n, noise_variance), 0.0, np.zeros(n), np.full(n, np.nan))
