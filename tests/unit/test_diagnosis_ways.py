"""Several ways up where the motion drives: the likeliest at its end is taken, and nothing of the others stays."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from hil_forceps.diagnosis import choice
from hil_forceps.diagnosis.choice import Choice, Chooser, Rival
from hil_forceps.diagnosis.extension import Model
from hil_forceps.diagnosis.result import Candidate
from hil_forceps.diagnosis.spectrum import Whitener

FIRST = ("cogging", "jaw_gravity", "wire_hardening")  # by the gain of the first step
NOISE = {"cogging": 1.0, "jaw_gravity": 2.0, "wire_hardening": 0.5}  # that each way leaves


class _Fit:
    def __init__(self, chi2: float) -> None:
        self.chi2 = chi2


class _Shared:
    items: tuple[str, ...] = ()


class _Problem:
    shared = _Shared()


def named(*effects: str) -> Model:
    return Model(effects, cast("Any", _Problem()), cast("Any", _Fit(900.0)))


def whitener(noise: float) -> Whitener:
    return Whitener(np.full(1000, 1.0 / noise, dtype=np.float32), (), np.empty(0, dtype=np.complex64))


class _Looker:
    def __init__(self) -> None:
        self.inflation: dict[str, float] = {}


class Guided(Chooser):
    """Finds three first entries; each is followed by one of its own, and its noise is `NOISE`."""

    def __init__(self, *, driven: bool) -> None:
        super().__init__(cast("Any", _Looker()), lambda _: None, cast("Any", None), driven=driven)
        self.grown: list[tuple[str, ...]] = []

    def _look(self, model: Model, whitener: Whitener) -> Any:
        return model, None, whitener, None

    def _refined(self, model: Model, *_: Any, **__: Any) -> list[Model]:
        if not model.effects:
            self._candidates.append(Candidate(FIRST[0], 0, 9.0, 1.0, "named"))
            self._candidates += [Candidate(name, 0, 8.0, 1.0, "weaker") for name in FIRST[1:]]
            return [named(name) for name in FIRST]
        return []

    def _grown(self, choice: Choice, refined: list[Model], *_: Any) -> Choice:
        if not refined:
            return replace(choice, candidates=tuple(self._candidates), inflation=dict(self._looker.inflation))
        best = refined[0]
        self.grown.append(best.effects)
        self._looker.inflation[best.effects[0]] = 7.0
        found = replace(choice, model=best, rivals=(Rival(best, 0.0),), whitener=whitener(NOISE[best.effects[0]]))
        return replace(found, candidates=tuple(self._candidates))


def test_the_way_that_leaves_least_noise_at_its_end_is_taken() -> None:
    chooser = Guided(driven=True)
    choice = chooser.choose(named(), whitener(4.0))

    assert chooser.grown == [(name,) for name in FIRST]
    assert choice.model.effects == ("wire_hardening",)
    assert {c.id: c.state for c in choice.candidates} == {
        "cogging": "weaker",
        "jaw_gravity": "weaker",
        "wire_hardening": "named",
    }
    assert choice.inflation == {"wire_hardening": 7.0}


def test_in_closed_loop_the_best_first_entry_is_gone_on() -> None:
    chooser = Guided(driven=False)

    assert chooser.choose(named(), whitener(4.0)).model.effects == ("cogging",)
    assert chooser.grown == [("cogging",)]


@pytest.mark.parametrize("quieter", [0.5, 2.0])
def test_less_noise_outweighs_the_chi2_that_it_raises(quieter: float) -> None:
    """χ² beside a model's own noise is much the same for each; the noise tells."""
    NOISE["jaw_gravity"] = quieter * NOISE["wire_hardening"]
    try:
        found = Guided(driven=True).choose(named(), whitener(4.0)).model.effects
    finally:
        NOISE["jaw_gravity"] = 2.0
    assert found == (("jaw_gravity",) if quieter < 1.0 else ("wire_hardening",))


@pytest.mark.parametrize(
    ("driven", "effects", "widely"),
    [(True, (), True), (True, ("cogging",), False), (False, (), True), (False, ("cogging",), True)],
)
def test_the_ways_begin_with_a_wide_look(
    driven: bool, effects: tuple[str, ...], widely: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two of the right jaw's entries came near by their linear gain; the way of a third ended far likelier."""
    asked: list[bool] = []

    def listed(*_: Any, widely: bool, **__: Any) -> tuple[list[int], ...]:
        asked.append(widely)
        return ()

    for name, value in (("best_of_each", {}), ("to_try", []), ("hold", None), ("with_aliases", ())):
        monkeypatch.setattr(choice, name, lambda *_, value=value: value)
    monkeypatch.setattr(choice, "shortlists", listed)
    chooser = Chooser(cast("Any", _Looker()), lambda _: None, cast("Any", None), driven=driven)
    monkeypatch.setattr(Chooser, "_needed", lambda *_: np.empty(0))
    model = replace(named(*effects), fit=cast("Any", SimpleNamespace(jacobian=None)))
    scan = cast("Any", SimpleNamespace(scores=SimpleNamespace(gains=np.empty(0))))

    assert chooser._refined(model, scan, whitener(1.0), 0) == []
    assert asked == [widely]
