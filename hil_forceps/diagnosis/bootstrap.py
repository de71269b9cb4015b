"""Parametric bootstrap: runs are simulated with the fitted model, and fitted and tested as the measured ones.

The simulated runs have no lack of fit, and their parameters are known. What fits and tests find there comes from the
filter's approximations: counts whose density is not normal, speeds near standstill, what the drive counted between
rows. So it is the bias of the estimates, and the null distribution of the tests (Efron and Tibshirani, An Introduction
to the Bootstrap, 1993, chapters 6 and 10).
"""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.data.even_rows import EvenRun
from hil_forceps.diagnosis.evidence import Passes, gram, pass_all
from hil_forceps.diagnosis.hypotheses.candidate import Search
from hil_forceps.diagnosis.inference.fit import Fit, directions_of, inverted, moved, prior_of
from hil_forceps.diagnosis.preparation.records import Record
from hil_forceps.diagnosis.state_space.advance import physics_of
from hil_forceps.diagnosis.state_space.layout import Noise
from hil_forceps.diagnosis.state_space.passes import Passed
from hil_forceps.diagnosis.validation.replicate import replicate
from hil_forceps.rig import Rig

Vector = NDArray[np.float64]

REPLICATES = 3  # of all runs: their mean adds a third to the variance of what is compared with it

Prepare = Callable[[Sequence[EvenRun]], Sequence[Record]]


class Bootstrap(NamedTuple):
    """What replicates are simulated with, and prepared and adapted as the measured runs were."""

    rig: Rig
    noise: Noise
    prepare: Prepare
    how: Search

    def replicates(self, model: Fit, runs: Sequence[EvenRun], records: Sequence[Record]) -> Iterator[Sequence[Record]]:
        """Yield the runs as simulated with a model, `REPLICATES` times."""
        theta, plant, mapper = model.passes.theta, model.passes.plant, self.how.mapper
        passes = pass_all([record.with_friction_of(plant) for record in records], theta, mapper)
        every = list(zip(range(len(runs)), runs, records, passes.runs, strict=True))
        for number in range(REPLICATES):

            def simulated(item: tuple[int, EvenRun, Record, Passed], number: int = number) -> EvenRun:
                place, even, record, passed = item
                rng = np.random.default_rng([self.how.seed, number, place])
                return replicate(even, record, passed, self.rig, theta, self.noise, rng)

            yield self.prepare(list(mapper(simulated, every)))

    def beside(self, model: Fit, runs: Sequence[Record]) -> Fit:
        """Return a model with passes over other runs, adapted to it as those that it was fitted to."""
        theta, mapper = model.passes.theta, self.how.mapper
        adapted = self.how.adapt(runs, model._replace(passes=pass_all(runs, theta, mapper)), first=True)
        return model._replace(passes=pass_all(adapted, theta, mapper))

    def shift(self, beside: Fit) -> Vector:
        """Return the step to which other runs' score moves the parameters, in units of their scales.

        The prior weighs in the curvature alone: that it draws the parameters is no bias.
        """
        free, passes = beside.free, beside.passes
        found = gram(passes, directions_of(free, passes.theta), self.how.mapper)
        _, precision = prior_of(free, passes.theta)
        return np.asarray(-inverted(found.information + np.diag(precision)) @ found.score)


def bias_corrected(model: Fit, shifts: Sequence[Vector]) -> Fit:
    """Return a fit less its bias, the mean shift of its parameters in replicates.

    The covariance is that of the corrected estimate. It is scaled by the shifts' scatter where that is more than the
    fit's own covariance.
    """
    bias = np.mean(shifts, axis=0)
    precision = inverted(model.covariance)
    scatter = [float((shift - bias) @ precision @ (shift - bias)) for shift in shifts]
    dispersion = max(1.0, sum(scatter) / (bias.size * (len(shifts) - 1)))
    known = model._replace(covariance=dispersion * (1.0 + 1.0 / len(shifts)) * model.covariance)
    return shifted(known, -bias)


def corrected_replicates(model: Fit, shifts: Sequence[Vector]) -> list[Fit]:
    """Return the corrected estimate of each replicate; the model itself where nothing is corrected."""
    if not shifts:
        return [model] * REPLICATES
    known, bias = bias_corrected(model, shifts), np.mean(shifts, axis=0)
    return [shifted(known._replace(passes=model.passes), shift - bias) for shift in shifts]


def shifted(model: Fit, shift: Vector) -> Fit:
    """Return a fit with its parameters moved, without passes over runs."""
    theta = moved(model.passes.theta, model.free, shift)
    return model._replace(passes=Passes(theta, physics_of(theta), ()))
