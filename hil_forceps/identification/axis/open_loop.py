"""The motion of an axis when the measured force alone drives it.

The force is held from sample to sample, as a sampled controller does, and acts late by the dead time less half a
sample, which the hold itself is worth. Dry friction turns round within `STEP_m_per_s`. Runge and Kutta's fourth order,
in steps of a fraction of a sample.
"""

import math

import numpy as np

from hil_forceps.identification.axis.force_terms import Vector, axis_vector
from hil_forceps.identification.axis.inverse_model import Fit
from hil_forceps.kernels.compiler import kernel_compiler

STEP_m_per_s = 5e-4  # 20 N over it and 95 kg give a time constant of 2 ms, well above the step
SUBSTEPS = 2  # of each stretch of constant force

# Compiled from this folder alone: nothing of the forceps' model is in it, and nothing of it in theirs.
_compiled = kernel_compiler(("hil_forceps/identification/axis",))


@_compiled
def _acceleration(position: float, speed: float, force: float, axis: Vector) -> float:
    sign = math.tanh(speed / STEP_m_per_s)
    forward, backward = 0.5 * (1.0 + sign), 0.5 * (1.0 - sign)
    way = (position - axis[16]) / axis[17]
    phase = axis[15] * position
    low = axis[5] * math.exp(-((speed / axis[14]) ** 2))
    dry = forward * (axis[1] * speed + axis[2]) + backward * (axis[3] * speed - axis[4]) + sign * low
    ripple = axis[6] * math.cos(phase) + axis[7] * math.sin(phase)
    twice = axis[8] * math.cos(2.0 * phase) + axis[9] * math.sin(2.0 * phase)
    path = way * (axis[10] + axis[11] * way) + sign * way * (axis[12] + axis[13] * way)
    return float((force - dry - ripple - twice - path) / axis[0])


@_compiled
def _driven(force: Vector, start: Vector, axis: Vector, sample_time: float, delay: float) -> Vector:
    """Return the positions; `delay` in samples, at least 0."""
    positions = np.empty(force.size)
    position, speed = start[0], start[1]
    whole = math.floor(delay)
    late = delay - whole
    for row in range(force.size):
        positions[row] = position
        for stretch in range(2):
            step = sample_time * (late if stretch == 0 else 1.0 - late) / SUBSTEPS
            if step == 0.0:
                continue
            push = force[max(row - int(whole) - 1 + stretch, 0)]
            for _ in range(SUBSTEPS):
                half = 0.5 * step
                first = _acceleration(position, speed, push, axis)
                second = _acceleration(position + half * speed, speed + half * first, push, axis)
                third = _acceleration(position + half * (speed + half * first), speed + half * second, push, axis)
                fourth = _acceleration(position + step * (speed + half * second), speed + step * third, push, axis)
                position += step * speed + step * step / 6.0 * (first + second + third)
                speed += step / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
    return positions


def open_loop(found: Fit, force_N: Vector, start: tuple[float, float], sample_time_s: float) -> Vector:
    """Return the positions [samples, m] of an axis that starts at `start` (m, m/s) and is driven by `force_N`."""
    delay = max(0.0, found.shape.dead_time_s / sample_time_s - 0.5)
    axis = axis_vector(found.coefficients, found.shape)
    return _driven(np.ascontiguousarray(force_N), np.array(start), axis, sample_time_s, delay)
