"""A fit and the rounding that is taken anew beside it, in turn: where each turn goes a little of the way."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from hil_forceps.diagnosis import choice
from hil_forceps.diagnosis.choice import Choice, Chooser, Rival
from hil_forceps.diagnosis.extension import Model
from hil_forceps.diagnosis.fit import Held

END = 1.0  # where the fit would come to in the end
SHARE = 0.1  # of the way that a turn goes
MOST = 2000.0  # of χ², at 0


class _Fit(SimpleNamespace):
    def _replace(self, **changed: Any) -> "_Fit":
        return _Fit(**{**vars(self), **changed})


class Slow(Chooser):
    """Each turn goes a tenth of the way, to a place where χ² is the less the nearer the end."""

    def __init__(self, *, driven: bool) -> None:
        super().__init__(cast("Any", None), lambda _: None, cast("Any", None), driven=driven)

    def _anew(self, model: Model, *_: Any) -> Model:
        return at(float(model.fit.u[0]) + SHARE * (END - float(model.fit.u[0])))


def at(place: float) -> Model:
    problem = SimpleNamespace(
        shared=SimpleNamespace(items=()),
        bounds=lambda: (np.array([-5.0]), np.array([5.0])),
    )
    fit = _Fit(u=np.array([place]), chi2=MOST * (END - place) ** 2, jacobian=None)
    return Model(("film_friction",), cast("Any", problem), cast("Any", fit))


@pytest.fixture
def _nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(choice, "out_of_a_wrong_valley", lambda problem, u, _: (problem, u))
    monkeypatch.setattr(choice, "at_better_widths", lambda problem, fit, *_: (problem, fit.u))
    for name in ("hold", "hold_beside"):
        monkeypatch.setattr(choice, name, lambda *_: cast("Held", None))


def settled(*, driven: bool) -> float:
    found = Slow(driven=driven)._settled(at(0.0), cast("Any", None))
    return float(found.fit.u[0])


@pytest.mark.usefixtures("_nothing_else")
def test_a_long_way_in_small_steps_is_gone_to_its_end() -> None:
    assert settled(driven=False) == pytest.approx(END, abs=0.1)


@pytest.mark.usefixtures("_nothing_else")
def test_driven_by_motion_there_is_no_rounding_to_follow() -> None:
    steps = 1 + choice.MOST_REFRESHES
    assert settled(driven=True) == pytest.approx(1.0 - (1.0 - SHARE) ** steps, abs=1e-9)


@pytest.mark.usefixtures("_nothing_else")
def test_what_lies_beyond_counts_only_where_it_is_better(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(choice, "BEYOND", 40.0)  # past the end, and worse there

    assert settled(driven=False) == pytest.approx(settled(driven=True), abs=1e-9)


def test_a_place_beyond_keeps_to_the_bounds() -> None:
    assert choice._moved(at(4.9), at(0.0).fit.u, 4.0).fit.u[0] == 5.0


class Trapped(Slow):
    """A turn doesn't leave a place between the beginning and the end."""

    def __init__(self) -> None:
        super().__init__(driven=False)
        self._looker = cast("Any", SimpleNamespace(inflation={}))

    def _anew(self, model: Model, *_: Any) -> Model:
        place = float(model.fit.u[0])
        return at(place) if 0.7 < place < 0.8 else super()._anew(model)

    def _seen(self, model: Model, whitener: Any) -> Any:
        return model, None, whitener, None

    def _refined(self, *_: Any, **__: Any) -> list[Model]:
        return []

    def _grown(self, choice: Choice, *_: Any) -> Choice:
        return choice

    def chosen(self, began: float, end: float) -> Choice:
        self._began[at(end).effects] = np.array([began])
        others = (Rival(at(end), 0.0), Rival(replace(at(end), effects=("stribeck_friction",)), 1.0))
        nothing = cast("Any", None)
        return Choice(others[0].model, others, (), nothing, nothing, nothing, {})

    def _as_far(self, other: Model, *_: Any) -> Model:
        return other


@pytest.mark.usefixtures("_nothing_else")
def test_a_way_that_ended_early_is_gone_to_its_end_from_further_on() -> None:
    chooser = Trapped()
    start = chooser.chosen(0.0, 0.75)
    assert chooser._settled(start.model, cast("Any", None)).fit.u[0] == 0.75
    found = chooser.onward(start)
    assert found.model.fit.u[0] == pytest.approx(END, abs=0.07)
    assert [rival.model for rival in found.rivals] == [found.model]  # the other is far behind now


@pytest.mark.usefixtures("_nothing_else")
def test_a_choice_stays_where_further_on_is_no_better() -> None:
    chooser = Trapped()
    start = chooser.chosen(0.75, 0.75)
    assert chooser.onward(start) is start
    chooser._began.clear()
    assert chooser.onward(start) is start
