"""Entries of the best model are exchanged for what was near; entries drop out only where χ² says so, too."""

from collections.abc import Mapping, Sequence

import numpy as np
import pytest

from hil_forceps.diagnosis.evidence import Passes
from hil_forceps.diagnosis.hypotheses import exchange, score_test
from hil_forceps.diagnosis.hypotheses import search as searching
from hil_forceps.diagnosis.hypotheses.candidate import Candidate, Search
from hil_forceps.diagnosis.hypotheses.exchange_test import Exchange
from hil_forceps.diagnosis.hypotheses.places import Place
from hil_forceps.diagnosis.hypotheses.shortlist import best_starts
from hil_forceps.diagnosis.inference.fit import Fit
from hil_forceps.diagnosis.inference.parameters import Free
from hil_forceps.diagnosis.state_space.advance import physics_of
from hil_forceps.model import parameters
from tests.hidden_effects.generator import RIG

THETA = parameters.vector(RIG)
FIT = Fit((), Passes(THETA, physics_of(THETA), ()), np.zeros((0, 0)))
SEARCH = Search(
    runs=(),
    known=(),
    mapper=map,
    without=frozenset(),
    seed=0,
    progress=lambda _: None,
    spent=lambda: False,
    adapt=lambda runs, *_, **__: runs,
    least_share=0.0,
    tied_share=0.0,
    geared=False,
    friction_decides=False,
    most_effects=6,
    weigh=None,
)
TESTED = score_test.Tested(np.zeros(0), [], [], np.zeros((0, 0)), 16.0, np.zeros(0))


def candidate(effects: Sequence[str], gain: float) -> Candidate:
    return Candidate(tuple(effects), FIT, gain)


def fitting(monkeypatch: pytest.MonkeyPatch, gains: Mapping[frozenset[str], float]) -> list[frozenset[str]]:
    """Let a refit gain what `gains` says of its effects; return those that were asked for."""
    asked = []

    def fitted(
        _: Search, __: Candidate, ___: Passes, effects: Sequence[str], *, added: int, least_gain: float | None = None
    ) -> Candidate:
        del added, least_gain
        asked.append(frozenset(effects))
        return candidate(effects, gains[frozenset(effects)])

    for module in (searching, exchange):
        monkeypatch.setattr(module, "fitted", fitted)
        monkeypatch.setattr(module, "pass_all", lambda *_: FIT.passes)
        monkeypatch.setattr(module, "adapted_to", lambda s, model: (s, model))
    return asked


BEST = candidate(["wire_creep", "cogging"], 80.0)


def exchange_of(leaving: Sequence[str], joining: Sequence[str], gain: float, explained: float = 0.0) -> Exchange:
    """Return an exchange of whole entries, as it is predicted."""
    places = tuple(Place(name, {}, {}, 0, 0, one_sided=False) for name in joining)
    return Exchange(tuple(leaving), places, (np.zeros(0),) * len(places), np.zeros(0), gain, explained)


