"""Where a limit of the current may be: by the simulation itself, shaken by the rounding as it was in each run.

A limit clips the tips of a few peaks, and what it then does hangs on how the motor is shaken there. The roundings that
stand in for a run's own clip other tips, and what the own one does beyond them is taken at one limit and keeps a fit
there: fits ended 1600 of χ² above the valley, half a percent beside the limit. Nor does any step lead into the valley
from where nothing is clipped.
"""

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.fit import chi2_of
from hil_forceps.diagnosis.predict import ClosedLoop
from hil_forceps.diagnosis.problem import Problem
from hil_forceps.diagnosis.spectrum import Whitener, transform
from hil_forceps.model import parameters

Vector = NDArray[np.float64]

LIMIT = parameters.index("effects.current_saturation.limit_A")
NARROW = np.arange(0.999, 0.96, -0.001)  # of the largest current: a valley is half a percent wide
WIDE = np.arange(0.96, 0.4, -0.02)
TELLING = 9.0  # of χ²


def deepest_limits(problem: Problem, u: Vector, whitener: Whitener, current_max_A: float) -> tuple[float, ...]:
    """Return the limit in A with the least χ², all else as in u.

    Nothing where no limit lessens it, or no loop is closed.
    """
    loop = problem.simulate_runs
    if not isinstance(loop, ClosedLoop):
        return ()
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
