"""Dry friction as the rig has it, where the data don't contradict that.

Data sheets are often wrong about friction by a factor, so it is fitted with a prior as wide as the torques seen. Where
the data hardly show it, as that of a jaw behind a wire, the fit then ends anywhere within that, and what the jaw is
given is missing at the motor. So each value that the data don't contradict is taken at the rig's word.
"""

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.fit import Fit, chi2_of
from hil_forceps.diagnosis.problem import Problem
from hil_forceps.diagnosis.spectrum import Whitener
from hil_forceps.diagnosis.unknowns import Unknowns

Vector = NDArray[np.float64]

CONTRADICTED = 9.0  # of χ²: three standard deviations
# Where something is left and nothing named. The encoder's rounding, taken beside a friction, suits that friction: half
# of what was said was true, five of the rig's deviations, and it cost 2.3 (and 30 in the curves that found it).
DOUBTED = 1.0


def trusting(shared: Unknowns, found: Fit, contradicted: float = CONTRADICTED) -> Unknowns:
    """Return the unknowns with as many values at the rig's word as a fit allows that took none of them so.

    Of equally many those that cost least; none that cost as much as `contradicted`, of χ².
    """
    said = [item.prior and item.assumed is not None and item.told > item.precision for item in shared.items]
    open_ = np.flatnonzero(said).tolist()
    for count in range(len(open_), 0, -1):
        cost, best = min((_cost(shared, found, which), which) for which in combinations(open_, count))
        if cost < contradicted:
            items = [item._replace(precision=item.told) if i in best else item for i, item in enumerate(shared.items)]
            return Unknowns(tuple(items))
    return shared


def trusted(shared: Unknowns) -> list[int]:
    """Return the places of the unknowns that are taken at the rig's word."""
    return [i for i, item in enumerate(shared.items) if item.told > 1.0 and item.precision == item.told]


def _cost(shared: Unknowns, found: Fit, which: tuple[int, ...]) -> float:
    """Return by how much χ² rises when some unknowns get their tighter priors and all others follow; linearised."""
    at = list(which)
    added = np.array([shared.items[i].told - shared.items[i].precision for i in at])
    spread = found.covariance[np.ix_(at, at)] + np.diag(1.0 / added)
    return float(found.u[at] @ np.linalg.solve(spread, found.u[at]))


def at_their_word(problem: Problem, u: Vector, whitener: Whitener) -> Vector:
    """Return u with what is taken at the rig's word there, where that is the better start; else u.

    A friction that hardly shows may end at ten times what is said. On a linear step's way back all others would go
    astray.
    """
    moved = u.copy()
    moved[trusted(problem.shared)] = 0.0
    before, after = (chi2_of(problem, problem.measured - problem.predicted(at), whitener, at) for at in (u, moved))
    return moved if after < before else u
