"""The plant's FMU against the project's own simulation, effect by effect, and what it refuses."""

import math
from typing import Any

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from numpy.typing import NDArray

from hil_forceps.fmu.plant_unit import plant_unit
from hil_forceps.model import closed_loop, parameters
from hil_forceps.model.closed_loop import Channels, Inputs
from hil_forceps.rig import Rig
from hil_forceps.rig.catalogue import EFFECTS, Effect
from hil_forceps.rig.sections import DriveLaw
from tests.unit.fmu.conftest import Made, Make, Run

pytestmark = pytest.mark.xdist_group("fmu")  # what they look at is made once, for all

Vector = NDArray[np.float64]

ROWS, SAMPLE_S, COUNTS = 400, 1e-3, 16384
# Bits are the same where the functions of libm are; this is what another libm may differ by.
AGREES = 1e-9
LAW = DriveLaw(
    sample_time_s=SAMPLE_S,
    kp_A_per_rad=1.2,
    ki_A_per_rad_s=15.0,
    kd_A_s_per_rad=0.006,
    derivative_cutoff_Hz=150.0,
    current_limit_A=1.0,
)
START = {"start.theta_m_rad": 0.6, "start.tension_N": 0.7, "encoder.counts_per_rev": float(COUNTS)}
START |= {f"drive.{name}": value for name, value in LAW.model_dump().items()} | {"position_loop": 1.0}
TIME: Vector = np.arange(ROWS, dtype=np.float64) * SAMPLE_S
REFERENCE: Vector = 0.6 + 0.4 * (1.0 - np.cos(2.0 * np.pi * 2.1 * TIME))
# Steady, jumping, and different at every sample.
LOAD: Vector = 1e-3 * np.where(TIME < 0.1, 0.5, np.where(TIME < 0.2, 1.0, 0.2))
LOAD[300:] = 1e-3 * np.sin(np.arange(ROWS - 300) / 30.0)
OUTPUTS = (
    "theta_m_rad",
    "current_A",
    "theta_j_rad",
    "tension_N",
    "elongation_m",
    "omega_m_rad_per_s",
    "omega_j_rad_per_s",
)


def simulated(theta: Vector) -> Channels:
    """Return the project's own rows: the load of a row of the FMU, held over it, jumps at its start."""
    edges = np.flatnonzero(np.diff(LOAD) != 0.0)
    inputs = Inputs(TIME, REFERENCE, LOAD, edges, np.zeros(edges.size))
    start = closed_loop.rest(theta, 0.6, 0.7)
    return closed_loop.simulate(theta, closed_loop.law_vector(LAW), 2.0 * math.pi / COUNTS, inputs, start, 4)


def values_of(effect: Effect) -> dict[str, float]:
    return {f"effects.{effect.id}.{each.name}": each.typical for each in effect.parameters}


def theta_of(rig: Rig, values: dict[str, float]) -> Vector:
    theta = parameters.vector(rig)
    for name, value in values.items():
        theta[parameters.index(name)] = value
    return theta


def apart(made: Made, running: Run, rig: Rig, values: dict[str, float]) -> float:
    unit = running(made, {**START, **values, "tau_w_N_m": float(LOAD[0])})
    inputs = {"theta_m_ref_rad": REFERENCE[:-1], "tau_w_N_m": LOAD[1:]}
    rows = unit.run(SAMPLE_S, inputs, OUTPUTS)
    own = simulated(theta_of(rig, values))
    return max(float(np.abs(rows[name] - getattr(own, name)).max()) for name in OUTPUTS)


@pytest.mark.parametrize("effect", [each for each in EFFECTS if each.id != "channel_skew"], ids=lambda each: each.id)
def test_every_effect_is_as_in_the_projects_own_simulation(
    effect: Effect, plant_fmu: Made, running: Run, rig: Rig
) -> None:
    assert apart(plant_fmu, running, rig, values_of(effect)) <= AGREES


def test_the_plain_plant_and_many_effects_at_once(plant_fmu: Made, running: Run, rig: Rig) -> None:
    many = ("presliding_friction", "wire_slack", "wire_creep", "viscous_drift", "cogging", "encoder_scale")
    values = {name: value for each in EFFECTS if each.id in many for name, value in values_of(each).items()}
    assert apart(plant_fmu, running, rig, {}) <= AGREES
    assert apart(plant_fmu, running, rig, values) <= AGREES


def test_another_effect_is_not_as_in_that_simulation(plant_fmu: Made, running: Run, rig: Rig) -> None:
    unit = running(plant_fmu, {**START, "effects.cogging.sine_N_m": 1e-5, "tau_w_N_m": float(LOAD[0])})
    rows = unit.run(SAMPLE_S, {"theta_m_ref_rad": REFERENCE[:-1], "tau_w_N_m": LOAD[1:]}, ("theta_m_rad",))
    assert np.abs(rows["theta_m_rad"] - simulated(theta_of(rig, {})).theta_m_rad).max() > 1e3 * AGREES


