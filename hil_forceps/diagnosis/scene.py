"""What the runs contain, as far as it says where effects may be looked for."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.course import Course
from hil_forceps.diagnosis.current_limit import deepest_limits
from hil_forceps.diagnosis.entries import Scene, quantiles_of_speed
from hil_forceps.diagnosis.extension import Model
from hil_forceps.diagnosis.linear import Response, columns
from hil_forceps.diagnosis.score import Group, gains_alone
from hil_forceps.diagnosis.spectrum import Whitener

Vector = NDArray[np.float64]

HARMONICS = tuple(float(h) for h in range(1, 61))
KEPT_HARMONICS = 3
MOST_HARMONICS = 1000


def scene_of(
    courses: Sequence[Course],
    model: Model,
    whitener: Whitener,
    responses: Sequence[Response] | None,
    looked_at: Sequence[float] = HARMONICS,
) -> Scene:
    """Return the scene of runs; the harmonics that promise most of those `looked_at` are found with the linear loop."""
    angle = np.concatenate([c.theta_m for c in courses])
    current = max(float(np.abs(c.current_A).max()) for c in courses)
    stretch = max(float(np.ptp(c.stretch_m)) for c in courses)
    if responses is None:
        cogging: tuple[float, ...] = (1.0, 2.0, 4.0, 6.0, 7.0, 12.0, 24.0)
        ripple = cogging
    else:
        ones = [np.ones_like(c.theta_m) for c in courses]
        scales = (ones, [c.current_A for c in courses])
        cogging, ripple = model.problem.mapper(
            lambda scale: _harmonics(courses, scale, model, whitener, responses, looked_at), scales
        )
    return Scene(
        max(float(c.time_s[-1]) for c in courses),
        max(float(np.ptp(angle)), 1e-3),
        _reach(np.concatenate([c.theta_j for c in courses])),
        quantiles_of_speed(np.concatenate([c.omega_m for c in courses])),
        max(stretch, 1e-8),
        max(current, 1e-6),
        cogging,
        ripple,
        deepest_limits(model.problem, model.fit.u, whitener),
    )


def _reach(angle: Vector) -> tuple[float, ...]:
    ends = float(angle.min()), float(angle.max())
    least = 1e-3 * (ends[1] - ends[0])
    return tuple(end for end, sign in zip(ends, (-1.0, 1.0), strict=True) if sign * end > least)


def fine_harmonics(courses: Sequence[Course]) -> tuple[float, ...]:
    """Return harmonics as close as the motor's turns tell them apart: behind a gear or a screw they are not whole."""
    turns = max(float(np.ptp(c.theta_m)) for c in courses) / (2.0 * np.pi)
    step = max(min(1.0, 0.5 / max(turns, 1e-9)), HARMONICS[-1] / MOST_HARMONICS)
    return tuple(float(h) for h in np.arange(1.0, HARMONICS[-1] + 0.5 * step, step))


def _harmonics(
    courses: Sequence[Course],
    scales: Sequence[Vector],
    model: Model,
    whitener: Whitener,
    responses: Sequence[Response],
    looked_at: Sequence[float],
) -> tuple[float, ...]:
    """Return the harmonics of the motor's angle whose torque, in proportion to `scales`, explains most."""
    layout = model.problem.layout
    groups = [Group(2 * k, 2 * k + 2, False) for k in range(len(looked_at))]

    order = np.repeat(looked_at, 2)[:, None]
    late = np.tile((0.0, 0.5 * np.pi), len(looked_at))[:, None]
    waves = [s * np.sin(order * c.theta_m + late) for c, s in zip(courses, scales, strict=True)]
    white = whitener.apply(columns(layout, responses, "motor", waves))
    norms = np.sqrt(np.maximum(np.einsum("ij,ij->j", white, white, dtype=np.float64), 1e-30))
    white /= norms.astype(np.float32)
    gains = gains_alone(
        whitener.apply(model.fit.jacobian),
        model.problem.prior_weights(),
        model.fit.u,
        white,
        groups,
        whitener.apply(model.fit.residual),
    )
    best = np.argsort(-gains)[:KEPT_HARMONICS]
    return tuple(sorted(looked_at[i] for i in best))
