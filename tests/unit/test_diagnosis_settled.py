"""A fit and the rounding that is taken anew beside it, in turn: where each turn goes a little of the way."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from hil_forceps.diagnosis import choice
from hil_forceps.diagnosis.choice import Chooser
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
    assert choice._moved(at(4.9), np.array([4.0])).fit.u[0] == 5.0


class Trapped(Slow):
    """Fit and rounding in turn come to a place short of the end, from either side of it."""

    def __init__(self, *, driven: bool = False, trap: float = 0.6) -> None:
        super().__init__(driven=driven)
        self.trap, self.turns = trap, 0

    def _anew(self, model: Model, *_: Any) -> Model:
        self.turns += 1
        place = float(model.fit.u[0])
        return at(place + SHARE * (self.trap - place))

    def _seen(self, model: Model, whitener: Any) -> Any:
        return model, None, whitener, None


def looked_at(monkeypatch: pytest.MonkeyPatch, chooser: Trapped) -> float:
    monkeypatch.setattr(choice, "at_the_rig_s_word", lambda *_: None)
    return float(chooser._look(at(0.0), cast("Any", None))[0].fit.u[0])


@pytest.mark.usefixtures("_nothing_else")
@pytest.mark.parametrize("trap", [0.45, 0.6, 0.8])
def test_where_turns_end_is_left_for_where_chi2_is_least(trap: float, monkeypatch: pytest.MonkeyPatch) -> None:
    assert Trapped(trap=trap)._settled(at(0.0), cast("Any", None)).fit.u[0] == pytest.approx(trap, abs=0.1)
    assert looked_at(monkeypatch, Trapped(trap=trap)) == pytest.approx(END, abs=0.15)


@pytest.mark.usefixtures("_nothing_else")
def test_where_going_on_is_no_better_one_look_is_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    stays, goes_on = Trapped(trap=END), Trapped(trap=END)
    place = float(stays._settled(at(0.0), cast("Any", None)).fit.u[0])
    assert looked_at(monkeypatch, goes_on) == place
    assert goes_on.turns == stays.turns + 1


@pytest.mark.usefixtures("_nothing_else")
def test_driven_by_motion_nothing_is_gone_on(monkeypatch: pytest.MonkeyPatch) -> None:
    chooser = Trapped(driven=True)
    assert looked_at(monkeypatch, chooser) < chooser.trap
