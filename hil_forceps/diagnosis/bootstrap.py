"""Parametric bootstrap: a fitted model once more, beside runs that it has made itself.

What fits and tests find there is not in the data: the filter's approximations have made it (counts whose density is
not normal, speeds near standstill, what the drive counted between rows). So it is the bias of the estimates, and what
tests find where nothing is left (Efron and Tibshirani, An Introduction to the Bootstrap, 1993, chapters 6 and 10).
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
from hil_forceps.diagnosis.validation.remade import remade
from hil_forceps.rig import Rig

Vector = NDArray[np.float64]

SETS = 3  # of runs that are made: their mean adds a third to the variance of what is compared with it

Prepare = Callable[[Sequence[EvenRun]], Sequence[Record]]


class Bootstrap(NamedTuple):
    """What makes runs, and prepares them as the measured ones were."""

    rig: Rig
    noise: Noise
    prepare: Prepare
    how: Search

    def sets(self, model: Fit, runs: Sequence[EvenRun], records: Sequence[Record]) -> Iterator[Sequence[Record]]:
        """Yield the runs as a model makes them, `SETS` times."""
        theta, plant, mapper = model.passes.theta, model.passes.plant, self.how.mapper
        passes = pass_all([record.with_friction_of(plant) for record in records], theta, mapper)
        every = list(zip(range(len(runs)), runs, records, passes.runs, strict=True))
        for number in range(SETS):

            def made(item: tuple[int, EvenRun, Record, Passed], number: int = number) -> EvenRun:
                place, even, record, passed = item
                rng = np.random.default_rng([self.how.seed, number, place])
                return remade(even, record, passed, self.rig, theta, self.noise, rng)

            yield self.prepare(list(mapper(made, every)))

    def beside(self, model: Fit, runs: Sequence[Record]) -> Fit:
        """Return a model beside other runs, adapted to it as those that it was fitted to; its parameters stay."""
        theta, mapper = model.passes.theta, self.how.mapper
        adapted = self.how.adapt(runs, model._replace(passes=pass_all(runs, theta, mapper)), first=True)
        return model._replace(passes=pass_all(adapted, theta, mapper))

    def shift(self, beside: Fit) -> Vector:
        """Return where other runs move the parameters, in units of their scales; the prior is no part of it."""
        free, passes = beside.free, beside.passes
        found = gram(passes, directions_of(free, passes.theta), self.how.mapper)
        _, precision = prior_of(free, passes.theta)
        return np.asarray(-inverted(found.information + np.diag(precision)) @ found.score)


def without_bias(model: Fit, shifts: Sequence[Vector]) -> Fit:
    """Return a fit without its bias, which is where runs that it made itself move its parameters on the mean.

    Where they scatter by more than the fit's covariance says, that is what the parameters are known to.
    """
    bias = np.mean(shifts, axis=0)
    precision = inverted(model.covariance)
    scatter = [float((shift - bias) @ precision @ (shift - bias)) for shift in shifts]
    dispersion = max(1.0, sum(scatter) / (bias.size * (len(shifts) - 1)))
    known = model._replace(covariance=dispersion * (1.0 + 1.0 / len(shifts)) * model.covariance)
    return shifted(known, -bias)


def estimates(model: Fit, shifts: Sequence[Vector]) -> list[Fit]:
    """Return what fits without bias say of runs that a model made itself, `SETS` of them; without shifts, the model."""
    if not shifts:
        return [model] * SETS
    known, bias = without_bias(model, shifts), np.mean(shifts, axis=0)
    return [shifted(known._replace(passes=model.passes), shift - bias) for shift in shifts]


def shifted(model: Fit, shift: Vector) -> Fit:
    """Return a fit with its parameters moved, beside no runs."""
    theta = moved(model.passes.theta, model.free, shift)
    return model._replace(passes=Passes(theta, physics_of(theta), ()))
