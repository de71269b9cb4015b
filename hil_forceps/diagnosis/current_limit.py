"""Where a limit of the current may be: its valley is half a percent wide, and no step leads into it from above."""

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.fit import chi2_of
from hil_forceps.diagnosis.predict import LIMIT, ClosedLoop
from hil_forceps.diagnosis.problem import Problem
from hil_forceps.diagnosis.spectrum import Whitener, transform

Vector = NDArray[np.float64]

NARROW = np.arange(0.999, 0.96, -0.001)  # of the largest current: a valley is half a percent wide
WIDE = np.arange(0.96, 0.4, -0.02)
TELLING = 9.0  # of χ²


def deepest_limits(problem: Problem, u: Vector, whitener: Whitener) -> tuple[float, ...]:
    """Return the limit in A with the least χ², all else as in u.

    Nothing where no limit lessens it, or no loop is closed.
    """
    loop = problem.simulate_runs
    if not isinstance(loop, ClosedLoop):
        return ()
    # Peaks of a simulation can lie below a limit that clips those of the drive; recorded ones lie on it, with noise.
    current_max_A = max(float(np.abs(record.channels["current_A"]).max()) for record in problem.records)
    plain = loop.as_shaken()
    nuisances = problem.nuisances(u)

    def chi2(limit_A: float) -> float:
        theta = problem.theta(u)
        theta[LIMIT] = limit_A
        return chi2_of(problem, problem.measured - transform(problem.layout, plain(theta, nuisances)), whitener, u)

    limits = current_max_A * np.concatenate(([2.0], NARROW, WIDE))
    found = list(problem.mapper(chi2, limits))
    best = int(np.argmin(found))
    return (float(limits[best]),) if found[best] < found[0] - TELLING else ()
