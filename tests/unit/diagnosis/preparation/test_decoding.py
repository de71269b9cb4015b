"""What a drive counted and followed between rows is told from the current that the next row shows."""

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.diagnosis.preparation.command import by_law
from hil_forceps.diagnosis.preparation.decoding import Expected, decoded
from hil_forceps.model import closed_loop, parameters
from hil_forceps.model.closed_loop import Inputs
from hil_forceps.model.drive_law import DriveState, law_current, law_vector
from tests.hidden_effects.generator import FAST_DRIVE_RIG

Vector = NDArray[np.float64]

RIG = FAST_DRIVE_RIG.with_changes({"drive.ki_A_per_rad_s": 100.0})
LAW = law_vector(RIG.require_drive())
COUNT = 2.0 * np.pi / 16384
ROWS, SAMPLES, PERIOD_S, NOISE_A = 4000, 2, 1e-3, 1e-3


def logged(kind: str) -> tuple[tuple[Vector, Vector, Vector], Vector, Vector]:
    """Return rows (reference, count, current), and commands and counts of all samples; `kind`: of reference between."""
    every: Vector = 0.4 * np.sin(2.0 * np.pi * 0.7 * PERIOD_S / SAMPLES * np.arange(ROWS * SAMPLES + 1))
    reference = every[:-1].copy()
    reference[1::2] = {"held": every[:-1:2], "ahead": every[2::2], "line": 0.5 * (every[:-1:2] + every[2::2])}[kind]
    theta = parameters.vector(RIG)
    time_s: Vector = PERIOD_S / SAMPLES * np.arange(ROWS * SAMPLES, dtype=np.float64)
    inputs = Inputs(time_s, reference, np.zeros(time_s.size), np.empty(0, dtype=np.int64), np.empty(0))
    shown = closed_loop.simulate(theta, LAW, COUNT, inputs, closed_loop.rest(theta, 0.0))
    start = DriveState(0.0, float("nan"), 0.0, 0.0)
    commands = law_current(LAW, reference, shown.theta_m_rad, start)
    current = shown.current_A + NOISE_A * np.random.default_rng(1).standard_normal(time_s.size)
    return (reference[::2], shown.theta_m_rad[::2], current[::2]), commands, shown.theta_m_rad


@pytest.mark.parametrize("kind", ["held", "ahead", "line"])
def test_commands_between_rows_are_told_whatever_the_host_sends(kind: str) -> None:
    rows, commands, counts = logged(kind)
    # The angle as a filter has it: within a tenth of a count, where none of its rounding is known.
    smooth = np.convolve(counts, np.hanning(9) / np.hanning(9).sum(), mode="same")
    found = decoded(LAW, SAMPLES, COUNT, NOISE_A, PERIOD_S, rows, Expected(smooth, 0.15 * COUNT))
    there = slice(600, -20)
    off = (found.command_A - commands)[1::2][there]
    by_current = rows[2][1:] - commands[1::2][:-1]
    assert np.std(off) < 0.6 * np.std(by_current)  # better than the measured current itself
    assert abs(float(np.mean(off))) < 0.1 * NOISE_A  # the integral keeps to the references that the drive followed


def test_rows_that_are_no_whole_number_of_samples_are_refused() -> None:
    rows, _, _ = logged("held")
    with pytest.raises(ValueError, match="no 1, 2 or 4 samples"):
        by_law(RIG, NOISE_A, rows, 1.5e-3)
