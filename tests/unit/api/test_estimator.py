"""`Estimator`: sample by sample and whole are one; gaps, resets, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

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
    assert estimator.step(0.0, 0.1, 2_000_000) == first[-1]  # a stamp that is there already
    estimator.reset()
    assert [estimator.step(angle, 0.1) for angle in ANGLE[:3]] == first
    own = estimator.step(0.1, 0.1)
    estimator.estimate(ANGLE, CURRENT)
    with pytest.raises(hf.UserError, match="stamp_ns: 2999999 comes before the last sample's 3000000; leave out"):
        estimator.step(0.1, 0.1, 2_999_999)
    # As if it had not come; the record neither.
    assert estimator.step(0.1, 0.1, 3_000_000) == own


def test_what_is_refused() -> None:
    with pytest.raises(hf.UserError, match="unknown algorithm 'kalmann'; use one of previous"):
        hf.Estimator("kalmann", RIG, 1e-3)
    with pytest.raises(ValueError, match=r"sample_time_s: is 0\.0; must be a finite number above 0 \(s\)"):
        hf.Estimator("kalman", RIG, 0.0)
    estimator = hf.Estimator("kalman", RIG, 1e-3)
    for angle, current in ((ANGLE, CURRENT[:3]), (np.zeros((2, 2)), np.zeros((2, 2))), ([], [])):
        with pytest.raises(
            ValueError, match="theta_m_rad, current_A: must be one-dimensional arrays of equal length, at least 1"
        ):
            estimator.estimate(angle, current)


@pytest.mark.parametrize(
    ("time_s", "said"),
    [
        (TIME_S * 1e3, r"rows are 1 s apart, .*; if the stamps are ms, multiply them by 0\.001$"),
        (TIME_S[::-1], r"time_s\[1\]: 0\.048 does not come after 0\.049; sort the rows"),
        (np.zeros(ROWS), r"time_s\[1\]: 0 does not come after 0"),
        (np.where(TIME_S[7] == TIME_S, np.nan, TIME_S), r"time_s\[7\]: is nan, not a finite number; correct or remove"),
    ],
)
def test_time_is_refused_as_read_runs_does(time_s: NDArray[np.float64], said: str) -> None:
    with pytest.raises(hf.UserError, match=said):
        hf.Estimator("kalman", RIG, 1e-3).estimate(ANGLE, CURRENT, time_s)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_is_refused_and_changes_nothing(bad: float) -> None:
    estimator = hf.Estimator("kalman", RIG, 1e-3)
    for name, place in (("theta_m_rad", 0), ("current_A", 1)):
        record = [ANGLE.copy(), CURRENT.copy()]
        record[place][3] = bad
        with pytest.raises(hf.UserError, match=rf"{name}\[3\]: is {bad}, not a finite number"):
            estimator.estimate(*record)
        sample = [0.1, 0.1]
        sample[place] = bad
        with pytest.raises(hf.UserError, match=rf"{name}: is {bad}, not a finite number; leave this sample out"):
            estimator.step(sample[0], sample[1])
    assert np.isfinite(estimator.step(0.1, 0.1).tau_w_N_m)


@pytest.mark.parametrize(
    ("bad", "said"), [(10, "is 10 s, and no drive of a rig"), (np.nan, "is nan; must be"), (-1.0, "is -1")]
)
def test_a_sample_time_that_no_drive_has_is_refused(bad: float, said: str) -> None:
    with pytest.raises(ValueError, match=f"sample_time_s: {said}"):
        hf.Estimator("kalman", RIG, bad)
