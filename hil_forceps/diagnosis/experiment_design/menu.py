"""The menu of safe experiments: what each excites, what the operator does, and its motion within a rig's limits.

Motions are piecewise linear, as `hil-forceps run --trajectory` plays them. None comes nearer than a twentieth of the
range to a bound, and none asks for more speed or acceleration than half of what the limits and the motor allow.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.control.trajectories import Trajectory
from hil_forceps.rig import Rig

Vector = NDArray[np.float64]

POINT_S = 2.0e-3  # between points of a motion
ROOM = 0.9  # of the range between the bounds
SHARE = 0.5  # of the speed and the acceleration that are allowed
EASE_S = 0.5  # a motion begins and ends at rest
MIN_TURNS = 1.5  # from end to end; fewer are no spin
MAX_TURNS = 6.0
LOAD_SHARE = 0.25  # of what the motor can hold
DURATION_S = 12.0


class Bounds(NamedTuple):
    """What a motion must stay within; angle, speed and acceleration of the motor pulley."""

    low_rad: float
    high_rad: float
    speed_rad_per_s: float
    acceleration_rad_per_s2: float
    load_N_m: float  # at the jaw, what the motor holds with ease
    tick_s: float  # between two references

    @property
    def middle_rad(self) -> float:
        """Where motions begin."""
        return 0.5 * (self.low_rad + self.high_rad)

    @property
    def reach_rad(self) -> float:
        """How far motions go from the middle."""
        return 0.5 * ROOM * (self.high_rad - self.low_rad)


class Experiment(NamedTuple):
    """One entry of the menu; columns are points of straight lines."""

    name: str
    excites: str
    instruction: str  # to the operator, one line
    time_s: Vector
    theta_m_rad: Vector
    load_N_m: Vector  # what the operator puts on the jaw, as planned; it has to be measured
    turned_over: bool = False  # the forceps lies on its other side

    @property
    def loaded(self) -> bool:
        """Whether the jaw's load has to be measured."""
        return bool(np.any(self.load_N_m != 0.0))


def bounds_of(rig: Rig, seen_low_rad: float, seen_high_rad: float) -> Bounds:
    """Return what motions of a rig must stay within.

    A rig without `limits:` moves no further than it did in the runs (`seen_*`). UserError when plant values or the
    drive aren't known.
    """
    limits, plant, law = rig.limits, rig.plant(), rig.require_drive()
    chosen = "limits" in rig.model_fields_set
    low, high = (limits.position_min_rad, limits.position_max_rad) if chosen else (seen_low_rad, seen_high_rad)
    torque = plant.torque_constant_N_m_per_A * law.current_limit_A
    ratio = plant.motor_pulley_radius_m / plant.jaw_pulley_radius_m
    viscous = plant.motor_viscous_N_m_s_per_rad
    inertia = plant.motor_inertia_kg_m2 + ratio * ratio * plant.jaw_inertia_kg_m2
    reachable = torque / viscous if viscous > 0.0 else math.inf
    return Bounds(
        low,
        high,
        SHARE * min(limits.speed_max_rad_per_s, reachable),
        SHARE * min(limits.acceleration_max_rad_per_s2, torque / inertia),
        LOAD_SHARE * torque / ratio,
        rig.bench.host_period_s,
    )


def menu(bounds: Bounds) -> tuple[Experiment, ...]:
    """Return the experiments that these bounds allow; those without motion are always among them."""
    if not bounds.high_rad > bounds.low_rad:
        raise ValueError(f"no range to move in: {bounds.low_rad} to {bounds.high_rad} rad")
    offered = [_shrunk(entry(bounds), bounds) for entry in _ENTRIES]
    return tuple(e for e in offered if e.name != "multi_turn_spin" or np.ptp(e.theta_m_rad) >= MIN_TURNS * math.tau)