def test_what_is_likelier_beside_a_later_entry_takes_the_place_of_one(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = fitting(monkeypatch, {frozenset({"wire_hysteresis", "cogging"}): 5.0})
    near = [exchange_of(["wire_creep"], ["wire_hysteresis"], 4.0), exchange_of(["wire_creep"], ["wire_damping"], -20.0)]
    best, rivals = exchange.exchanged(SEARCH, BEST, (BEST,), near, 16.0)
    assert set(best.effects) == {"wire_hysteresis", "cogging"}
    assert [set(c.effects) for c in rivals] == [{"wire_hysteresis", "cogging"}, {"wire_creep", "cogging"}]
    assert rivals[0].gain == 85.0
    assert asked == [frozenset({"wire_hysteresis", "cogging"})]  # what is far behind isn't tried


def test_where_much_is_at_stake_the_prediction_is_trusted_less(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = fitting(monkeypatch, {frozenset({"wire_damping", "cogging"}): -1.0})
    exchange.exchanged(SEARCH, BEST, (BEST,), [exchange_of(["wire_creep"], ["wire_damping"], -20.0, 500.0)], 16.0)
    assert len(asked) == 1


def test_an_entry_more_pays_for_itself_and_one_less_is_worth_as_much(monkeypatch: pytest.MonkeyPatch) -> None:
    gains = {frozenset({"wire_hysteresis", "wire_damping", "cogging"}): 20.0, frozenset({"torque_ripple"}): -10.0}
    fitting(monkeypatch, gains)
    near = [
        exchange_of(["wire_creep"], ["wire_hysteresis", "wire_damping"], 4.0),
        exchange_of(["wire_creep", "cogging"], ["torque_ripple"], 4.0),
    ]
    best, rivals = exchange.exchanged(SEARCH, BEST, (BEST,), near, 16.0)
    assert best.effects == ("torque_ripple",)
    assert [c.gain for c in rivals] == [86.0, 84.0, 80.0]


def test_what_is_less_likely_by_far_is_no_rival(monkeypatch: pytest.MonkeyPatch) -> None:
    fitting(monkeypatch, {frozenset({"wire_hysteresis", "cogging"}): -40.0})
    near = [exchange_of(["wire_creep"], ["wire_hysteresis"], 4.0)]
    best, rivals = exchange.exchanged(SEARCH, BEST, (BEST,), near, 16.0)
    assert best is BEST
    assert rivals == (BEST,)


@pytest.mark.parametrize(("without", "kept"), [(-10.0, False), (-290.0, True)], ids=["it doesn't pay", "it does"])
def test_an_entry_drops_out_only_where_chi2_hardly_rises_without_it(
    monkeypatch: pytest.MonkeyPatch, without: float, kept: bool
) -> None:
    fitting(monkeypatch, {frozenset({"cogging"}): without, frozenset({"wire_creep"}): without})
    monkeypatch.setattr(searching, "wald", lambda *_: 3.0)  # by its own deviation it could be none
    thinned = searching._thinned(SEARCH, BEST, 16.0)
    assert len(thinned.effects) == (2 if kept else 1)
    assert thinned.gain == (80.0 if kept else 80.0 + without)


def free(count: int) -> Fit:
    parameters_of = tuple(Free(f"p{i}", 0.0, 1.0, -1.0, 1.0, False, True) for i in range(count))
    return FIT._replace(free=parameters_of)


@pytest.mark.parametrize(("behind", "first"), [(9.0, "load_dependent_friction"), (11.0, "loaded_presliding")])
def test_of_models_that_are_hardly_apart_the_one_with_fewest_parameters_is_first(behind: float, first: str) -> None:
    more = Candidate(("loaded_presliding",), free(10), 1000.0)
    fewer = Candidate(("load_dependent_friction",), free(9), 1000.0 - behind)
    far = Candidate(("cogging",), free(2), 500.0)
    order = exchange.ranked([far, fewer, more], 0.01)
    assert order[0].effects == (first,)
    assert len(order) == 3
    assert order[-1] is far


def test_a_rival_with_more_dry_friction_is_compared_on_runs_adapted_to_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside the best model, which has none, rows where a mass sticks are evidence; beside the rival they aren't."""
    smooth, dry = candidate(["loaded_presliding"], 102.0), candidate(["load_dependent_friction"], 100.0)
    near = [exchange_of(["loaded_presliding"], ["load_dependent_friction"], -2.0)]
    adapted = SEARCH._replace(runs=("adapted",), friction_decides=True)
    seen: list[tuple[object, ...]] = []

    def fitted(
        s: Search, __: Candidate, ___: Passes, effects: Sequence[str], *, added: int, least_gain: float | None = None
    ) -> Candidate:
        del added, least_gain
        seen.append(tuple(s.runs))
        return candidate(effects, 7.0 if s.runs else -2.0)

    monkeypatch.setattr(exchange, "fitted", fitted)
    monkeypatch.setattr(exchange, "pass_all", lambda *_: FIT.passes)
    monkeypatch.setattr(exchange, "adapted_to", lambda _, model: (adapted, model))
    monkeypatch.setattr(exchange, "fit", lambda *_: FIT)
    best, rivals = exchange.exchanged(SEARCH._replace(friction_decides=True), smooth, (smooth, dry), near, 16.0)
    assert seen == [(), ("adapted",)]
    assert best.effects == ("load_dependent_friction",)
    assert [c.gain for c in rivals] == [109.0, 102.0]
    exchange.exchanged(SEARCH, smooth, (smooth, dry), near, 16.0)
    assert len(seen) == 2  # where friction decides nothing, both were compared when they joined


def test_an_empty_catalogue_has_nothing_to_refit() -> None:
    assert best_starts(FIT, (), TESTED, map) == []
