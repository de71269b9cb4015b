"""What shows the effects of an axis, and what doesn't: dead time, friction stroke by stroke, mass over frequency."""

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.signal import csd, welch

from hil_forceps.identification.axis.axis import AxisRun
from hil_forceps.identification.axis.force_terms import Law, Shape, Vector, column, terms
from hil_forceps.identification.axis.inverse_model import Fit, moved, relative_error, solve

DEAD_TIMES_s = np.arange(0.0, 1.501e-3, 5e-5)
BANDS_Hz = (3.0, 5.0, 10.0, 20.0, 30.0, 40.0, 60.0, 80.0, 100.0, 130.0, 170.0)
MIN_COHERENCE = 0.95  # below, a band is shown but not used
_SEGMENT_SAMPLES = 2048  # samples
_STROKE_LOW_PASS_Hz = 10.0
_MAX_STEADY_ACCELERATION_m_per_s2 = 0.02
_STROKE_END_s = 0.06  # left out at both ends of a stroke
_MIN_STROKE_s = 0.2
_Z_95 = 1.96  # quantile of the normal distribution, both sides


class Stroke(NamedTuple):
    """The mean of one stroke at constant reference speed, from the same stroke of two runs."""

    time_s: float
    speed_m_per_s: float
    train_N: float  # force less mass times acceleration
    test_N: float


class Band(NamedTuple):
    """Force over acceleration in one band of frequency."""

    from_Hz: float
    to_Hz: float
    mass_kg: float
    delay_s: float
    coherence: float
    relative_sd: float  # of the mass, by the coherence


class Stiffness(NamedTuple):
    """A rise of the apparent mass, 1 + (f/f0)²: beyond the hold's own it may be a spring, an amplifier, or a filter."""

    up_to_Hz: float  # the data tell so far
    rise_per_Hz2: float  # 1/f0², 95 % interval beside it
    low_per_Hz2: float
    high_per_Hz2: float
    delay_s: float  # of the usable bands from 20 Hz on
    delay_low_s: float
    delay_high_s: float


def dead_time_profile(run: AxisRun, law: Law, shape: Shape) -> Vector:
    """Return the force error over `DEAD_TIMES_s`, coefficients fitted anew at each."""
    fits = [solve(run.rows, law, shape._replace(dead_time_s=float(late))) for late in DEAD_TIMES_s]
    return np.array([relative_error(run.rows, found) for found in fits])


def strokes(train: AxisRun, test: AxisRun, found: Fit) -> tuple[Stroke, ...]:
    """Compare the friction of two runs along the same reference; nothing where they followed different ones."""
    if train.reference_m is None or test.reference_m is None or len(train.time_s) != len(test.time_s):
        return ()
    step = train.sample_time_s
    if not np.allclose(train.reference_m, test.reference_m, atol=1e-3 * np.ptp(train.reference_m)):
        return ()
    steady = (
        np.abs(moved(train.reference_m, step, _STROKE_LOW_PASS_Hz).acceleration_m_per_s2)
        < _MAX_STEADY_ACCELERATION_m_per_s2
    )
    edges = np.flatnonzero(np.diff(np.concatenate(([0], steady.astype(int), [0]))))
    told = []
    spare = round(_STROKE_END_s / step)
    levels = [_steady_force(run, found) for run in (train, test)]
    speed = moved(train.position_m, step, _STROKE_LOW_PASS_Hz).speed_m_per_s
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        if (last - first) * step >= _MIN_STROKE_s:
            here = slice(int(first) + spare, int(last) - spare)
            means = [float(level[here].mean()) for level in levels]
            told.append(Stroke(float(train.time_s[here.start]), float(speed[here].mean()), *means))
    return tuple(told)


def _steady_force(run: AxisRun, found: Fit) -> Vector:
    motion = moved(run.position_m, run.sample_time_s, _STROKE_LOW_PASS_Hz)
    force = moved(run.force_N, run.sample_time_s, _STROKE_LOW_PASS_Hz).position_m
    return force - found.coefficients["mass_kg"] * motion.acceleration_m_per_s2


