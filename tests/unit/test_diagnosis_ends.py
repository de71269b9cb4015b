"""An entry that a fit drives to the end of its range gives way to one that isn't driven there, and comes near."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from hil_forceps.diagnosis.choice import Chooser, Rival
from hil_forceps.diagnosis.extension import Model
from hil_forceps.diagnosis.result import Candidate
from hil_forceps.diagnosis.unknowns import Unknown, Unknowns

LEAST = 1e-5
LENGTH = "effects.loaded_presliding.angle_rad"
LOADED, FRICTION, STRIBECK = "loaded_presliding", "load_dependent_friction", "stribeck_friction"


def fitted(*effects: str, chi2: float, length: float = 0.02, deviation: float = 0.0) -> Model:
    """Return a model; `length`: where the presliding's was fitted to, if there is any."""
    items = (Unknown(LENGTH, "rad", 0.0, 1.0, LEAST, 0.5, False, None),) * (LOADED in effects)
    shared = Unknowns(items)
    problem = SimpleNamespace(shared=shared, bounds=shared.bounds)
    covariance = np.full((len(items), len(items)), deviation**2)
    fit = SimpleNamespace(chi2=chi2, u=np.array([length])[: len(items)], covariance=covariance)
    return Model(effects, cast("Any", problem), cast("Any", fit))


class Ending(Chooser):
    """Fits that are made better beforehand: `ends` gives where each set of effects comes to."""

    def __init__(self, *ends: Model) -> None:
        super().__init__(cast("Any", SimpleNamespace(inflation={})), lambda _: None, cast("Any", None))
        self.ends = {model.effects: model for model in ends}
        self.looked_at: list[tuple[str, ...]] = []

    def _as_far(self, other: Model, *_: Any) -> Model:
        return self.ends[other.effects]

    def _look(self, model: Model, whitener: Any) -> Any:
        self.looked_at.append(model.effects)
        return self.ends[model.effects], None, whitener, None


def compared(chosen: Model, other: Model) -> tuple[Model, list[Rival]]:
    return Ending(chosen, other)._compared([Rival(chosen, 0.0)], [other], chosen.worth, cast("Any", None))


def test_one_at_the_end_of_its_range_gives_way_and_leaves_the_set() -> None:
    chosen, other = fitted(LOADED, STRIBECK, chi2=1000.0, length=LEAST), fitted(STRIBECK, FRICTION, chi2=1009.0)
    model, rivals = compared(chosen, other)
    assert model is other
    assert [(rival.model, rival.behind) for rival in rivals] == [(other, 0.0)]


def test_inside_its_range_it_stays() -> None:
    chosen, other = fitted(LOADED, STRIBECK, chi2=1000.0), fitted(STRIBECK, FRICTION, chi2=1009.0)
    model, rivals = compared(chosen, other)
    assert model is chosen
    assert [rival.model for rival in rivals] == [chosen]


@pytest.mark.parametrize(
    ("length", "deviation", "end"),
    [
        (1.5 * LEAST, 0.3 * LEAST, True),  # may as well be the least there is
        (1.5 * LEAST, 0.2 * LEAST, False),  # is known to be more
        (3.0 * LEAST, 2.0 * LEAST, False),  # hardly known, as of a weak effect: nothing is said of it
        (0.02, 0.02, False),
    ],
)
def test_a_length_that_may_as_well_be_none_is_at_its_end(length: float, deviation: float, end: bool) -> None:
    model = fitted(LOADED, chi2=1000.0, length=length, deviation=deviation)
    assert model.at_an_end is end
    assert model.newest_at_an_end is end


def test_a_harmonic_near_the_least_is_none() -> None:
    name = "effects.cogging.harmonic"
    shared = Unknowns((Unknown(name, "", 0.0, 1.0, 1.0, 60.0, False, None),))
    problem = SimpleNamespace(shared=shared, bounds=shared.bounds)
    fit = SimpleNamespace(chi2=1.0, u=np.array([1.06]), covariance=np.ones((1, 1)))
    assert not Model(("cogging",), cast("Any", problem), cast("Any", fit)).at_an_end


def test_what_is_far_behind_takes_no_place_from_it() -> None:
    chosen, other = fitted(LOADED, chi2=1000.0, length=LEAST), fitted(FRICTION, chi2=1100.0)
    assert compared(chosen, other)[0] is chosen


@pytest.mark.parametrize("length", [LEAST, 0.5])
def test_one_at_an_end_takes_no_place_but_may_be_as_good(length: float) -> None:
    chosen, other = fitted(FRICTION, chi2=1000.0), fitted(LOADED, chi2=995.0, length=length)
    model, rivals = compared(chosen, other)
    assert model is chosen
    assert [rival.model for rival in rivals] == [chosen, other]


def begun(*refined: Model, ends: tuple[Model, ...]) -> tuple[Model, list[str], Ending]:
    chooser = Ending(*ends)
    chooser._candidates = [
        Candidate(refined[0].effects[-1], 0, 90.0, 9.0, "named"),
        *(Candidate(model.effects[-1], 0, 80.0, 9.0, "weaker") for model in refined[1:]),
    ]
    best, _, look = chooser._first_of(list(refined), cast("Any", None))
    assert look[0] is chooser.ends[best.effects]
    return best, [candidate.state for candidate in chooser._candidates], chooser


def test_where_the_best_goes_to_an_end_when_fitted_on_the_next_is_looked_at() -> None:
    loaded, friction = fitted(LOADED, chi2=1000.0), fitted(FRICTION, chi2=1005.0)
    gone = fitted(LOADED, chi2=900.0, length=LEAST)
    best, states, chooser = begun(loaded, friction, ends=(gone, friction))
    assert best is friction
    assert states == ["at a bound", "named"]
    assert chooser.looked_at == [(LOADED,), (FRICTION,)]


def test_where_none_is_near_the_best_is_taken_wherever_it_ends() -> None:
    loaded, friction = fitted(LOADED, chi2=1000.0), fitted(STRIBECK, chi2=1100.0)
    gone = fitted(LOADED, chi2=900.0, length=LEAST)
    best, states, chooser = begun(loaded, friction, ends=(gone, friction))
    assert best is loaded
    assert states == ["named", "weaker"]
    assert chooser.looked_at == [(LOADED,)]


def test_no_second_look_is_taken_inside_the_range() -> None:
    loaded, friction = fitted(LOADED, chi2=1000.0), fitted(FRICTION, chi2=1005.0)
    best, states, chooser = begun(loaded, friction, ends=(loaded, friction))
    assert best is loaded
    assert states == ["named", "weaker"]
    assert chooser.looked_at == [(LOADED,)]
