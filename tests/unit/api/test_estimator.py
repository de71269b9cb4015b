"""`Estimator`: sample by sample and whole are one; gaps, resets, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

import hil_forceps as hf
from hil_forceps.estimation.interface import Sample
from hil_forceps.estimation.registry import make_estimator

RIG = Path(__file__).parents[3] / "configs" / "realistic.yaml"
ROWS = 50
TIME_S = np.arange(ROWS) * 1e-3
ANGLE = 0.3 * np.sin(20.0 * TIME_S)
CURRENT = 0.1 * np.cos(20.0 * TIME_S)


@pytest.mark.parametrize("algorithm", ["kalman", "previous"])
def test_steps_and_a_whole_record_are_the_same_numbers(algorithm: str) -> None:
    estimator = hf.Estimator(algorithm, RIG, 1e-3)
    whole = estimator.estimate(ANGLE, CURRENT)
    steps = [estimator.step(angle, current) for angle, current in zip(ANGLE, CURRENT, strict=True)]
    assert [step.tau_w_N_m for step in steps] == whole.tau_w_N_m.tolist()
    assert [step.elongation_m for step in steps] == whole.elongation_m.tolist()
    stamped = estimator.estimate(ANGLE.tolist(), CURRENT.tolist(), TIME_S)
    assert stamped.tau_w_N_m.tolist() == whole.tau_w_N_m.tolist()


def test_it_is_the_estimator_of_the_service() -> None:
    rig = hf.load_rig(RIG)
    below, above = make_estimator("kalman", rig, 1e-3), hf.Estimator("kalman", rig, 1e-3)
    constant = rig.plant().torque_constant_N_m_per_A
    state = below.start(Sample(5, 0.1, constant * 0.2))
    assert above.step(0.1, 0.2, 5) == below.estimate(state)
    state = below.step(state, Sample(7_000_005, 0.2, constant * 0.3))
    assert above.step(0.2, 0.3, 7_000_005) == below.estimate(state)


def test_it_remembers_until_it_is_reset() -> None:
    estimator = hf.Estimator("kalman", RIG, 1e-3)
    first = [estimator.step(angle, 0.1) for angle in ANGLE[:3]]
    assert estimator.step(0.0, 0.1, 1_000_000) == first[-1]  # a stamp that isn't later
    estimator.reset()
    assert [estimator.step(angle, 0.1) for angle in ANGLE[:3]] == first
    own = estimator.step(0.1, 0.1)
    estimator.estimate(ANGLE, CURRENT)
    estimator.step(0.1, 0.1, 2_999_999)  # before the last: as if it had not come, the record neither
    assert estimator.step(0.1, 0.1, 3_000_000) == own


def test_what_is_refused() -> None:
    with pytest.raises(hf.UserError, match="unknown algorithm 'kalmann'; there are previous"):
        hf.Estimator("kalmann", RIG, 1e-3)
    with pytest.raises(ValueError, match="sample_time_s must be positive"):
        hf.Estimator("kalman", RIG, 0.0)
    estimator = hf.Estimator("kalman", RIG, 1e-3)
    for angle, current in ((ANGLE, CURRENT[:3]), (np.zeros((2, 2)), np.zeros((2, 2))), ([], [])):
        with pytest.raises(ValueError, match="must be of one length above 0"):
            estimator.estimate(angle, current)
