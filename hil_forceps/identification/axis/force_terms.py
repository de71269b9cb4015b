"""What force an axis takes, term by term: linear in its coefficients, but for the few numbers of `Shape`.

Mass, friction and offset as published for EMPS (Janot, Gautier and Brunot, *Data set and reference models of EMPS*,
eq. 1, and eq. 12 for friction that differs by direction). Friction at low speed has the form of Stribeck's curve, with
either sign; the ripple is once and twice per turn of the motor; friction and force over the path are parabolas.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]


class Law(NamedTuple):
    """Which terms a model has beyond mass, viscous and Coulomb friction."""

    asymmetric: bool = False  # friction of its own in each direction
    dead_time: bool = False  # the force acts later than it is written down
    low_speed: bool = False  # friction is another near standstill
    ripple: bool = False  # force periodic in the path
    position: bool = False  # force and friction vary along the path


class Shape(NamedTuple):
    """Numbers that a model is not linear in."""

    dead_time_s: float = 0.0  # half a sample of hold is part of it
    low_speed_m_per_s: float = 0.015
    ripple_period_m: float = 2.5e-3
    middle_m: float = 0.0  # of the path
    half_path_m: float = 1.0


class Motion(NamedTuple):
    """Position and its derivatives, arrays [samples]."""

    position_m: Vector
    speed_m_per_s: Vector
    acceleration_m_per_s2: Vector


# Every term that a law can have, in the order in which `axis_vector` gives them to the simulation.
FRICTION = ("viscous_forward_N_s_per_m", "coulomb_forward_N", "viscous_backward_N_s_per_m", "coulomb_backward_N")
SYMMETRIC = ("viscous_N_s_per_m", "coulomb_N", "offset_N")
RIPPLE = ("ripple_cos_N", "ripple_sin_N", "ripple_twice_cos_N", "ripple_twice_sin_N")
POSITION = ("path_force_N", "path_force_bent_N", "path_friction_N", "path_friction_bent_N")


def terms(law: Law) -> tuple[str, ...]:
    """Return the names of a law's coefficients, in their order."""
    friction = FRICTION if law.asymmetric else SYMMETRIC
    low = ("low_speed_N",) if law.low_speed else ()
    return ("mass_kg", *friction, *low, *(RIPPLE if law.ripple else ()), *(POSITION if law.position else ()))


def column(name: str, motion: Motion, shape: Shape) -> Vector:
    """Return what one unit of a term takes over a motion [samples]; KeyError when there is no such term."""
    position, speed, acceleration = motion
    sign = np.sign(speed)
    forward = 0.5 * (1.0 + sign)
    if name in RIPPLE:
        phase = 2.0 * math.pi * position / shape.ripple_period_m * (2.0 if "twice" in name else 1.0)
        return np.cos(phase) if "cos" in name else np.sin(phase)
    if name in POSITION:
        way = (position - shape.middle_m) / shape.half_path_m
        return (way**2 if "bent" in name else way) * (sign if "friction" in name else 1.0)
    plain: dict[str, Vector] = {
        "mass_kg": acceleration,
        "viscous_N_s_per_m": speed,
        "coulomb_N": sign,
        "offset_N": np.ones_like(speed),
        "viscous_forward_N_s_per_m": speed * forward,
        "coulomb_forward_N": sign * forward,
        "viscous_backward_N_s_per_m": speed * (1.0 - forward),
        "coulomb_backward_N": sign * (1.0 - forward),
        "low_speed_N": sign * np.exp(-((speed / shape.low_speed_m_per_s) ** 2)),
    }
    return plain[name]


def axis_vector(coefficients: Mapping[str, float], shape: Shape) -> Vector:
    """Return the numbers of an axis in the order of `open_loop`'s kernel; terms that aren't there are 0."""
    values = dict(coefficients)
    if "offset_N" in values:  # a symmetric law is an asymmetric one whose Coulomb frictions differ by the offset
        for way, sign in (("forward", 1.0), ("backward", -1.0)):
            values[f"viscous_{way}_N_s_per_m"] = values["viscous_N_s_per_m"]
            values[f"coulomb_{way}_N"] = values["coulomb_N"] + sign * values["offset_N"]
    ordered = [values.get(name, 0.0) for name in ("mass_kg", *FRICTION, "low_speed_N", *RIPPLE, *POSITION)]
    waves = 2.0 * math.pi / shape.ripple_period_m
    return np.array([*ordered, shape.low_speed_m_per_s, waves, shape.middle_m, shape.half_path_m])
