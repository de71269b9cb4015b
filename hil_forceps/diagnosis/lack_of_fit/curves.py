"""Smooth curves over many variables, at every place: no physics is in them but the place where they act.

A catalogue can't hold everything. When they explain more of the residual than chance gives, something is there that no
entry explains, and the best curve says over what.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from hil_forceps.diagnosis.course import Course
from hil_forceps.diagnosis.state_space.kernel import kernel

Vector = NDArray[np.float64]

WAVES = 5
TURNS = range(1, 4)  # harmonics of a turn
FINE, FINEST = range(4, 13), range(13, 25)  # of poles, slots and gears
MEMORIES_S = (0.02, 0.1, 0.5, 2.0)
MEMORY_SHARES = (0.01, 0.05, 0.2)  # of the range: memories over a way
SHORT_SHARES = (0.0003, 0.003)  # the direction itself, at rest that of the last motion
SHARP = 0.003  # of top speed: slow motion beside fast turns has a direction, too
HIGH = (0.8, 0.9, 0.95, 0.98)  # of the largest current: what lies beyond shows by itself


class Scale(NamedTuple):
    """Ranges over all runs."""

    theta_m: tuple[float, float]
    theta_j: tuple[float, float]
    omega_m: float
    omega_j: float
    stretch_m: float
    tension_N: float
    current_A: float
    duration_s: float


class Curve(NamedTuple):
    """A family of curves: where it acts, over which variable, and its members for a run."""

    place: str  # motor, wire, jaw, or the channel that it is added to
    variable: str
    members: Callable[[Course, Scale], list[Vector]]


def scale_of(courses: Sequence[Course]) -> Scale:
    """Return the ranges of all runs."""

    def span(values: list[Vector]) -> tuple[float, float]:
        low, high = min(float(v.min()) for v in values), max(float(v.max()) for v in values)
        return low, max(high, low + 1e-9)

    def top(values: list[Vector]) -> float:
        return max([1e-12, *(float(np.abs(v).max()) for v in values)])

    return Scale(
        span([c.theta_m for c in courses]),
        span([c.theta_j for c in courses]),
        top([c.omega_m for c in courses]),
        top([c.omega_j for c in courses]),
        top([c.stretch_m for c in courses]),
        top([c.tension_N for c in courses]),
        top([c.current_A for c in courses]),
        max(float(c.time_s[-1]) for c in courses),
    )


def _waves(x: Vector, span: tuple[float, float]) -> list[Vector]:
    phase = np.pi * (x - span[0]) / (span[1] - span[0])
    return [np.cos(k * phase) for k in range(1, WAVES + 1)]


def _round(x: Vector, harmonics: Sequence[int] = TURNS) -> list[Vector]:
    return [wave(k * x) for k in harmonics for wave in (np.sin, np.cos)]


def _ripple(c: Course, top: float, harmonics: Sequence[int]) -> list[Vector]:
    return [c.current_A / top * wave for wave in _round(c.theta_m, harmonics)]


def _sign(omega: Vector, top: float) -> Vector:
    return np.asarray(np.tanh(omega / (SHARP * top)))


@kernel
def memory_over_way(x: Vector, length: float) -> Vector:
    """Return the direction of motion, which after each reversal takes a way of `length` to be forgotten."""
    z = np.zeros(x.size)
    for row in range(1, x.size):
        way = x[row] - x[row - 1]
        direction = 1.0 if way > 0.0 else -1.0
        z[row] = z[row - 1] if way == 0.0 else direction + (z[row - 1] - direction) * math.exp(-abs(way) / length)
    return z


def _memories(x: Vector, span: tuple[float, float], shares: Sequence[float]) -> list[Vector]:
    return [memory_over_way(x, share * (span[1] - span[0])) for share in shares]


def _slow(x: Vector, period_s: float, time_s: float) -> Vector:
    share = -np.expm1(-period_s / time_s)
    return np.asarray(lfilter([share], [1.0, share - 1.0], x))


def all_curves() -> tuple[Curve, ...]:
    """Return the families."""
    return (
        Curve("motor", "theta", lambda c, s: _waves(c.theta_m, s.theta_m)),
        Curve(
            "motor",
            "theta and direction",
            lambda c, s: [w * _sign(c.omega_m, s.omega_m) for w in _waves(c.theta_m, s.theta_m)],
        ),
        Curve("motor", "turn", lambda c, _: _round(c.theta_m)),
        Curve("motor", "4 to 12 times a turn", lambda c, _: _round(c.theta_m, FINE)),
        Curve("motor", "13 to 24 times a turn", lambda c, _: _round(c.theta_m, FINEST)),
        Curve("motor", "current and turn", lambda c, s: _ripple(c, s.current_A, TURNS)),
        Curve("motor", "current and 4 to 12 times a turn", lambda c, s: _ripple(c, s.current_A, FINE)),
        Curve("motor", "current and 13 to 24 times a turn", lambda c, s: _ripple(c, s.current_A, FINEST)),
        Curve("motor", "omega", lambda c, s: _over_speed(c.omega_m, s.omega_m)),
        Curve(
            "motor",
            "tension and direction",
            lambda c, s: [np.abs(c.tension_N) ** n * _sign(c.omega_m, s.omega_m) / s.tension_N**n for n in (1, 2, 3)],
        ),
        Curve("motor", "high current", lambda c, s: _high_current(c.current_A, s.current_A)),
        Curve("motor", "time", lambda c, s: [w * v for w in _over_time(c, s) for v in (c.omega_m, c.current_A)]),
        Curve(
            "motor",
            "memory of motion",
            lambda c, s: _memories(c.theta_m, s.theta_m, MEMORY_SHARES),
        ),
        Curve(
            "motor",
            "tension and memory of motion",
            lambda c, s: [np.abs(c.tension_N) * z for z in _memories(c.theta_m, s.theta_m, MEMORY_SHARES)],
        ),
        Curve("motor", "rate of current", lambda c, _: _rates(c.current_A)),
        Curve(
            "wire", "tension", lambda c, s: [c.tension_N * np.abs(c.tension_N) ** n / s.tension_N**n for n in (1, 2, 3)]
        ),
        Curve(
            "wire",
            "sign of tension",
            lambda c, s: [np.tanh(c.tension_N / (share * s.tension_N)) for share in (0.01, 0.05, 0.2)],
        ),
        Curve("wire", "memory of tension", lambda c, _: [_slow(c.tension_N, c.period_s, t) for t in MEMORIES_S]),
        Curve(
            "wire",
            "memory of stretch",
            lambda c, s: _memories(c.stretch_m, (0.0, s.stretch_m), MEMORY_SHARES),
        ),
        Curve("wire", "direction", lambda c, s: _memories(c.theta_m, s.theta_m, SHORT_SHARES)),
        Curve("wire", "theta", lambda c, s: _waves(c.theta_m, s.theta_m)),
        Curve("wire", "turn", lambda c, _: _round(c.theta_m)),
        Curve("wire", "jaw's turn", lambda c, _: _round(c.theta_j)),
        Curve("jaw", "theta", lambda c, s: _waves(c.theta_j, s.theta_j)),
        Curve(
            "jaw",
            "theta and direction",
            lambda c, s: [w * _sign(c.omega_j, s.omega_j) for w in _waves(c.theta_j, s.theta_j)],
        ),
        Curve("jaw", "turn", lambda c, _: _round(c.theta_j)),
        Curve("jaw", "omega", lambda c, s: _over_speed(c.omega_j, s.omega_j)),
        Curve("jaw", "memory of motion", lambda c, s: _memories(c.theta_j, s.theta_j, MEMORY_SHARES)),
        Curve(
            "jaw",
            "tension and direction",
            lambda c, s: [
                np.abs(c.tension_N) * z for z in _memories(c.theta_j, s.theta_j, (*SHORT_SHARES, *MEMORY_SHARES))
            ],
        ),
        Curve("jaw", "load", lambda c, _: [c.load_N_m, _slow(c.load_N_m, c.period_s, 0.1)]),
        Curve("theta_m_rad", "turn", lambda c, _: _round(c.theta_m)),
        Curve("theta_m_rad", "theta", lambda c, s: _waves(c.theta_m, s.theta_m)),
        Curve("theta_j_rad", "theta", lambda c, s: _waves(c.theta_j, s.theta_j)),
        Curve("current_A", "current", lambda c, s: _over_current(c.current_A, s.current_A)),
        Curve("current_A", "high current", lambda c, s: _high_current(c.current_A, s.current_A)),
        Curve("current_A", "rate", lambda c, _: _rates(c.current_A)),
        # No constant at theta_j_rad: the zero of the jaw's sensor is a state of the filter, or fitted run by run.
        # By the row before: what looks ahead would see the innovations that are tested.
        Curve("wire", "rate of stretch", lambda c, _: [np.diff(c.stretch_m, prepend=c.stretch_m[0])]),
        Curve("theta_j_rad", "rate", lambda c, _: [c.omega_j, np.diff(c.omega_j, prepend=c.omega_j[0])]),
    )


def _over_speed(omega: Vector, top: float) -> list[Vector]:
    sign = _sign(omega, top)
    falling = [sign * np.exp(-((omega / (share * top)) ** 2)) for share in (0.03, 0.1, 0.3)]
    return [sign, np.abs(sign), *falling, omega * np.abs(omega) / top]


def _over_time(c: Course, s: Scale) -> list[Vector]:
    return [np.cos(k * np.pi * c.time_s / s.duration_s) for k in (1, 2, 3)]


def _over_current(i: Vector, top: float) -> list[Vector]:
    return [np.ones_like(i), i, np.abs(i), np.tanh(i / (0.03 * top)), i**3 / top**2]


def _high_current(i: Vector, top: float) -> list[Vector]:
    return [np.sign(i) * np.maximum(np.abs(i) - share * top, 0.0) for share in HIGH]


def _rates(i: Vector) -> list[Vector]:
    first = np.diff(i, prepend=i[0])
    return [first, np.diff(first, prepend=0.0), np.roll(first, 1), np.roll(first, 2)]
