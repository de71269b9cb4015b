"""What the drive commanded, row by row, and how well that is known."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.preparation.decoding import decoded
from hil_forceps.diagnosis.state_space.advance import STEPS
from hil_forceps.model.drive_law import DriveState, law_current, law_vector
from hil_forceps.rig import Rig

Vector = NDArray[np.float64]


class Command(NamedTuple):
    """Commands of a run: the first of row k acts from row k on."""

    current_A: Vector  # n · samples, one behind the other
    samples: int  # of the drive in a row
    variance: Vector  # n [A²]: of their mean over a row
    bias_sd_A: float  # of a part that is the same in all rows: the integral at the start
    measured: bool  # the measured current is no more than this: it is no measurement beside it


_SETTLING_TIMES = 6.0  # of the derivative's filter: exp(−6) of what it began with is left


def by_law(rig: Rig, reference_rad: Vector, encoder_rad: Vector, current_A: Vector, period_s: float) -> Command:
    """Return the law's commands on recorded angles; of a drive that samples between rows they are decoded.

    ValueError where a row isn't 1, 2 or 4 samples of the drive: the steps of a row don't divide otherwise.
    """
    drive = rig.require_drive()
    samples = round(period_s / drive.sample_time_s)
    if samples < 1 or STEPS % samples or not math.isclose(samples * drive.sample_time_s, period_s, rel_tol=1e-3):
        raise ValueError(f"rows every {period_s} s are no 1, 2 or 4 samples of {drive.sample_time_s} s")
    law = law_vector(drive)
    if samples == 1:
        start = DriveState(0.0, float("nan"), 0.0, float(current_A[0]))
        command, variance = law_current(law, reference_rad, encoder_rad, start), np.zeros(encoder_rad.size)
    else:
        counts = rig.encoder.counts_per_rev
        quantum = 2.0 * math.pi / counts if counts is not None else 0.0
        command, variance = decoded(law, samples, quantum, rig.noise.current_A, reference_rad, encoder_rad, current_A)
    settling = max(2, math.ceil(_SETTLING_TIMES / (2.0 * math.pi * drive.derivative_cutoff_Hz * period_s)))
    # Before the filter of the derivative has forgotten what it began with, the command is known as well as measured.
    if drive.kd_A_s_per_rad > 0.0:
        variance[: min(settling, variance.size - 1)] = float(np.ptp(current_A[: settling + 2])) ** 2
    bias_sd_A = drive.current_limit_A if drive.ki_A_per_rad_s > 0.0 else 0.0
    return Command(command, samples, variance, bias_sd_A, measured=samples > 1)


def by_measurement(current_A: Vector, noise_variance: float) -> Command:
    """Return the measured current as the command: the drive's law isn't known."""
    # A row's current is the one commanded a row earlier.
    command = np.concatenate((current_A[1:], current_A[-1:]))
    return Command(command, 1, np.full(command.size, noise_variance), 0.0, measured=True)
