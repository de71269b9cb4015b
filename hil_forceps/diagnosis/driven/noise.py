"""The noise of driven runs, taken for autoregressive.

What an entry would explain must not pass for noise: on a real instrument it is most of what is left. Where strokes
repeat themselves, noise is how they differ, whatever the model. Elsewhere it is what neither the model explains nor a
regression on the catalogue beside it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.driven.passed import DrivenPassed, DrivenRun
from hil_forceps.diagnosis.driven.whitening import Whitening, white, whitening
from hil_forceps.diagnosis.evidence import Gram, Mapper, gram_of, total
from hil_forceps.diagnosis.hypotheses.places import places_of
from hil_forceps.diagnosis.inference.fit import Fit, directions_of, inverted, prior_of
from hil_forceps.diagnosis.validation.strokes import stroke_differences

Vector = NDArray[np.float64]

ROUNDS = 2  # of the weights of the regression, which are those of the noise


@dataclass(frozen=True, slots=True)
class Adapting:
    """Adapts runs to a model: the noise beside it, and what the noise of their motion does with it."""

    without: frozenset[str]
    mapper: Mapper
    repeated: dict[str, Whitening] | None  # the noise that strokes show

    def __call__(self, runs: Sequence[DrivenRun], model: Fit, *, first: bool) -> list[DrivenRun]:
        """Return the runs adapted; the noise in the first round alone."""
        filters = runs[0].white
        if first:
            filters = self.repeated or noise_beside(model, self.without, self.mapper)
        theta = model.passes.theta
        return list(self.mapper(lambda run: run.adapted(theta, filters), runs))


def noise_of_strokes(runs: Sequence[DrivenRun]) -> dict[str, Whitening] | None:
    """Return the filter of each channel for what differs from stroke to stroke; None where most rows don't repeat."""
    rows = sum(int(run.mask.sum()) for run in runs)
    repeating = [(run, found) for run in runs if (found := stroke_differences(run.rows)) is not None]
    if 2 * sum(int(run.mask.sum()) for run, _ in repeating) < rows:
        return None
    names = dict.fromkeys(name for _, found in repeating for name in found.channels)
    filters = {}
    for name in names:
        there = [found for _, found in repeating if name in found.channels]
        filters[name] = whitening([found.channels[name] for found in there], [found.both for found in there])
    return filters


def noise_beside(model: Fit, without: frozenset[str], mapper: Mapper) -> dict[str, Whitening]:
    """Return the filter of each channel for what neither a model nor a regression on the catalogue explains."""
    passes = model.passes
    known = directions_of(model.free, passes.theta)
    _, places, _ = places_of(passes, without)
    directions = [*known, *places]
    changes = list(mapper(lambda run: run.changes(passes.plant, directions), passes.runs))
    away, precision = prior_of(model.free, passes.theta)
    pull = np.concatenate((precision * away, np.zeros(len(places))))
    precision = np.concatenate((precision, np.zeros(len(places))))
    # Weighed by the noise so far, a misfit that is slow would stay noise for good: the first weights are even.
    filters = _even(passes.runs)
    runs = [run.with_filters(filters) for run in passes.runs]
    for _ in range(ROUNDS):

        def one(pair: tuple[DrivenPassed, list[dict[str, Vector]]]) -> Gram:
            run, changed = pair
            return gram_of((run.columns(changed),), (run.influence * run.residual).ravel())

        found = total(list(mapper(one, list(zip(runs, changes, strict=True)))))
        good = np.isfinite(np.diag(found.information)) & np.isfinite(found.score)
        information = np.where(np.outer(good, good), found.information, 0.0)
        # A little of each column's own information: what runs don't show stays at none.
        curvature = information + np.diag(precision + 1e-9 * np.diag(information) + 1e-12)
        sizes = -inverted(curvature) @ (np.where(good, found.score, 0.0) + pull)
        left = [_left(run, changed, sizes) for run, changed in zip(passes.runs, changes, strict=True)]
        filters = {name: _of_channel(name, passes.runs, left) for name in filters}
        runs = [run.with_filters(filters) for run in passes.runs]
    return filters


def _even(runs: Sequence[DrivenPassed]) -> dict[str, Whitening]:
    """Return filters of noise that is white, as strong as what is left of each channel."""
    found = {}
    for name in dict.fromkeys(name for run in runs for name in run.raw):
        squares = [
            float(np.mean((run.raw[name] - run.zeros[name])[run.run.mask] ** 2)) for run in runs if name in run.raw
        ]
        found[name] = white(max(float(np.sqrt(np.mean(squares))), 1e-300))
    return found


def _left(run: DrivenPassed, changes: Sequence[dict[str, Vector]], sizes: Vector) -> dict[str, Vector]:
    found = {}
    for name, values in run.raw.items():
        explained = sum(float(s) * c.get(name, 0.0) for s, c in zip(sizes, changes, strict=True) if s != 0.0)
        left = values - explained
        counted = run.run.mask
        found[name] = left - (float(np.mean(left[counted])) if counted.any() else 0.0)
    return found


def _of_channel(name: str, runs: Sequence[DrivenPassed], left: Sequence[dict[str, Vector]]) -> Whitening:
    there = [(one[name], run.run.mask) for run, one in zip(runs, left, strict=True) if name in one]
    return whitening([values for values, _ in there], [mask for _, mask in there])
