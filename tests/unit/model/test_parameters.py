"""One vector for everything that can be fitted."""

import math
from pathlib import Path

import numpy as np
import pytest

from hil_forceps.model import parameters
from hil_forceps.model.composition import Physics
from hil_forceps.rig import UserError, load_rig
from hil_forceps.rig.catalogue import EFFECTS
from hil_forceps.rig.loading import dump_rig, parse_rig

RIG = load_rig(Path(__file__).parents[3] / "configs" / "paper.yaml")


def test_every_value_has_its_place_in_the_order_of_the_kernels() -> None:
    assert len(parameters.NAMES) == len(set(parameters.NAMES)) == 9 + sum(len(entry.parameters) for entry in EFFECTS)
    assert len(Physics._fields) == len(parameters.NAMES)
    assert [parameters.index(name) for name in parameters.NAMES] == list(range(len(parameters.NAMES)))
    effects = [
        name.removeprefix("effects.").replace(".", "_") for name in parameters.NAMES if name.startswith("effects.")
    ]
    assert list(Physics._fields[-len(effects) :]) == effects
    # Names of the plant's numbers are the paper's symbols, but the order can be told from some.
    for short, name in (
        ("r_m", "forceps.motor_pulley_radius_m"),
        ("D_m", "forceps.motor_viscous_N_m_s_per_rad"),
        ("k", "forceps.wire_stiffness_N_per_m"),
        ("K_t", "motor.torque_constant_N_m_per_A"),
    ):
        assert Physics._fields.index(short) == parameters.index(name)


def test_effects_of_a_rig_are_in_its_vector_and_the_rest_is_off() -> None:
    rig = RIG.with_changes(
        {"effects": {"wire_creep": {"time_constant_s": 3.0}, "cogging": {"sine_N_m": 1e-5, "harmonic": 4}}}
    )
    theta = parameters.vector(rig)
    at = {
        name: theta[parameters.index(f"effects.{name}")]
        for name in ("cogging.sine_N_m", "cogging.harmonic", "wire_creep.share")
    }
    assert at == {"cogging.sine_N_m": 1e-5, "cogging.harmonic": 4.0, "wire_creep.share": 0.0}
    assert theta[parameters.index("effects.current_saturation.limit_A")] == math.inf
    assert np.array_equal(parameters.vector(RIG)[9:], parameters.neutral())


def test_a_rig_that_does_not_know_a_value_has_no_vector() -> None:
    with pytest.raises(UserError, match=r"forceps\.wire_stiffness_N_per_m"):
        parameters.vector(RIG.with_changes({"forceps.wire_stiffness_N_per_m": "unknown"}))


def test_vector_goes_into_a_rig_and_a_file_and_back() -> None:
    theta = parameters.vector(RIG)
    theta[parameters.index("forceps.wire_stiffness_N_per_m")] = 2.5e4
    theta[parameters.index("effects.wire_slack.half_width_m")] = 3e-6
    theta[parameters.index("effects.wire_damping.damping_N_s_per_m")] = 0.2
    rig = parameters.rig_with(RIG, theta, ["wire_slack"])
    assert rig.effects == {"wire_slack": {"half_width_m": 3e-6}}
    again = parameters.vector(parse_rig(dump_rig(rig)))
    theta[parameters.index("effects.wire_damping.damping_N_s_per_m")] = 0.0
    assert np.array_equal(again, theta)


def test_every_effect_at_its_typical_size_loads_back_from_a_file() -> None:
    theta = np.concatenate((parameters.vector(RIG)[:9], [p.typical for entry in EFFECTS for p in entry.parameters]))
    rig = parameters.rig_with(RIG, theta, [entry.id for entry in EFFECTS])
    assert np.array_equal(parameters.vector(parse_rig(dump_rig(rig))), theta)


def test_an_effect_that_is_not_in_the_catalogue_is_a_wrong_call() -> None:
    with pytest.raises(ValueError, match="gremlins"):
        parameters.rig_with(RIG, parameters.vector(RIG), ["gremlins"])
