"""Estimates by a session's likelihood alone.

A fit has the rig's values as its prior. Over many sessions that prior would count once for each session, and pull
every estimate towards the rig. So it is taken out again. With posterior information H about the mean m and the prior's
precision Λ about 0, the likelihood alone has the information H - Λ and the mean (H - Λ)⁻¹ H m.
"""

from typing import NamedTuple

import numpy as np

from hil_forceps.diagnosis.inference.fit import Fit, inverted, prior_of
from hil_forceps.diagnosis.inference.parameters import Free


class Measured(NamedTuple):
    """A parameter as one session measures it."""

    name: str  # dotted, as a rig file has it
    unit: str
    assumed: float  # what the rig says, or where the fit began
    value: float  # NaN where the session doesn't measure it
    sd: float  # NaN likewise
    reason: str = ""  # why it isn't measured


def by_likelihood(found: Fit) -> tuple[Measured, ...]:
    """Return what a fit measures, without what its priors say."""
    information = inverted(found.covariance)
    away, precision = prior_of(found.free, found.passes.theta)
    covariance = inverted(information - np.diag(precision))
    mean = covariance @ (information @ away)
    deviation = np.sqrt(np.diag(covariance))
    return tuple(
        _measured(free, float(shift), float(sd), float(value))
        for free, shift, sd, value in zip(found.free, mean, deviation, found.values, strict=True)
    )


def _measured(free: Free, shift: float, sd: float, fitted: float) -> Measured:
    if not (np.isfinite(shift) and np.isfinite(sd)) or sd >= 1.0:
        # In units of the prior's deviation, or of the size of a step where there is no prior.
        reason = "this session says less of it than the rig"
        return Measured(free.name, free.unit, free.centre, np.nan, np.nan, reason)
    value, deviation = free.centre + free.scale * shift, free.scale * sd
    if not free.low < fitted < free.high:
        reason = f"the fit ended at its bound {fitted:.4g}"
        return Measured(free.name, free.unit, free.centre, np.nan, np.nan, reason)
    return Measured(free.name, free.unit, free.centre, value, deviation)
