"""What a hidden-effect run does: the reference of the drive and the load on the jaw, drawn from a kind and a seed."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from virtual_bus.effects.physics import Environment
from virtual_bus.plant.load import LoadProfile, piecewise_linear

Vector = NDArray[np.float64]
NO_ENVIRONMENT = Environment(0.0, 0.0)
LOAD_GRID_S = 5.0e-4  # breakpoints of a smooth load: its chords are within 1e-4 of it


@dataclass(frozen=True, slots=True)
class Scenario:
    """A kind of run with its parameters; what isn't given is drawn from the seed or as the kind has it."""

    kind: str
    duration_s: float = 12.0
    mid_motion: bool = False  # the rows begin while it moves already
    row_s: float = 1.0e-3  # a whole number of samples of the drive


@dataclass(frozen=True, slots=True)
class Course:
    """What happens, over time; time 0 is the first row, and a load may begin before."""

    reference: Callable[[Vector], Vector]  # motor angle in rad
    load: LoadProfile
    environment: Environment = NO_ENVIRONMENT
    jaw_start_rad: float = 0.0


def _smooth_load(torque: Callable[[Vector], Vector], scenario: Scenario) -> LoadProfile:
    time_s = np.arange(-3.0, scenario.duration_s + 1.0, LOAD_GRID_S)
    return piecewise_linear(time_s.tolist(), torque(time_s).tolist())


def _sines(
    rng: np.random.Generator, lowest_Hz: float, highest_Hz: float, peak: float, count: int
) -> Callable[[Vector], Vector]:
    """Sum of sines of random frequency and phase, amplitudes falling with frequency, of about this peak."""
    frequency = np.exp(rng.uniform(math.log(lowest_Hz), math.log(highest_Hz), count))
    phase = rng.uniform(0.0, 2.0 * math.pi, count)
    amplitude = rng.uniform(0.5, 1.0, count) * (lowest_Hz / frequency) ** 0.5
    amplitude *= peak / (0.7 * amplitude.sum())

    def value(time_s: Vector) -> Vector:
        total: Vector = np.sin(2.0 * math.pi * time_s[:, np.newaxis] * frequency + phase) @ amplitude
        return total

    return value


def _trapezoids(
    rng: np.random.Generator, scenario: Scenario, reach: float, speed: float, dwell_s: float
) -> Callable[[Vector], Vector]:
    """Go from level to level at a constant speed, smoothed over 40 ms, and dwell there."""
    time, level = [-3.0, 0.0], [0.0, 0.0]
    while time[-1] < scenario.duration_s + 1.0:
        to = float(rng.uniform(-reach, reach))
        while abs(to - level[-1]) < 0.4 * reach:
            to = float(rng.uniform(-reach, reach))
        at = time[-1] + abs(to - level[-1]) / (speed * float(rng.uniform(0.6, 1.4)))
        time += [at, at + dwell_s * float(rng.uniform(0.5, 1.5))]
        level += [to, to]

    def value(time_s: Vector) -> Vector:
        spread = np.linspace(-0.02, 0.02, 21)
        return np.asarray(np.mean([np.interp(time_s + shift, time, level) for shift in spread], axis=0))

    return value


def _pulses(rng: np.random.Generator, scenario: Scenario, peak: float) -> LoadProfile:
    """Levels of load that jump at instants between the samples."""
    time, level = [-3.0], [0.0]
    at = float(rng.uniform(0.5, 1.0))
    while at < scenario.duration_s:
        to = float(rng.uniform(-1.0, 1.0)) * peak if rng.random() < 0.7 else 0.0
        time += [at, at]
        level += [level[-1], to]
        at += float(rng.uniform(0.4, 1.2))
    return piecewise_linear(time, level)


def _ramped_load(rng: np.random.Generator, scenario: Scenario, peak: float) -> LoadProfile:
    """Straight ramps between random levels, and holds."""
    time, level = [-3.0, 0.3], [0.0, 0.0]
    while time[-1] < scenario.duration_s + 1.0:
        to = float(rng.uniform(-1.0, 1.0)) * peak
        ramp, hold = rng.uniform(0.3, 1.2, 2)
        time += [time[-1] + float(ramp), time[-1] + float(ramp + hold)]
        level += [to, to]
    return piecewise_linear(time, level)


def _multisine(rng: np.random.Generator, s: Scenario) -> Course:
    return Course(_sines(rng, 0.15, 4.0, 0.5, 7), _ramped_load(rng, s, 2.5e-3))


def _trapezoid(rng: np.random.Generator, s: Scenario) -> Course:
    return Course(_trapezoids(rng, s, 0.5, 1.0, 0.4), _pulses(rng, s, 2.5e-3))


def _chirp(rng: np.random.Generator, s: Scenario) -> Course:
    low, high = 0.2, float(rng.uniform(12.0, 20.0))
    phase, rate = float(rng.uniform(0.0, 6.0)), math.log(high / low) / s.duration_s

    def value(time_s: Vector) -> Vector:
        time = np.maximum(time_s, 0.0)
        swept = 2.0 * math.pi * low * np.expm1(rate * time) / rate + 2.0 * math.pi * low * (time_s - time)
        return np.asarray(0.4 * np.exp(-0.6 * rate * time) * np.sin(swept + phase))

    return Course(value, _smooth_load(_sines(rng, 0.1, 6.0, 1.5e-3, 5), s))


def _slow(rng: np.random.Generator, s: Scenario) -> Course:
    return Course(_trapezoids(rng, s, 0.4, 0.3, 0.6), _ramped_load(rng, s, 3.0e-3))


