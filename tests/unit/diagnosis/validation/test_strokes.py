"""The noise floor of repeated strokes: what is noise is found, what the motion makes isn't taken for it."""

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.diagnosis.validation.rows import Rows
from hil_forceps.diagnosis.validation.strokes import floors_with_strokes, period_rows, strokes_of

Vector = NDArray[np.float64]
ROW_S = 0.01
ROWS = 2000
TIME: Vector = np.arange(ROWS, dtype=np.float64) * ROW_S
NOISE = {"tau_m_N_m": 2e-3, "theta_j_rad": 5e-4}


def record_of(
    period_s: float = 2.374, name: str = "a", weights: Vector | None = None, motion: Vector | None = None
) -> Rows:
    """A stroke with a crooked answer to it; motion and load differ a little from stroke to stroke."""
    rng = np.random.default_rng(3)
    phase = 2.0 * np.pi * TIME / period_s
    wander = 0.01 * np.interp(TIME, TIME[::100], rng.standard_normal(ROWS // 100))
    theta = np.asarray(np.sin(phase) + wander) if motion is None else motion
    load = 0.1 + 0.01 * np.sign(np.cos(phase)) + 0.002 * np.interp(TIME, TIME[::50], rng.standard_normal(ROWS // 50))
    torque = 0.2 * theta + 0.05 * np.tanh(20.0 * np.cos(phase)) + 1.4 * load
    jaw = 0.7 * theta + 0.02 * np.sin(phase) ** 3 - 0.4 * load
    channels = {
        "tau_m_N_m": torque + NOISE["tau_m_N_m"] * rng.standard_normal(ROWS),
        "theta_j_rad": jaw + NOISE["theta_j_rad"] * rng.standard_normal(ROWS),
    }
    ones = np.ones(ROWS) if weights is None else weights
    return Rows(name, ROW_S, TIME, theta, channels, load, ones, driven=True)


@pytest.mark.parametrize("period_s", [1.0, 2.374, 6.1])
def test_noise_is_told_from_what_repeats(period_s: float) -> None:
    found = strokes_of(record_of(period_s))
    assert found is not None
    assert found.period_s == pytest.approx(period_s, abs=0.5 * ROW_S)
    assert found.times == pytest.approx(TIME[-1] / period_s, rel=1e-2)
    for name, floor in found.floor_rms.items():
        assert floor == pytest.approx(NOISE[name], rel=0.15), name


def test_rows_that_do_not_count_are_left_out() -> None:
    weights = np.ones(ROWS)
    weights[300:400] = 0.0
    record = record_of(2.0, weights=weights)
    record.channels["tau_m_N_m"][300:400] += 1.0
    found = strokes_of(record)
    assert found is not None
    assert found.floor_rms["tau_m_N_m"] == pytest.approx(NOISE["tau_m_N_m"], rel=0.15)


@pytest.mark.parametrize(
    "motion",
    [
        np.sin(2.0 * np.pi * (0.1 * TIME + 0.05 * TIME**2)),  # a chirp
        np.sin(2.0 * np.pi * TIME / 16.0),  # one stroke and a bit
        np.sin(3.0 * TIME) + np.sin(3.0 * np.sqrt(2.0) * TIME) + np.sin(3.0 * np.sqrt(5.0) * TIME),
        TIME,
        np.zeros(ROWS),
    ],
)
def test_a_motion_that_does_not_come_again_has_no_strokes(motion: Vector) -> None:
    assert period_rows(motion) is None
    assert strokes_of(record_of(motion=motion)) is None


def test_a_load_that_does_not_come_again_makes_no_floor() -> None:
    assert strokes_of(record_of()._replace(tau_w_N_m=np.sin(2.9 * TIME))) is None
    assert strokes_of(record_of()._replace(tau_w_N_m=None)) is not None


def test_too_few_rows_have_no_strokes() -> None:
    assert period_rows(np.sin(np.arange(30.0))) is None
    weights = np.zeros(ROWS)
    weights[:15] = 1.0
    assert strokes_of(record_of(2.0, weights=weights)) is None


def test_runs_with_strokes_and_without_share_one_floor() -> None:
    repeats, other = record_of(), record_of(name="b", motion=TIME)
    floors, found = floors_with_strokes((repeats, other), {"tau_m_N_m": 0.1, "theta_j_rad": 0.2, "absent": 7.0})
    assert [strokes.run for strokes in found] == ["a"]
    own = found[0].floor_rms
    assert floors["tau_m_N_m"] == pytest.approx(np.sqrt(0.5 * (0.1**2 + own["tau_m_N_m"] ** 2)))
    assert floors["theta_j_rad"] == pytest.approx(np.sqrt(0.5 * (0.2**2 + own["theta_j_rad"] ** 2)))
    lower = 0.5 * own["tau_m_N_m"]
    assert floors_with_strokes((repeats,), {"tau_m_N_m": lower})[0] == {"tau_m_N_m": lower}
    assert floors["absent"] == 7.0
    assert floors_with_strokes((), {"tau_m_N_m": 0.1}) == ({"tau_m_N_m": 0.1}, ())
