"""Truth plant against the mind's model: two implementations of the catalogue, held together as both steps shrink.

They share neither method nor friction: the world takes RK4 steps cut where a body stops, the model exact steps of the
linear plant. What is left between them is measured in shares of what the effect itself does.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.model import closed_loop, parameters
from hil_forceps.rig import Rig
from hil_forceps.rig.catalogue import EFFECTS
from tests.hidden_effects.generator import RIG, true_rig
from virtual_bus.drive import loop_of
from virtual_bus.effects.composition import encoder_angle
from virtual_bus.effects.numbers import effect_numbers
from virtual_bus.effects.start import rest_with_effects
from virtual_bus.logs import TRUTH_COLUMNS, Log, simulated_log
from virtual_bus.plant.load import piecewise_linear
from virtual_bus.plant.plant import truth_parameters

Vector = NDArray[np.float64]
ROWS, ROW_S = 1500, 1.0e-3
EDGES_S = np.array([0.70037, 0.95081, 1.20043, 1.35059])  # between the rows
LEVELS_N_M = (-1.5e-3, 1.0e-3, 2.5e-3, -1.0e-3, 0.5e-3)
TIME_S = np.arange(ROWS, dtype=np.float64) * ROW_S
CHANNELS = ("theta_m_rad", "current_A", "theta_j_rad")
STEPS = ((5.0e-5, 4), (1.25e-5, 32))  # of the world in s, of the model in a row

CASES = {entry.id: {p.name: p.typical for p in entry.parameters} for entry in EFFECTS} | {
    "current_saturation": {"limit_A": 0.25},
    "channel_skew": {"theta_m_s": 2.0e-3, "current_s": 3.0e-3, "theta_j_s": -1.0e-3},
}
# Shares at the finer steps. Friction that falls with speed makes stops and starts unstable: any difference grows.
WORST = {"stribeck_friction": 5.0e-3}
USUAL = 5.0e-4


class Difference(NamedTuple):
    """Root mean squares over the rows: between world and model, and of what the effect does."""

    apart: Vector
    effect: Vector


def load_and_edges() -> tuple[list[float], list[float]]:
    time, level = [0.0, 0.2, 0.4, 0.6], [0.0, 0.0, 2.0e-3, LEVELS_N_M[0]]
    for edge, before, after in zip(EDGES_S.tolist(), LEVELS_N_M[:-1], LEVELS_N_M[1:], strict=True):
        time += [edge, edge]
        level += [before, after]
    return time, level


def reference(start_rad: float) -> Vector:
    swing = 0.35 * (1.0 - np.cos(2.0 * math.pi * 1.6 * TIME_S)) + 0.05 * np.sin(2.0 * math.pi * 5.0 * TIME_S)
    return np.asarray(start_rad + swing)


def world(rig: Rig, step_s: float, lead: int) -> tuple[float, Vector, Log]:
    """Return θ_enc at the start, the reference of the rows and the log: at rest for `lead` samples before."""
    p, e = truth_parameters(rig.plant(), step_s), effect_numbers(rig.effects)
    start = float(encoder_angle(e, float(rest_with_effects(p, e, 0.0)[0])))
    course = reference(start)
    samples = np.concatenate([np.full(lead, start), course, np.full(10, course[-1])])
    load = piecewise_linear(*load_and_edges())
    return start, course, simulated_log(p, e, loop_of(rig), 0.0, samples, load, slice(lead, lead + ROWS), 0.0, step_s)


def mind(rig: Rig, start_rad: float, course: Vector, log: Log, substeps: int) -> closed_loop.Channels:
    """Run the model from the state that the log begins with, under the load that it says."""
    t = dict(zip(TRUTH_COLUMNS, log.truth[0].tolist(), strict=True))
    plant = closed_loop.State(
        t["theta_m"], t["omega_m"], t["theta_j"], t["omega_j"], t["creep"], t["hysteresis"], t["presliding"],
        t["loaded"], t["gripped"], t["behind"], t["current_A"],
    )  # fmt: skip
    drive = closed_loop.DriveState(0.0, start_rad, 0.0, t["current_A"])
    rows = np.floor(EDGES_S / ROW_S).astype(np.int64)
    inputs = closed_loop.Inputs(
        TIME_S, course, log.truth[:, TRUTH_COLUMNS.index("tau_w_N_m")], rows, EDGES_S / ROW_S - rows
    )
    law = closed_loop.law_vector(rig.require_drive())
    return closed_loop.simulate(parameters.vector(rig), law, 0.0, inputs, closed_loop.Start(plant, drive), substeps)


@lru_cache(maxsize=4)
def without(step_s: float) -> Log:
    return world(RIG, step_s, 1)[2]


def rms(values: Vector) -> float:
    return float(np.sqrt(np.mean(values[5:-5] ** 2)))


def compare(effects: dict[str, dict[str, float]], step_s: float, substeps: int) -> Difference:
    rig = true_rig(RIG, effects, {})
    start, course, log = world(rig, step_s, 5 if "channel_skew" in effects else 1)
    channels = mind(rig, start, course, log, substeps)
    apart = [rms(getattr(channels, name) - getattr(log, name)) for name in CHANNELS]
    effect = [rms(getattr(log, name) - getattr(without(step_s), name)) for name in CHANNELS]
    return Difference(np.array(apart), np.array(effect))


def test_without_effects_they_agree_to_rounding_of_the_steps() -> None:
    coarse, fine = (compare({}, *steps).apart for steps in STEPS)
    assert (fine < np.array([1.0e-8, 1.0e-7, 1.0e-8])).all()
    assert (fine < 0.1 * coarse).all()


@pytest.mark.parametrize("name", CASES)
def test_each_effect_is_the_same_in_world_and_model(name: str) -> None:
    coarse, fine = (compare({name: CASES[name]}, *steps) for steps in STEPS)
    shown = fine.effect > np.array([1.0e-6, 1.0e-6, 1.0e-6])  # a channel that the effect doesn't touch says nothing
    assert shown.any()
    share, before = fine.apart[shown] / fine.effect[shown], coarse.apart[shown] / coarse.effect[shown]
    assert (share < WORST.get(name, USUAL)).all()
    assert ((share < 0.5 * before) | (share < 1.0e-6)).all()
    assert (fine.apart[~shown] < 1.0e-6).all()


def test_several_effects_at_once_are_the_same() -> None:
    names = (
        "presliding_friction", "load_dependent_friction", "jaw_gravity", "wire_hardening", "wire_damping",
        "torque_ripple", "electrical_lag", "actuation_delay", "encoder_eccentricity", "pulley_eccentricity",
        "transmission_play", "transmission_curve", "jaw_coupling", "loaded_presliding", "viscous_asymmetry",
        "jaw_presliding", "jaw_viscous_friction",
    )  # fmt: skip
    fine = compare({name: CASES[name] for name in names}, *STEPS[1])
    assert (fine.apart < USUAL * fine.effect).all()


def test_a_wrong_sign_would_be_seen() -> None:
    """The comparison itself: a model with half the effect is far outside what is allowed."""
    rig = true_rig(RIG, {"cogging": CASES["cogging"]}, {})
    half = true_rig(RIG, {"cogging": CASES["cogging"] | {"sine_N_m": 0.5e-4}}, {})
    start, course, log = world(rig, 5.0e-5, 1)
    channels = mind(half, start, course, log, 4)
    apart = rms(channels.theta_m_rad - log.theta_m_rad)
    assert apart > 0.1 * rms(log.theta_m_rad - without(5.0e-5).theta_m_rad)