def _haste(experiment: Experiment, bounds: Bounds) -> float:
    """Return the highest speed or acceleration over what is allowed, whichever is worse."""
    speed = np.diff(experiment.theta_m_rad) / np.diff(experiment.time_s)
    change = np.diff(np.concatenate(([0.0], speed, [0.0]))) / bounds.tick_s
    fastest, hardest = float(np.abs(speed).max()), float(np.abs(change).max())
    return max(fastest / bounds.speed_rad_per_s, hardest / bounds.acceleration_rad_per_s2)


def _shrunk(experiment: Experiment, bounds: Bounds) -> Experiment:
    """Return the motion made as much smaller as speed and acceleration ask."""
    most, haste = 0.999, _haste(experiment, bounds)  # room for rounding
    if haste <= most:
        return experiment
    smaller = bounds.middle_rad + (experiment.theta_m_rad - bounds.middle_rad) * (most / haste)
    return experiment._replace(theta_m_rad=smaller)


def trajectory_of(experiment: Experiment, rig: Rig) -> Trajectory:
    """Return the jaw angles that make `run` give this motion of the motor; points on a straight line are left out."""
    plant = rig.plant()
    ratio = plant.motor_pulley_radius_m / plant.jaw_pulley_radius_m
    time, angle = experiment.time_s, experiment.theta_m_rad
    bend = np.abs(np.diff(angle, 2)) > 1e-12
    kept = np.concatenate(([True], bend, [True]))
    return Trajectory(tuple(time[kept].tolist()), tuple((ratio * angle[kept]).tolist()))


def _grid(duration_s: float) -> Vector:
    return np.linspace(0.0, duration_s, round(duration_s / POINT_S) + 1)


def _ease(time: Vector) -> Vector:
    """Rise smoothly from 0 to 1 and fall again at the end."""
    s: Vector = np.clip(np.minimum(time, time[-1] - time) / EASE_S, 0.0, 1.0)
    return s * s * s * (10.0 + s * (6.0 * s - 15.0))


def _levels(b: Bounds, levels: Sequence[float], speed_rad_per_s: float, hold_s: float) -> tuple[Vector, Vector]:
    """Go from level to level (in reaches from the middle) at a constant speed, rounded, and hold there."""
    at, angle = [0.0, EASE_S], [b.middle_rad, b.middle_rad]
    for level in levels:
        to = b.middle_rad + b.reach_rad * level
        there = at[-1] + abs(to - angle[-1]) / speed_rad_per_s
        at += [there, there + hold_s]
        angle += [to, to]
    time = _grid(at[-1])
    return time, _rounded(time, at, angle)


def _rounded(time: Vector, at: Sequence[float], values: Sequence[float]) -> Vector:
    """Return straight lines with their corners rounded over 40 ms."""
    total: Vector = np.zeros(time.size)
    for shift in np.linspace(-0.02, 0.02, 21):
        total += np.interp(time + shift, at, values)
    return np.asarray(total / 21.0, dtype=np.float64)


def _still(time: Vector) -> Vector:
    return np.zeros(time.size)


def _spin(b: Bounds) -> Experiment:
    time = _grid(DURATION_S)
    swing = np.sin(math.tau * 2.0 * time / DURATION_S)
    return Experiment(
        "multi_turn_spin",
        "what repeats with each turn or grows with wound turns: pulleys, encoder, cogging",
        "Take the jaw off its stops, or let it go round; keep hands away.",
        time,
        b.middle_rad + min(b.reach_rad, 0.5 * MAX_TURNS * math.tau) * _ease(time) * swing,
        _still(time),
    )


def _slow(b: Bounds) -> Experiment:
    time, angle = _levels(b, (1.0, -1.0, 0.0, 1.0, 0.0, -1.0, 0.0), b.reach_rad, 0.6)
    return Experiment(
        "slow_ramps_and_holds",
        "friction at low speed, its dependence on angle and direction, creep while holding",
        "Leave the jaw free.",
        time,
        angle,
        _still(time),
    )


