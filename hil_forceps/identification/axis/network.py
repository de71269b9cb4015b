"""A network that takes position, speed and force for an acceleration: what physics of an axis is held against.

One hidden layer of rectifiers, no physics but that a speed is a position's rate. Fitted by short stretches of
simulation, as M. Forgione and D. Piga did for EMPS (*Continuous-time system identification with neural networks: model
structures and fitting criteria*, European Journal of Control 59, 2021, section 5): position and speed at every row are
unknowns of the fit, too, from which a stretch begins and with which it has to agree. Adam with the rates as published.
"""

import numpy as np
from numpy.typing import NDArray

from hil_forceps.identification.axis.force_terms import Vector
from hil_forceps.kernels.compiler import kernel_compiler

Matrix = NDArray[np.float64]
Places = NDArray[np.int64]

HIDDEN = 64
STRETCH_ROWS, STRETCHES = 64, 32  # of one step of the fit
RATE, DECAY, SQUARE_DECAY, LEAST = 1e-4, 0.9, 0.999, 1e-8  # Adam: as published, the rest as usual
FIRST_SD = 1e-3  # of the weights; offsets begin at 0
_INPUTS = 5  # rows of weights: of position, speed, force, the offset before the rectifier, and the weight behind it

_compiled = kernel_compiler(("hil_forceps/identification/axis",))


def first_weights(rng: np.random.Generator) -> Vector:
    """Return weights to begin a fit with [5 · HIDDEN + 1]; the last one is the offset of the output."""
    weights = FIRST_SD * rng.standard_normal((_INPUTS, HIDDEN))
    weights[3] = 0.0
    return np.append(weights.ravel(), 0.0)


@_compiled
def _answer(position: float, speed: float, force: float, weights: Matrix, offset: float) -> float:
    total = offset
    for j in range(HIDDEN):
        inside = weights[0, j] * position + weights[1, j] * speed + weights[2, j] * force + weights[3, j]
        total += weights[4, j] * max(inside, 0.0)
    return total


@_compiled
def _back(
    position: float, speed: float, force: float, by_answer: float, weights: Matrix, slopes: Matrix
) -> tuple[float, float]:
    """Return what a slope by the answer is by position and by speed; add what it is by the weights."""
    by_position = by_speed = 0.0
    for j in range(HIDDEN):
        inside = weights[0, j] * position + weights[1, j] * speed + weights[2, j] * force + weights[3, j]
        on = 1.0 if inside > 0.0 else 0.0
        through = by_answer * weights[4, j] * on
        slopes[0, j] += through * position
        slopes[1, j] += through * speed
        slopes[2, j] += through * force
        slopes[3, j] += through
        slopes[4, j] += by_answer * inside * on
        by_position += through * weights[0, j]
        by_speed += through * weights[1, j]
    return by_position, by_speed


@_compiled
def _stages(position: float, speed: float, force: float, step: float, weights: Matrix, offset: float) -> Matrix:
    """Return position, speed and acceleration at the four stages of Runge and Kutta's step (4, 3)."""
    at = np.empty((4, 3))
    p, v = position, speed
    for stage in range(4):
        if stage > 0:
            ahead = step if stage == 3 else 0.5 * step
            p, v = position + ahead * at[stage - 1, 1], speed + ahead * at[stage - 1, 2]
        at[stage, 0], at[stage, 1] = p, v
        at[stage, 2] = _answer(p, v, force, weights, offset) / step
    return at


@_compiled
def _change(at: Matrix, rate: int, step: float) -> float:
    """Return by how much a step changes what has its rates in column `rate` of the stages."""
    return float(step / 6.0 * (at[0, rate] + 2.0 * at[1, rate] + 2.0 * at[2, rate] + at[3, rate]))


@_compiled
def play(unknowns: Vector, force: Vector, start: Vector, step_s: float) -> Vector:
    """Return the positions of an axis that starts at `start` (position, speed), each force held for a step [rows]."""
    weights, offset = unknowns[:-1].reshape(_INPUTS, HIDDEN), unknowns[-1]
    positions = np.empty(force.size)
    p, v = start[0], start[1]
    for row in range(force.size):
        positions[row] = p
        at = _stages(p, v, force[row], step_s, weights, offset)
        p, v = p + _change(at, 1, step_s), v + _change(at, 2, step_s)
    return positions


