"""The force that repeats along the path: its spectrum and period, and where its zero is in another run."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.identification.axis.axis import AxisRun
from hil_forceps.identification.axis.force_terms import Motion, Vector, column, terms
from hil_forceps.identification.axis.inverse_model import Fit, moved, relative_error

# Looked at: periods from 0.7 to 10 mm. Longer ones are what varies along the path at all.
CYCLES_PER_M = np.arange(100.0, 1400.0, 0.25)
_MAX_STEADY_ACCELERATION_m_per_s2 = 0.05
_MIN_SPEED_m_per_s = 5e-3
_PHASE_TRIALS = 250  # places of the zero that are tried over one period


class Spectrum(NamedTuple):
    """Amplitude of what is left of the force over the path [waves]."""

    cycles_per_m: Vector
    amplitude_N: Vector
    forward_N: Vector
    backward_N: Vector


def leftover(run: AxisRun, found: Fit) -> tuple[Motion, Vector]:
    """Return motion, and the force that a model leaves, both below the low pass and at every sample."""
    motion = moved(run.position_m, run.sample_time_s)
    smooth = moved(run.force_N, run.sample_time_s).position_m  # the same low pass
    late = np.interp(run.time_s - found.shape.dead_time_s, run.time_s, smooth)
    model = sum(found.coefficients[name] * column(name, motion, found.shape) for name in terms(found.law))
    return motion, late - model


def spectrum(run: AxisRun, found: Fit) -> Spectrum:
    """Return the amplitudes over the path of what a model leaves where the axis moves steadily, per metre alike."""
    motion, left = leftover(run, found)
    speed = motion.speed_m_per_s
    steady = (np.abs(motion.acceleration_m_per_s2) < _MAX_STEADY_ACCELERATION_m_per_s2) & (
        np.abs(speed) > _MIN_SPEED_m_per_s
    )
    parts = (steady, steady & (speed > 0.0), steady & (speed < 0.0))
    return Spectrum(CYCLES_PER_M, *(_amplitude(motion, left, here) for here in parts))


def _amplitude(motion: Motion, left: Vector, here: NDArray[np.bool_]) -> Vector:
    rows = np.flatnonzero(here)
    if not rows.size:
        return np.zeros_like(CYCLES_PER_M)
    weights = np.abs(motion.speed_m_per_s[rows])
    weights = weights / weights.sum()
    values = weights * (left[rows] - np.sum(weights * left[rows]))
    place = motion.position_m[rows]
    return np.array([2.0 * abs(np.sum(values * np.exp(-2j * math.pi * wave * place))) for wave in CYCLES_PER_M])


def period_m(run: AxisRun, found: Fit) -> float:
    """Return the period with the highest amplitude; the top between two waves is a parabola's."""
    amplitude = spectrum(run, found).amplitude_N
    top = int(np.clip(np.argmax(amplitude), 1, len(amplitude) - 2))
    before, there, after = amplitude[top - 1 : top + 2]
    bend = before - 2.0 * there + after
    place = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return float(1.0 / (CYCLES_PER_M[top] + place * (CYCLES_PER_M[1] - CYCLES_PER_M[0])))


def zero_m(run: AxisRun, found: Fit) -> tuple[float, float]:
    """Return by how much another run's zero lies further along the path, within a period, and the error then.

    An encoder that counts from where it was switched on knows no turn's beginning, so a ripple found in one run has
    another phase in the next. One number of the other run.
    """
    period = found.shape.ripple_period_m
    tried = [
        (relative_error(run.rows, shifted(found, way)), way)
        for way in np.arange(_PHASE_TRIALS) * period / _PHASE_TRIALS
    ]
    error, way = min(tried)
    return float(way), error


def shifted(found: Fit, way_m: float) -> Fit:
    """Return a model whose ripple lies `way_m` further along the path."""
    turned = dict(found.coefficients)
    for name in ("ripple", "ripple_twice"):
        angle = 2.0 * math.pi * way_m / found.shape.ripple_period_m * (2.0 if name.endswith("twice") else 1.0)
        cos, sin = found.coefficients[f"{name}_cos_N"], found.coefficients[f"{name}_sin_N"]
        turned[f"{name}_cos_N"] = cos * math.cos(angle) - sin * math.sin(angle)
        turned[f"{name}_sin_N"] = cos * math.sin(angle) + sin * math.cos(angle)
    return found._replace(coefficients=turned)
