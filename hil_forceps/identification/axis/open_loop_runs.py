"""An axis driven by its measured force alone: how far its position runs away, and what that hangs on.

Nothing holds an axis in place, so a force that is wrong by 1 N moves it away at 1 N over the viscous friction, some
5 mm/s. Each model is tried with the coefficients of its inverse model and with ones fitted to the position itself.
"""

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from hil_forceps.identification.axis.axis import AxisRun
from hil_forceps.identification.axis.force_terms import FRICTION, SYMMETRIC, Vector
from hil_forceps.identification.axis.inverse_model import Fit
from hil_forceps.identification.axis.open_loop import open_loop

INVERSE, POSITION = "inverse model", "position"
_FITTED = ("mass_kg", *SYMMETRIC, *FRICTION, "low_speed_N")  # what else there is hardly moves the axis away
_DRAWN = "viscous", "coulomb"
_SAMPLE_STRIDE = 10  # of the samples are fitted to
_MAX_ITERATIONS = 60


class OpenLoop(NamedTuple):
    """Errors of the position of one model, RMS over all samples."""

    model: str
    fitted_to: str  # INVERSE or POSITION, of the training run
    fit: Fit
    train_rmse_m: float
    second_half_rmse_m: float  # of the training run, with what was fitted to its first half
    test_rmse_m: tuple[float, ...]  # one per test run


class Needed(NamedTuple):
    """Two numbers of a test run that would have had to be known, and the error with them."""

    friction_scale: float  # of all viscous and Coulomb friction
    force_N: float  # added to the friction
    rmse_m: float
    rmse_scale_only_m: float  # with the scale alone
    mm_per_N: float  # RMS change of the position per N of constant force


def position_error(run: AxisRun, found: Fit, rows: slice = slice(None)) -> Vector:
    """Return simulated minus measured position [samples of `rows`]; a part starts with its own measured motion."""
    force, position = run.force_N[rows], run.position_m[rows]
    start = run.start
    if rows.start:
        motion = run.rows.motion
        lost = len(run.position_m) - len(motion.position_m)
        start = float(position[0]), float(motion.speed_m_per_s[rows.start - lost])
    return open_loop(found, force, start, run.sample_time_s) - position


def rms(values: Vector) -> float:
    """Return the root of the mean square; infinite where a simulation left all bounds."""
    return float(np.sqrt(np.mean(values**2))) if np.all(np.isfinite(values)) else float("inf")


def fit_position(run: AxisRun, found: Fit, rows: slice = slice(None)) -> Fit:
    """Fit mass and friction to the position; dead time, low speed, ripple and path stay the inverse model's."""
    names = [name for name in found.coefficients if name in _FITTED]
    first = np.array([found.coefficients[name] for name in names])

    def moved(values: Vector) -> Fit:
        return found._replace(coefficients=found.coefficients | dict(zip(names, map(float, values), strict=True)))

    def error_mm(values: Vector) -> Vector:
        left = 1e3 * position_error(run, moved(values), rows)[::_SAMPLE_STRIDE]
        return np.clip(np.nan_to_num(left, nan=1e6), -1e6, 1e6)

    best = least_squares(error_mm, first, x_scale=np.maximum(np.abs(first), 0.5), max_nfev=_MAX_ITERATIONS)
    return moved(best.x)


def compare_open_loop(model: str, found: Fit, half: Fit, train: AxisRun, tests: list[AxisRun]) -> tuple[OpenLoop, ...]:
    """Return both ways of fitting one model; `half` is its inverse model from the first half of the training run."""
    middle = len(train.time_s) // 2
    first, second = slice(0, middle), slice(middle, None)
    told = []
    for way in (INVERSE, POSITION):
        whole = found if way == INVERSE else fit_position(train, found)
        part = half if way == INVERSE else fit_position(train, half, first)
        errors = tuple(rms(position_error(run, whole)) for run in tests)
        halves = rms(position_error(train, part, second))
        told.append(OpenLoop(model, way, whole, rms(position_error(train, whole)), halves, errors))
    return tuple(told)


def needed(run: AxisRun, found: Fit) -> Needed:
    """Fit two numbers to a test run, to see what the model lacks there. They are no part of the model."""

    def changed(scale: float, force_N: float) -> Fit:
        new = {name: value * (scale if name.startswith(_DRAWN) else 1.0) for name, value in found.coefficients.items()}
        if "offset_N" in new:
            new["offset_N"] += force_N
        else:
            new["coulomb_forward_N"] += force_N
            new["coulomb_backward_N"] -= force_N
        return found._replace(coefficients=new)

    def error_mm(values: Vector) -> Vector:
        force = float(values[1]) if len(values) > 1 else 0.0
        return 1e3 * position_error(run, changed(1.0 + 0.01 * float(values[0]), force))[::_SAMPLE_STRIDE]

    one = least_squares(error_mm, np.zeros(1), diff_step=1e-2, x_scale=1.0).x
    both = least_squares(error_mm, np.array([one[0], 0.0]), diff_step=1e-2, x_scale=[1.0, 0.1]).x
    scale, force = 1.0 + 0.01 * float(both[0]), float(both[1])
    alone = rms(position_error(run, changed(1.0 + 0.01 * float(one[0]), 0.0)))
    step_N = 0.01
    slope = position_error(run, changed(1.0, step_N)) - position_error(run, found)
    return Needed(scale, force, rms(position_error(run, changed(scale, force))), alone, 1e3 * rms(slope) / step_N)