@_compiled
def _stretch(
    row: int, force: Vector, measured: Vector, states: Matrix, step: float, sizes: Vector, unknowns: Vector,
    slope: Vector, states_slope: Matrix,
) -> tuple[float, float]:  # fmt: skip
    """Return squared misfit and disagreement of one stretch, and add their slopes; both a share of a whole step's."""
    weights, offset = unknowns[:-1].reshape(_INPUTS, HIDDEN), unknowns[-1]
    slopes = slope[:-1].reshape(_INPUTS, HIDDEN)
    course = np.empty((STRETCH_ROWS, 4, 3))
    p, v = states[row, 0], states[row, 1]
    for k in range(STRETCH_ROWS):
        at = _stages(p, v, force[row + k], step, weights, offset)
        course[k] = at
        p, v = p + _change(at, 1, step), v + _change(at, 2, step)
    share = 1.0 / (STRETCHES * STRETCH_ROWS)
    misfit = disagreement = by_p = by_v = 0.0
    for k in range(STRETCH_ROWS - 1, -1, -1):
        if k < STRETCH_ROWS - 1:  # through the step that follows this row
            by_p, by_v = _back_step(course[k], force[row + k], step, by_p, by_v, weights, slopes, slope)
        off = (course[k, 0, 0] - measured[row + k]) / sizes[0]
        misfit += share * off * off
        by_p += 2.0 * share * off / sizes[0]
        for channel in range(2):
            apart = (course[k, 0, channel] - states[row + k, channel]) / sizes[channel]
            disagreement += 0.5 * share * apart * apart
            by_state = share * apart / sizes[channel]
            states_slope[row + k, channel] -= by_state
            if channel == 0:
                by_p += by_state
            else:
                by_v += by_state
    states_slope[row, 0] += by_p
    states_slope[row, 1] += by_v
    return misfit, disagreement


@_compiled
def _back_step(
    at: Matrix, force: float, step: float, by_p: float, by_v: float, weights: Matrix, slopes: Matrix, slope: Vector
) -> tuple[float, float]:
    """Return slopes by position and speed before a step from those behind it."""
    total_p, total_v = by_p, by_v
    later_p = later_v = 0.0  # by the stage that follows
    for stage in range(3, -1, -1):
        part = step / 6.0 * (1.0 if stage in (0, 3) else 2.0)
        ahead = step if stage == 2 else 0.5 * step  # from this stage to the next
        rate_p = part * by_p + (ahead * later_p if stage < 3 else 0.0)
        rate_v = part * by_v + (ahead * later_v if stage < 3 else 0.0)
        slope[-1] += rate_v / step
        own_p, own_v = _back(at[stage, 0], at[stage, 1], force, rate_v / step, weights, slopes)
        later_p, later_v = own_p, rate_p + own_v
        total_p += later_p
        total_v += later_v
    return total_p, total_v


@_compiled
def loss(
    rows: Places, force: Vector, measured: Vector, states: Matrix, step: float, sizes: Vector, unknowns: Vector
) -> tuple[float, Vector, Matrix]:
    """Return misfit plus disagreement of the stretches that begin at `rows`, and its slopes."""
    slope, states_slope = np.zeros_like(unknowns), np.zeros_like(states)
    total = 0.0
    for row in rows:
        misfit, disagreement = _stretch(row, force, measured, states, step, sizes, unknowns, slope, states_slope)
        total += misfit + disagreement
    return total, slope, states_slope


@_compiled
def _adam(values: Vector, slope: Vector, mean: Vector, square: Vector, number: int) -> None:
    first, second = 1.0 - DECAY**number, 1.0 - SQUARE_DECAY**number
    for i in range(values.size):
        mean[i] = DECAY * mean[i] + (1.0 - DECAY) * slope[i]
        square[i] = SQUARE_DECAY * square[i] + (1.0 - SQUARE_DECAY) * slope[i] * slope[i]
        values[i] -= RATE * (mean[i] / first) / (np.sqrt(square[i] / second) + LEAST)


@_compiled
def descend(
    starts: Places, done: int, force: Vector, measured: Vector, states: Matrix, step: float, sizes: Vector,
    unknowns: Vector, means: Vector, squares: Vector, states_means: Matrix, states_squares: Matrix,
) -> None:  # fmt: skip
    """Take one step of Adam for each row of `starts` [steps, STRETCHES], in place; `done` steps went before."""
    for k in range(starts.shape[0]):
        _, slope, states_slope = loss(starts[k], force, measured, states, step, sizes, unknowns)
        _adam(unknowns, slope, means, squares, done + k + 1)
        _adam(states.ravel(), states_slope.ravel(), states_means.ravel(), states_squares.ravel(), done + k + 1)
