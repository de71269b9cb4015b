"""The closed loop on the truth plant, without protocol: stable, settling, quiet, at every rate and count in use."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from firmware_protocol.scales import ANGLE_LSB_RAD, angle_raw_from_rad
from hil_forceps.rig.plant import PlantParameters
from virtual_bus.plant.forceps import SimulatedForceps
from virtual_bus.plant.load import LoadProfile, paper_load, piecewise_linear
from virtual_bus.plant.plant import truth_parameters
from virtual_bus.plant.position_loop import LoopParameters
from virtual_bus.plant.sensors import IDEAL_ENCODER, SensorParameters

TABLE_I = PlantParameters(2.00e-3, 1.4e-3, 3.18e-8, 6.85e-8, 1.16e-4, 4.62e-7, 4.62e-9, 2.60e4, 1.35e-2)
EXAMPLE = LoopParameters(1.0e-3, 1.2, 15.0, 0.006, 150.0, 1.0)  # of the rig file's description
STIFF = LoopParameters(1.0e-3, 2.0, 100.0, 0.006, 150.0, 1.0)
START_RAD = 0.7 * math.pi / 2.0
STEP_S = 5.0e-5


def simulate(
    loop: LoopParameters, counts: float, load: LoadProfile, reference_rad: Callable[[float], float], duration_s: float
) -> NDArray[np.float64]:
    """Return rows of time, θ_m, θ_j, τ_w, x, i: the truth at each sample."""
    plant = truth_parameters(TABLE_I, STEP_S)
    sensors = SensorParameters(counts, 0.0, 0.0, 0.0)
    forceps = SimulatedForceps(plant, loop, sensors, load, STEP_S, math.pi / 2.0, seed=1)
    period_ns = round(loop.sample_time_s * 1.0e9)
    forceps.start_load(0)
    rows = []
    for k in range(round(duration_s / loop.sample_time_s)):
        now_ns = k * period_ns
        reading = forceps.read(now_ns)
        rows.append((now_ns * 1.0e-9, *forceps.truth(now_ns)))
        reference = angle_raw_from_rad(reference_rad(now_ns * 1.0e-9))
        forceps.run(now_ns, now_ns + period_ns, reading.theta_m, reference)
    return np.array(rows)


@pytest.mark.parametrize("counts", [IDEAL_ENCODER, 16384.0, 4096.0])
@pytest.mark.parametrize("sample_time_s", [1.0e-3, 1.0e-4])
@pytest.mark.parametrize(("loop", "overshoot", "settled_s"), [(EXAMPLE, 0.12, 0.35), (STIFF, 0.30, 0.1)])
def test_step_of_the_reference_settles(
    loop: LoopParameters, overshoot: float, settled_s: float, sample_time_s: float, counts: float
) -> None:
    step_rad = 0.05
    rows = simulate(
        loop._replace(sample_time_s=sample_time_s), counts, paper_load(0), lambda _: START_RAD + step_rad, 1.0
    )
    error = (rows[:, 1] - START_RAD) / step_rad - 1.0
    count = 0.0 if counts == IDEAL_ENCODER else 2.0 * math.pi / counts / step_rad
    assert error.max() < overshoot + count
    assert np.abs(error[rows[:, 0] > settled_s]).max() < 0.02 + count


@pytest.mark.parametrize("counts", [IDEAL_ENCODER, 16384.0, 4096.0])
@pytest.mark.parametrize("sample_time_s", [1.0e-3, 1.0e-4])
@pytest.mark.parametrize(("loop", "peak_rad", "settled_s"), [(EXAMPLE, 0.15, 0.6), (STIFF, 0.095, 0.15)])
def test_step_of_the_load_is_taken_up(
    loop: LoopParameters, peak_rad: float, settled_s: float, sample_time_s: float, counts: float
) -> None:
    load = piecewise_linear([0.1, 0.1], [0.0, 2.0e-3])
    rows = simulate(loop._replace(sample_time_s=sample_time_s), counts, load, lambda _: START_RAD, 1.1)
    error = np.abs(rows[:, 1] - START_RAD)
    count = 0.0 if counts == IDEAL_ENCODER else 2.0 * math.pi / counts
    assert error.max() < peak_rad
    settled = rows[:, 0] > 0.1 + settled_s
    assert error[settled].max() < 5.0e-4 + count
    assert rows[settled, 4].mean() == pytest.approx(54.945e-6, rel=0.005)
    assert rows[settled, 4] == pytest.approx(54.945e-6, rel=0.05)  # coarse counts make the loop hunt
    assert np.abs(rows[:, 5]).max() < 0.3


@pytest.mark.parametrize("loop", [EXAMPLE, STIFF])
def test_paper_ramp_is_followed_without_a_lag_that_stays(loop: LoopParameters) -> None:
    def reference(time_s: float) -> float:
        return START_RAD - 0.7 * math.radians(16.0) * min(time_s, 5.0)

    rows = simulate(loop, IDEAL_ENCODER, paper_load(0), reference, 6.0)
    wanted = np.array([reference(t) for t in rows[:, 0]])
    assert np.abs(rows[:, 1] - wanted)[(rows[:, 0] > 1.0) & (rows[:, 0] < 5.0)].max() < 1.0e-5
    assert math.degrees(rows[-1, 2]) == pytest.approx(10.0, abs=1.0e-3)


def test_first_sample_of_a_loop_at_rest_makes_no_current() -> None:
    plant = truth_parameters(TABLE_I, STEP_S)
    forceps = SimulatedForceps(plant, EXAMPLE, SensorParameters(4096.0, 0.0, 0.0, 0.0), paper_load(0), STEP_S, 1.0, 1)
    theta = forceps.read(0).theta_m
    forceps.run(0, 1_000_000, theta, theta)
    assert forceps.truth(1_000_000).current_A == 0.0


def test_motor_without_reference_is_free() -> None:
    """No current: a load pulls the jaw away, and the motor's friction alone holds against it."""
    plant = truth_parameters(TABLE_I, STEP_S)
    sensors = SensorParameters(IDEAL_ENCODER, 0.0, 0.0, 0.0)
    forceps = SimulatedForceps(plant, EXAMPLE, sensors, piecewise_linear([0.0], [2.0e-3]), STEP_S, 0.0, 1)
    forceps.start_load(0)
    for k in range(100):
        forceps.run(k * 1_000_000, (k + 1) * 1_000_000, forceps.read(k * 1_000_000).theta_m, None)
    truth = forceps.truth(100_000_000)
    terminal_rad_per_s = (2.0 / 1.4 * 2.0e-3) / 1.16e-4
    assert truth.theta_m_rad == pytest.approx(-terminal_rad_per_s * 0.1, rel=0.05)
    assert truth.current_A == 0.0
    assert forceps.read(100_000_000).theta_m * ANGLE_LSB_RAD == pytest.approx(truth.theta_m_rad, abs=1.0e-6)
