"""What an estimator's unit does at a sample: the kernels of `estimation`, put together for one rig and algorithm.

They are plain Python here, to be translated: what is bound to the rig are constants of the C program.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba.np.unsafe import ndarray as fixed
from numpy.typing import NDArray

from hil_forceps.estimation.corrections import Memory, Tuning, after, before, begin
from hil_forceps.estimation.interface import ELONGATION, TAU_W
from hil_forceps.model.composition import Physics

Vector = NDArray[np.float64]
_tuple: Any = fixed.to_fixed_tuple
_PHYSICS, _CORRECTED = len(Physics._fields), len(Memory._fields)

ANGLE, CURRENT, JAW_REFERENCE, LOAD, STRETCH, MOTOR_REFERENCE = range(6)
TORQUE_CONSTANT, MOTOR_RADIUS, JAW_RADIUS = range(6, 9)
# In the memory: whether a sample was seen, then the corrections' memory, then the estimator's state.
_SEEN = 0
_KNOWN = 1
_STATE = _KNOWN + _CORRECTED

PROBLEMS = ("the estimate is no finite number; check the inputs",)


class Kernels(NamedTuple):
    """An estimator's own kernels with its constants."""

    start: Callable[..., Any]
    step: Callable[..., Any]
    constants: Vector
    state_size: int


def memory_size(kernels: Kernels) -> int:
    """Return how many numbers the unit remembers."""
    return _STATE + kernels.state_size


def nothing(values: Vector, memory: Vector, time_ns: int) -> int:  # noqa: ARG001 - what every kernel of a unit takes
    """Have nothing to prepare: all is constant."""
    return 0


def fresh(values: Vector, memory: Vector, time_ns: int) -> int:  # noqa: ARG001 - as above
    """Forget every sample."""
    memory[_SEEN] = 0.0
    values[LOAD], values[STRETCH] = 0.0, 0.0
    values[MOTOR_REFERENCE] = values[JAW_RADIUS] * values[JAW_REFERENCE] / values[MOTOR_RADIUS]
    return 0


def told(values: Vector, tau_w_N_m: float, elongation_m: float) -> int:
    """Write an estimate, and the motor's reference that makes up for the stretch: (10)."""
    values[LOAD], values[STRETCH] = tau_w_N_m, elongation_m
    reference = (values[JAW_RADIUS] * values[JAW_REFERENCE] + elongation_m) / values[MOTOR_RADIUS]
    values[MOTOR_REFERENCE] = reference
    finite = tau_w_N_m - tau_w_N_m == 0.0 and elongation_m - elongation_m == 0.0
    return 0 if finite else 1


def plain(kernels: Kernels) -> Callable[[Vector, Vector, int], int]:
    """Return the sample of an estimator on the paper's plant."""
    start, step, c, _ = kernels

    def advance(values: Vector, memory: Vector, time_ns: int) -> int:
        """Take a sample."""
        torque = values[TORQUE_CONSTANT] * values[CURRENT]
        if memory[_SEEN] == 0.0:
            memory[_STATE:] = start(c, time_ns, values[ANGLE], torque)
        else:
            memory[_STATE:] = step(memory[_STATE:].copy(), c, time_ns, values[ANGLE], torque)
        memory[_SEEN] = 1.0
        return told(values, memory[_STATE + TAU_W], memory[_STATE + ELONGATION])

    return advance


def corrected(kernels: Kernels, theta: Vector, tuning: Tuning) -> Callable[[Vector, Vector, int], int]:
    """Return the sample of an estimator with the rig's effects taken into account, as `corrections.corrected` does."""
    start, step, c, _ = kernels

    def advance(values: Vector, memory: Vector, time_ns: int) -> int:
        """Take a sample."""
        p, torque = Physics(*_tuple(theta, _PHYSICS)), values[TORQUE_CONSTANT] * values[CURRENT]
        if memory[_SEEN] == 0.0:
            first = begin(p, time_ns, values[ANGLE], torque)
            m, angle, seen = before(p, first, tuning, time_ns, values[ANGLE], torque)
            memory[_STATE:] = start(c, time_ns, angle, seen)
            m = after(p, m, tuning, 0.0, memory[_STATE + TAU_W], memory[_STATE + ELONGATION])
        else:
            m = Memory(*_tuple(memory[_KNOWN:_STATE], _CORRECTED))
            dt_s = (time_ns - m.last_ns) * 1e-9
            if dt_s > 0.0:
                m, angle, seen = before(p, m, tuning, time_ns, values[ANGLE], torque)
                memory[_STATE:] = step(memory[_STATE:].copy(), c, time_ns, angle, seen)
                m = after(p, m, tuning, dt_s, memory[_STATE + TAU_W], memory[_STATE + ELONGATION])
        memory[_SEEN] = 1.0
        memory[_KNOWN:_STATE] = np.array(m)
        return told(values, m.tau_w_N_m, m.elongation_m)

    return advance