def response(run: AxisRun, found: Fit) -> tuple[Band, ...]:
    """Return apparent mass and delay over frequency: force less the model's friction against acceleration.

    The acceleration is the second difference of the position as recorded, with the difference's own loss undone.
    """
    step = run.sample_time_s
    motion = moved(run.position_m, step)
    friction = sum(
        found.coefficients[name] * column(name, motion, found.shape) for name in terms(found.law) if name != "mass_kg"
    )
    force = run.force_N - friction
    acceleration = np.concatenate(([0.0], np.diff(run.position_m, 2), [0.0])) / step**2
    size = min(_SEGMENT_SAMPLES, len(force) // 4)
    settings = {"fs": 1.0 / step, "nperseg": size, "noverlap": 3 * size // 4}
    frequency, of_force = welch(force, **settings)
    of_acceleration = welch(acceleration, **settings)[1]
    cross = csd(force, acceleration, **settings)[1]
    loss = np.sinc(frequency * step) ** 2
    told = []
    for low, high in itertools.pairwise(BANDS_Hz):
        here = (frequency >= low) & (frequency < high)
        if not np.any(here):
            continue
        ratio = complex(np.sum(cross[here] / loss[here]) / np.sum(of_force[here]))
        power = float(np.sum(of_force[here]) * np.sum(of_acceleration[here]))
        coherence = float(abs(np.sum(cross[here])) ** 2 / power)
        middle = float(np.sum(frequency[here] * of_force[here]) / np.sum(of_force[here]))
        independent = 2.0 * np.sum(here) * len(force) / size / 1.5  # neighbours under a Hann window share
        sd = math.sqrt(max(0.0, 1.0 - coherence) / max(coherence, 1e-12) / independent)
        delay = -float(np.angle(ratio)) / (2.0 * math.pi * middle)
        told.append(Band(low, high, 1.0 / abs(ratio), delay, coherence, sd))
    return tuple(told)


def stiffness(bands: Sequence[Band], sample_time_s: float) -> Stiffness | None:
    """Fit 1 + (f/f0)² to the apparent mass where the data tell; None with fewer than four such bands.

    The hold's own loss, sinc(f h), is taken out first. The scatter of the bands about the curve widens the interval.
    """
    used = []
    for band in bands:  # the first that doesn't tell ends it: what comes back above is no better
        if band.coherence < MIN_COHERENCE:
            break
        used.append(band)
    if len(used) < 4:
        return None
    middle = np.array([math.sqrt(band.from_Hz * band.to_Hz) for band in used])
    mass = np.array([band.mass_kg for band in used]) * np.sinc(middle * sample_time_s)
    sd = np.array([band.relative_sd for band in used]) * mass
    weighted = np.column_stack([np.ones_like(middle), middle**2]) / sd[:, None]
    (level, rise), left, _, _ = np.linalg.lstsq(weighted, mass / sd, rcond=None)
    spread = max(1.0, float(np.sum(left)) / (len(used) - 2))
    error = math.sqrt(spread * np.linalg.inv(weighted.T @ weighted)[1, 1]) / level
    fast = [band for band in used if band.from_Hz >= 20.0] or used[-1:]
    delays = np.array([band.delay_s for band in fast])
    weights = np.array([(band.from_Hz * 2.0 * math.pi / band.relative_sd) ** 2 for band in fast])
    delay = float(np.sum(weights * delays) / np.sum(weights))
    scatter = float(np.sqrt(np.sum(weights * (delays - delay) ** 2) / np.sum(weights) / max(1, len(fast) - 1)))
    rise = float(rise / level)
    return Stiffness(
        used[-1].to_Hz, rise, rise - _Z_95 * error, rise + _Z_95 * error, delay, delay - _Z_95 * scatter,
        delay + _Z_95 * scatter,
    )  # fmt: skip


def roll_off(run: AxisRun, low_Hz: float = 100.0, high_Hz: float = 400.0) -> float:
    """Return by how many decades the power of the acceleration falls from one frequency to another.

    A recorded position falls little, for its rounding is white; one that was filtered before it was stored falls more.
    """
    acceleration = np.diff(run.position_m, 2) / run.sample_time_s**2
    frequency, power = welch(acceleration, fs=1.0 / run.sample_time_s, nperseg=min(_SEGMENT_SAMPLES, len(acceleration)))
    at = [float(np.median(power[(frequency > 0.9 * f) & (frequency < 1.1 * f)])) for f in (low_Hz, high_Hz)]
    return math.log10(at[0] / at[1]) if min(at) > 0.0 else math.inf
