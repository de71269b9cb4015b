"""What became of the improved algorithm's α: it diverges as published and contributes nothing when it is stable."""

import math
from pathlib import Path

import numpy as np
import pytest

from hil_forceps.estimation.algorithms import improved
from hil_forceps.estimation.direct import plant_steps, run_direct
from hil_forceps.estimation.interface import TAU_W
from hil_forceps.estimation.registry import make_estimator
from hil_forceps.model.linear.two_inertia import wire_mode_squared
from hil_forceps.rig import load_rig

RIG = load_rig(Path(__file__).parents[3] / "configs" / "paper.yaml")
PLANT = RIG.plant()
CORNER = 2.0 * math.pi * 70.0
A = wire_mode_squared(PLANT)


def amplitude(state: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> float:
    off = state[improved.MODEL_X] - state[4]
    return math.hypot(off, state[improved.MODEL_V] / math.sqrt(A))


@pytest.mark.parametrize("period_s", [1e-4, 5e-4, 1e-3])
def test_as_published_every_half_step_grows_by_the_spectral_radius(period_s: float) -> None:
    constants = improved.constants(PLANT, CORNER, as_published=True)
    state = improved.start(constants, 0, 0.5, 1e-3)
    state[improved.MODEL_X] += 1e-6  # any difference rings
    begin = amplitude(state)
    samples = 200
    for n in range(1, samples + 1):
        state = improved.step(state, constants, round(n * period_s * 1e9), 0.5, 1e-3)
    growth = (amplitude(state) / begin) ** (1.0 / (2 * samples))
    assert growth == pytest.approx(math.sqrt(1.0 + (period_s / 2.0) ** 2 * A), rel=2e-3)


def test_as_published_leaves_the_range_of_numbers_but_not_in_its_elongation() -> None:
    constants = improved.constants(PLANT, CORNER, as_published=True)
    state = improved.start(constants, 0, 0.5, 1e-3)
    for n in range(1, 5000):
        state = improved.step(state, constants, n * 1_000_000, 0.5 + 1e-3 * math.sin(0.01 * n), 1e-3)
    assert not math.isfinite(state[TAU_W])
    assert math.isfinite(state[4])


@pytest.mark.parametrize("period_s", [1e-4, 1e-3, 2e-3, 5e-3, 0.0999])
def test_stable_form_rings_without_growing_at_any_sample_time(period_s: float) -> None:
    constants = improved.constants(PLANT, CORNER, as_published=False)
    state = improved.start(constants, 0, 0.5, 1e-3)
    state[improved.MODEL_X] += 1e-6
    largest = 0.0
    for n in range(1, 20_000):
        state = improved.step(state, constants, round(n * period_s * 1e9), 0.5, 1e-3)
        largest = max(largest, amplitude(state))
    assert largest < 2.5e-6


def test_after_a_long_gap_the_model_of_the_wire_starts_again() -> None:
    constants = improved.constants(PLANT, CORNER, as_published=False)
    state = improved.start(constants, 0, 0.5, 1e-3)
    state[improved.MODEL_X] += 1e-3
    after = improved.step(state, constants, 3_600 * 10**9, 0.5, 1e-3)
    assert after[improved.MODEL_X] == after[4]
    assert after[improved.MODEL_V] == 0.0


def test_alpha_is_negligible_where_the_acceleration_is_not() -> None:
    """Simulation 2 of the paper, 9 to 13 s of it: the jaw held, 2 mN m on at 1 s and off at 3.5 s."""
    samples, steps = 4000, plant_steps(RIG)
    time_s = np.arange(samples * steps) * (1e-3 / steps)
    load = np.where((time_s >= 1.0) & (time_s < 3.5), 2e-3, 0.0)
    estimator = make_estimator("improved", RIG, 1e-3)
    run = run_direct(RIG, estimator, np.full(samples, math.radians(10.0)), load, over_wire=True)
    assert np.abs(np.diff(run.elongation_m, 2)).max() / 1e-6 > 10.0  # m/s²

    constants = improved.constants(PLANT, CORNER, as_published=False)
    torque = PLANT.torque_constant_N_m_per_A * run.current_A
    state = improved.start(constants, 0, float(run.theta_m_rad[0]), float(torque[0]))
    largest = 0.0
    for n in range(1, samples):
        state = improved.step(state, constants, n * 1_000_000, float(run.theta_m_rad[n]), float(torque[n]))
        largest = max(largest, abs(float(state[improved.ALPHA])))
    assert state[TAU_W] == run.tau_w_estimate_N_m[-1]
    assert 0.0 < largest < 1e-10  # m/s²
    # Its share of τ̂_w, (20):
    assert PLANT.jaw_inertia_kg_m2 / PLANT.jaw_pulley_radius_m * largest < 1e-14