def _spin(rng: np.random.Generator, s: Scenario) -> Course:
    """Several turns there and back: the jaw's pulley follows as if it had no stop."""
    turns, laps = float(rng.uniform(2.0, 3.5)), 2.0

    def value(time_s: Vector) -> Vector:
        swing = 0.5 - 0.5 * np.cos(2.0 * math.pi * laps * np.maximum(time_s, 0.0) / s.duration_s)
        return np.asarray(2.0 * math.pi * turns * swing)

    return Course(value, _smooth_load(_sines(rng, 0.2, 2.0, 1.5e-3, 4), s))


def _teleoperation(rng: np.random.Generator, s: Scenario) -> Course:
    """Smooth random motion as of a hand: noise through a low-pass, with pauses; load likewise."""
    grid = np.arange(-3.0, s.duration_s + 1.0, 1.0e-3)

    def wander(cutoff_Hz: float, peak: float) -> Vector:
        spectrum = np.fft.rfft(rng.standard_normal(2 * grid.size))
        frequency = np.fft.rfftfreq(2 * grid.size, 1.0e-3)
        noise = np.fft.irfft(spectrum / (1.0 + (frequency / cutoff_Hz) ** 4))[: grid.size]
        return np.asarray(peak * np.tanh(0.6 * noise / noise.std()))

    motion, torque = wander(0.8, 0.6), wander(1.2, 2.5e-3)
    return Course(
        lambda t: np.asarray(np.interp(t, grid, motion)), _smooth_load(lambda t: np.interp(t, grid, torque), s)
    )


def _grasp(rng: np.random.Generator, s: Scenario) -> Course:
    """Close on something springy, hold, let go, again at another depth."""
    time, level = [-3.0, 0.3], [-0.3, -0.3]
    while time[-1] < s.duration_s + 1.0:
        deep, back = float(rng.uniform(0.25, 0.5)), float(rng.uniform(-0.4, -0.1))
        spans = [float(v) for v in rng.uniform([0.3, 0.5, 0.3, 0.2], [0.8, 1.2, 0.8, 0.6])]
        time += (time[-1] + np.cumsum(spans)).tolist()
        level += [deep, deep, back, back]
    spread = np.linspace(-0.05, 0.05, 21)

    def value(time_s: Vector) -> Vector:
        return np.asarray(np.mean([np.interp(time_s + shift, time, level) for shift in spread], axis=0))

    spring = Environment(float(rng.uniform(4.0e-3, 8.0e-3)), float(rng.uniform(0.05, 0.2)))
    return Course(value, piecewise_linear([0.0], [0.0]), spring, -0.3 * 2.0 / 1.4)


def _rest(_: np.random.Generator, __: Scenario) -> Course:
    return Course(np.zeros_like, piecewise_linear([0.0], [0.0]))


def _hold(rng: np.random.Generator, s: Scenario) -> Course:
    """Close, and hold to the end while a load comes and goes; the drive's integral hunts over a count."""
    to, began = float(rng.uniform(0.3, 0.8)) * float(rng.choice((-1.0, 1.0))), float(rng.uniform(0.2, 0.6))
    there = began + float(rng.uniform(0.6, 1.5))
    peak = float(rng.uniform(1.0e-3, 2.5e-3))
    on, off = float(rng.uniform(there, max(there, 0.5 * s.duration_s))), float(rng.uniform(0.6, 0.95)) * s.duration_s
    off = max(off, on + 0.5)
    rise = float(rng.uniform(0.0, 0.3))
    return Course(
        lambda t: np.asarray(np.interp(t, [began, there], [0.0, to])),
        piecewise_linear([-3.0, on, on + rise, off, off + rise], [0.0, 0.0, peak, peak, 0.0]),
    )


def _begun(rng: np.random.Generator, _: Scenario) -> Course:
    """At rest under a load that dry friction may hold, then there and back with pauses."""
    held = float(rng.uniform(-1.0, 1.0)) * 2.0e-4
    wait = float(rng.uniform(0.3, 1.0))
    swing = _sines(rng, 0.2, 1.0, float(rng.uniform(0.3, 0.7)), 3)
    start = float(swing(np.zeros(1))[0])
    on = wait + float(rng.uniform(1.0, 3.0))
    return Course(
        lambda t: np.where(t < wait, start, swing(np.maximum(t - wait, 0.0))),
        piecewise_linear([-3.0, on, on + 0.5], [held, held, float(rng.uniform(-2.0e-3, 2.0e-3))]),
    )


KINDS: dict[str, Callable[[np.random.Generator, Scenario], Course]] = {
    "multisine": _multisine,
    "trapezoid": _trapezoid,
    "chirp": _chirp,
    "slow": _slow,
    "spin": _spin,
    "teleoperation": _teleoperation,
    "grasp": _grasp,
    "rest": _rest,
    "hold": _hold,
    "begun": _begun,
}

SCENARIOS: dict[str, Scenario] = {
    "multisine": Scenario("multisine"),
    "multisine_mid": Scenario("multisine", mid_motion=True),
    "trapezoid": Scenario("trapezoid"),
    "chirp": Scenario("chirp"),
    "slow": Scenario("slow"),
    "spin": Scenario("spin"),
    "teleoperation": Scenario("teleoperation", mid_motion=True),
    "grasp": Scenario("grasp"),
    "rest": Scenario("rest"),
    "hold": Scenario("hold"),
    "short_hold": Scenario("hold", duration_s=4.0),
    "long_hold": Scenario("hold", duration_s=32.0),
    "begun": Scenario("begun"),
}


def course_of(scenario: Scenario, seed: int) -> Course:
    """Draw what happens in a run; the same kind, parameters and seed give the same; KeyError for no kind."""
    return KINDS[scenario.kind](np.random.default_rng([seed, list(KINDS).index(scenario.kind)]), scenario)
