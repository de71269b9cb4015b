"""Dead zones by trying wider and narrower ones: where a zone lets go, a small step tells nothing of a larger one.

Every time the wire comes tight again it rings, and how it does hangs on the width like the phase of a wave. So a fit
stays at whatever width it begins with: from 0.6, 0.77, 0.95 and 1.2 µm it ended within 1 % of each, 300 of χ² apart,
where 1.45 µm was true. And what the encoder's rounding does is taken beside a width and holds that one. So a few widths
are looked at, all else following in a linear step, and the rounding is taken anew at the best, as long as it moves.
"""

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.extension import Refresh
from hil_forceps.diagnosis.fit import Fit, Held, follow, hold
from hil_forceps.diagnosis.problem import Problem
from hil_forceps.diagnosis.ringing import moved_to
from hil_forceps.diagnosis.spectrum import Whitener

Vector = NDArray[np.float64]

WIDTHS = ("effects.wire_slack.half_width_m", "effects.transmission_play.half_width_rad")
FACTORS = (0.8, 1.0, 1.25, 1.6)
BETTER = 10.0  # of χ²: less may be the rounding taken anew
MOST_TURNS = 6


def at_better_widths(problem: Problem, found: Fit, whitener: Whitener, refresh: Refresh) -> tuple[Problem, Vector]:
    """Return the problem with the rounding taken anew where a dead zone has a better width, and u there.

    Both as they are where no width is better.
    """
    u = found.u
    for place, name in enumerate(problem.shared.names):
        if name not in WIDTHS:
            continue
        held = hold(np.delete(found.jacobian, place, axis=1), place, whitener)
        for _ in range(MOST_TURNS):
            beside = _beside(problem, u, place, whitener, held)
            here, (best, chi2) = beside[FACTORS.index(1.0)], min(beside, key=lambda point: point[1])
            if chi2 > here[1] - BETTER:
                break
            u = best
            problem = refresh(problem, u)
    return problem, u


def _beside(problem: Problem, u: Vector, place: int, whitener: Whitener, held: Held) -> list[tuple[Vector, float]]:
    """Return u with a width times each factor, all held unknowns following, and χ² there."""
    width = float(problem.shared.values(u[: len(problem.shared.items)])[place])

    def at(factor: float) -> tuple[Vector, float]:
        return follow(problem, moved_to(problem, u, place, factor * width), whitener, held)

    return [at(factor) for factor in FACTORS]  # one after the other: each shares out its runs
