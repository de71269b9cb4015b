"""Candidate models of a search, their fits, and the runs adapted to one of them."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from hil_forceps.diagnosis.evidence import Mapper, Passes, pass_all
from hil_forceps.diagnosis.hypotheses.places import Place
from hil_forceps.diagnosis.hypotheses.score_test import COST_PER_COLUMN, Tested
from hil_forceps.diagnosis.inference.dispersion import Weigh, scatter_between
from hil_forceps.diagnosis.inference.fit import Fit, RequiredGain, chi2_above, fit, fit_from
from hil_forceps.diagnosis.inference.parameters import Free, effect_parameters, values_of

ADAPTING_ROUNDS = 3  # of a pass that decides and a fit to what it decided
ADAPTED_DEVIATIONS = 0.3  # deviations of a parameter: a fit that moves less decides the same


class Candidate(NamedTuple):
    """A model: effects with the fit that holds them."""

    effects: tuple[str, ...]
    fit: Fit
    gain: float  # twice the log likelihood above the model it extends, less the cost of its parameters
    worth: float = 0.0  # of χ², what that is beside how its scores scatter

    def without_runs(self) -> "Candidate":
        """Return the model without its passes over the runs."""
        return self._replace(fit=self.fit._replace(passes=self.fit.passes._replace(runs=())))


class Step(NamedTuple):
    """One step of the search."""

    beside: tuple[str, ...]
    places: tuple[Place, ...]
    tested: Tested
    tried: tuple[Candidate, ...]
    joined: str = ""  # the entry that did


class Adapt(Protocol):
    """How runs are adapted to a model: what a pass with it decides, and the noise that it leaves."""

    def __call__(self, runs: Sequence[Any], model: Fit, *, first: bool) -> Sequence[Any]:
        """Return the runs (`Evidence`) adapted to a model; `first`: of several rounds."""


class Search(NamedTuple):
    """What a search works on."""

    runs: Sequence[Any]  # `Evidence`
    known: tuple[Free, ...]
    mapper: Mapper
    without: frozenset[str]
    seed: int
    progress: Callable[[str], None]
    spent: Callable[[], bool]  # whether the time that was allowed is spent
    adapt: Adapt
    least_share: float  # of what is explained, that a further entry must gain
    tied_share: float  # of the best gain: models that are no further behind are taken for equally good
    geared: bool  # the motor's angle may be one behind a gear: harmonics need not be whole
    friction_decides: bool  # which rows are evidence depends on the dry friction of a model
    most_effects: int
    weigh: Weigh | None  # what a gain is worth beside how its scores scatter; None: as the likelihood has it


def with_runs(s: Search, model: Candidate) -> Candidate:
    """Return a model with its passes over the runs."""
    if model.fit.passes.runs:
        return model
    return model._replace(fit=model.fit._replace(passes=pass_all(s.runs, model.fit.passes.theta, s.mapper)))


def adapted_to(s: Search, model: Candidate) -> tuple[Search, Candidate]:
    """Return search and model with the runs adapted to the model; all models that are compared with it use these runs.

    Decisions of a pass depend on the parameters, and the fit on the decisions: both are repeated until they converge.
    """
    found = model.fit
    for number in range(ADAPTING_ROUNDS):
        runs = s.adapt(s.runs, found, first=number == 0)
        before = found.values
        refitted = fit(runs, found.passes.theta, found.free, s.mapper)
        if not is_finite(refitted.passes):
            break  # as it decides, the model has no finite answer: it stays as it was fitted
        s, found = s._replace(runs=runs), refitted
        if np.all(np.abs(found.values - before) < ADAPTED_DEVIATIONS * found.deviations):
            break
    return s, model._replace(fit=found)


def is_finite(passes: Passes) -> bool:
    """Tell whether a model has an answer to its runs: a filter that diverges has none."""
    return all(bool(np.isfinite(run.residual).all()) for run in passes.runs)


def fitted(
    s: Search,
    model: Candidate,
    start: Passes,
    effects: Sequence[str],
    *,
    added: int,
    least_gain: float | None = None,
) -> Candidate:
    """Return the fit of a model with `effects` from a start that holds them; its gain is that above `model`.

    `added`: number of entries more than in `model`. Each further parameter costs `COST_PER_COLUMN`, except the first of
    each added entry, which the threshold accounts for. A fit that can't gain `least_gain` ends early.
    """
    free = list(s.known)
    for effect_id in effects:
        free += effect_parameters(effect_id, values_of(start.theta, effect_id))
    base = model.fit
    cost = COST_PER_COLUMN * (len(free) - len(base.free) - added)
    required = None if least_gain is None else RequiredGain(base, least_gain + cost)
    found = fit_from(s.runs, start, free, s.mapper, required=required)
    gain = chi2_above(base, found.passes, found.free)
    worth = s.weigh(gain - cost, scatter_between(base.passes, found.passes)) if s.weigh else gain - cost
    return Candidate(tuple(effects), found, gain - cost, worth)
