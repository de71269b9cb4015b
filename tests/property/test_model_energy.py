"""Energy: friction takes it and never gives it; the exact step of the plant without input never gains any."""

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.typing import NDArray

from hil_forceps.model import linear_loop
from hil_forceps.model.linear import two_inertia
from hil_forceps.rig.plant import PlantParameters

PAPER = PlantParameters(2.0e-3, 1.4e-3, 3.18e-8, 6.85e-8, 1.16e-4, 4.62e-7, 4.62e-9, 2.6e4, 1.35e-2)

speeds = st.floats(-100.0, 100.0)
levels = st.floats(0.0, 1e-2)
stretches = st.floats(-1e-4, 1e-4)


def energy_J(state: NDArray[np.float64]) -> float:
    r_m, r_j = PAPER.motor_pulley_radius_m, PAPER.jaw_pulley_radius_m
    stretch = r_m * state[0] - r_j * state[2]
    kinetic = PAPER.motor_inertia_kg_m2 * state[1] ** 2 + PAPER.jaw_inertia_kg_m2 * state[3] ** 2
    return float(0.5 * kinetic + 0.5 * PAPER.wire_stiffness_N_per_m * stretch**2)


def started(stretch_m: float, speed_m: float, speed_j: float) -> NDArray[np.float64]:
    return np.array([stretch_m / PAPER.motor_pulley_radius_m, speed_m, 0.0, speed_j])


@given(stretches, speeds, speeds, st.sampled_from([0.0, 1.16e-4, 1e-2]), st.floats(1e-6, 1e-2))
def test_free_motion_never_gains_energy(x: float, v_m: float, v_j: float, viscous: float, dt_s: float) -> None:
    transition, _ = two_inertia.discretise(PAPER._replace(motor_viscous_N_m_s_per_rad=viscous), dt_s)
    before = started(x, v_m, v_j)
    assert energy_J(transition @ before) <= energy_J(before) * (1 + 1e-9) + 1e-18


@given(stretches, speeds, speeds, levels, levels)
@example(5.289647186044234e-05, 2.0, 0.0, 0.0078125, 0.0)
def test_friction_takes_energy_until_all_is_at_rest(
    x: float, v_m: float, v_j: float, motor_N_m: float, jaw_N_m: float
) -> None:
    transition, gain = two_inertia.discretise(PAPER, 5e-5)
    state = started(x, v_m, v_j)
    begin = last = energy_J(state)
    most = 0.0
    for _ in range(400):
        before = state
        state = linear_loop.plant_step(state, 0.0, 0.0, transition, gain, np.array([motor_N_m, jaw_N_m]))
        now = energy_J(state)
        # Within a step friction is that of its end, so its work may be off by what it could do over the step.
        work = motor_N_m * abs(state[0] - before[0]) + jaw_N_m * abs(state[2] - before[2])
        assert now <= last * (1 + 1e-9) + work + 1e-15
        last, most = now, max(most, work)
    # So it is off in the step in which it stops, by more than a share where little moves against much friction.
    assert last <= begin * 1.001 + most + 1e-15


@given(speeds, st.floats(1e-9, 1e6), levels)
def test_friction_opposes_and_never_turns_motion_about(speed: float, gain: float, level: float) -> None:
    friction = linear_loop.friction_N_m(speed, gain, level)
    assert abs(friction) <= level
    assert friction * speed >= 0.0
    after = speed - gain * friction
    assert after * speed >= -1e-12 * speed * speed