def _chirp(b: Bounds) -> Experiment:
    time = _grid(DURATION_S)
    low, high = 0.3, 40.0
    rate = math.log(high / low) / DURATION_S
    omega = math.tau * low * np.exp(rate * time)
    phase = (omega - omega[0]) / rate
    reach = min(b.reach_rad, 0.5) * np.exp(-0.5 * rate * time)
    allowed = 0.5 * np.minimum(b.speed_rad_per_s / omega, b.acceleration_rad_per_s2 / omega**2)
    return Experiment(
        "chirp",
        "delays, lags and skews, inertia, damping and stiffness of the wire",
        "Leave the jaw free.",
        time,
        b.middle_rad + np.minimum(reach, allowed) * _ease(time) * np.sin(phase),
        _still(time),
    )


def _hold_and_release(b: Bounds) -> Experiment:
    time = _grid(DURATION_S)
    times = np.array([0.0, 1.0, 1.2, 2.4, 2.404, 4.0, 4.2, 5.4, 5.404, 7.0, 7.2, 8.4, 8.404, 9.6, 9.8, 11.0, 11.004])
    levels = np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0, -1.0, -1.0, 0.0, 0.0, 0.5, 0.5, 0.0, 0.0, -0.5, -0.5, 0.0])
    return Experiment(
        "load_hold_and_release",
        "the wire: stiffness, slack, hardening, hysteresis, creep; friction that grows with tension",
        f"Press the jaw to {1e3 * b.load_N_m:.2g} mN m on the load cell, hold a second, let go; both ways, then half.",
        time,
        np.full(time.size, b.middle_rad),
        b.load_N_m * np.interp(time, times, levels),
    )


def _warm_up(b: Bounds) -> Experiment:
    time = _grid(60.0)  # long enough for a motor to warm up
    return Experiment(
        "warm_up",
        "what changes with time and heat: torque constant, viscous friction",
        "Begin with a cold motor; leave the jaw free.",
        time,
        b.middle_rad + b.reach_rad * _ease(time) * np.sin(1.5 * math.tau * time),
        _still(time),
    )


def _turned_over(b: Bounds) -> Experiment:
    slow = _slow(b)
    return slow._replace(
        name="orientation_flip",
        excites="the jaw's weight, which changes sign; friction doesn't",
        instruction="Turn the forceps upside down, so that the jaw's weight pulls the other way; leave the jaw free.",
        turned_over=True,
    )


def _known_spring(b: Bounds) -> Experiment:
    time = _grid(DURATION_S)
    swing = _ease(time) * np.sin(math.tau * 0.5 * time)
    return Experiment(
        "known_spring",
        "what grows with load against what grows with angle: stiffness, gains, load-dependent friction",
        f"Hook a spring to the jaw that gives {1e3 * b.load_N_m:.2g} mN m at the ends of its motion; log the load.",
        time,
        b.middle_rad + b.reach_rad * swing,
        -b.load_N_m * swing,
    )


def _small_motions(b: Bounds) -> Experiment:
    time = _grid(DURATION_S)
    at, level = [0.0, EASE_S], [0.0, 0.0]
    for k, to in enumerate((-0.8, -0.4, 0.0, 0.4, 0.8)):
        at += [2.3 * k + 1.0, 2.3 * k + 2.6]
        level += [to, to]
    base = _rounded(time, at, level)
    small = 0.05 * np.sin(math.tau * 2.0 * time) * _ease(time)
    return Experiment(
        "small_motions",
        "presliding, backlash, and whatever depends on the angle, at each angle by itself",
        "Leave the jaw free.",
        time,
        b.middle_rad + b.reach_rad * (base + small),
        _still(time),
    )


def _rest(b: Bounds) -> Experiment:
    time = _grid(DURATION_S)
    return Experiment(
        "rest",
        "offsets and noise of the sensors",
        "Touch nothing.",
        time,
        np.full(time.size, b.middle_rad),
        _still(time),
    )


_ENTRIES: tuple[Callable[[Bounds], Experiment], ...] = (
    _spin,
    _slow,
    _chirp,
    _hold_and_release,
    _warm_up,
    _turned_over,
    _known_spring,
    _small_motions,
    _rest,
)