def test_currents_from_outside_are_those_of_the_loop_inside(plant_fmu: Made, running: Run) -> None:
    inputs = {"theta_m_ref_rad": REFERENCE[:-1], "tau_w_N_m": LOAD[1:]}
    loop = running(plant_fmu, START).run(SAMPLE_S, inputs, ("theta_m_rad", "current_command_A"))
    outside = running(plant_fmu, {**START, "position_loop": 0.0})
    commands = {"current_ref_A": loop["current_command_A"][1:], "tau_w_N_m": LOAD[1:]}
    assert np.array_equal(outside.run(SAMPLE_S, commands, ("theta_m_rad",))["theta_m_rad"], loop["theta_m_rad"])


def test_one_long_communication_step_is_many_short_ones(plant_fmu: Made, running: Run) -> None:
    short, long = running(plant_fmu, START), running(plant_fmu, START)
    for unit in (short, long):
        unit.set({"theta_m_ref_rad": 0.9, "tau_w_N_m": 1e-3})
    for _ in range(10):
        short.step(SAMPLE_S)
    long.step(10 * SAMPLE_S)
    assert short.get(*OUTPUTS) == long.get(*OUTPUTS)


def test_a_parameter_that_changes_on_the_way_acts_from_there_on(plant_fmu: Made, running: Run) -> None:
    changed, as_it_was = running(plant_fmu, START), running(plant_fmu, START)
    for unit in (changed, as_it_was):
        unit.set({"theta_m_ref_rad": 0.9})
        unit.step(5 * SAMPLE_S)
    assert changed.get(*OUTPUTS) == as_it_was.get(*OUTPUTS)
    changed.set({"forceps.motor_inertia_kg_m2": 2e-6})
    for unit in (changed, as_it_was):
        unit.step(5 * SAMPLE_S)
    assert changed.get("theta_m_rad") != as_it_was.get("theta_m_rad")


def test_a_saved_state_goes_on_where_it_was_and_a_damaged_one_is_refused(plant_fmu: Made, running: Run) -> None:
    unit = running(plant_fmu, START)
    unit.set({"theta_m_ref_rad": 0.9})
    unit.step(20 * SAMPLE_S)
    state = unit.fmu.getFMUState()
    data = unit.fmu.serializeFMUState(state)
    unit.step(20 * SAMPLE_S)
    after = unit.get(*OUTPUTS)
    again = unit.fmu.deserializeFMUState(data)
    for each in (state, again):
        unit.fmu.setFMUState(each)
        unit.time_s = 20 * SAMPLE_S
        unit.step(20 * SAMPLE_S)
        assert unit.get(*OUTPUTS) == after
    for damaged in (data[:-1], data + b"\0", data[:2000] + bytes([data[2000] ^ 1]) + data[2001:], b""):
        with pytest.raises(FMICallException):
            unit.fmu.deserializeFMUState(damaged)


@pytest.mark.parametrize(
    ("values", "step_s"),
    [
        ({}, 1.5 * SAMPLE_S),
        ({}, 0.5 * SAMPLE_S),
        ({}, -SAMPLE_S),
        ({}, math.nan),
        ({"theta_m_ref_rad": math.nan}, SAMPLE_S),
        ({"forceps.motor_inertia_kg_m2": -1.0}, SAMPLE_S),
        ({"effects.actuation_delay.delay_s": 1e-3}, SAMPLE_S),  # fixed once it runs
        ({"theta_m_rad": 1.0}, SAMPLE_S),  # an output
        ({"tau_w_N_m": 1e308}, SAMPLE_S),  # diverges
    ],
)
def test_what_makes_no_sense_is_an_error(
    values: dict[str, float], step_s: float, plant_fmu: Made, running: Run
) -> None:
    unit = running(plant_fmu, START)

    def refused() -> None:
        unit.set(values)
        unit.step(step_s)

    with pytest.raises(FMICallException):
        refused()


def test_fmi_3_computes_the_same(make: Make, running: Run, rig: Rig, plant_fmu: Made) -> None:
    results: list[Any] = []
    for made in (plant_fmu, make(plant_unit(rig, SAMPLE_S), 3)):
        unit = running(made, START)
        inputs = {"theta_m_ref_rad": REFERENCE[:100], "tau_w_N_m": LOAD[:100]}
        results.append(unit.run(SAMPLE_S, inputs, OUTPUTS))
    for name in OUTPUTS:
        assert np.array_equal(results[0][name], results[1][name])
