"""Answers to other parameters are those of another pass: where masses stop and are held, too."""

from typing import NamedTuple

import numpy as np
import pytest

from hil_forceps.diagnosis.evidence import Direction, Passes, pass_all
from hil_forceps.diagnosis.hypotheses.places import places_of
from hil_forceps.diagnosis.preparation.records import Record
from hil_forceps.diagnosis.state_space.advance import physics_of, steps_of
from hil_forceps.diagnosis.state_space.passes import Matrix, Vector
from hil_forceps.model import parameters
from tests.unit.diagnosis.simulated_runs import POOL, STICKING, records_of, runs_of

SMOOTH = STICKING.with_changes({"encoder.counts_per_rev": "ideal"})  # of whole counts another pass weighs others


class Decided(NamedTuple):
    """Runs with what a pass over them decided, and such a pass."""

    records: list[Record]
    passes: Passes


@pytest.fixture(scope="module", name="sticking")
def _sticking() -> Decided:
    theta = parameters.vector(SMOOTH)
    records = records_of(runs_of(SMOOTH, ("hold", "multisine"), 10318), SMOOTH)
    decided = [record.decided_by(record.passed(theta, physics_of(theta)).filtered) for record in records]
    return Decided(decided, pass_all(decided, theta, POOL.map))


def _directions(passes: Passes, effect_id: str) -> list[Direction]:
    places, directions, _ = places_of(passes, frozenset())
    return [directions[i] for place in places if place.effect_id == effect_id for i in range(place.first, place.stop)]


def _answers(passes: Passes, directions: list[Direction]) -> Matrix:
    return np.concatenate([run.answers(passes.plant, directions).astype(np.float64) for run in passes.runs])


def _weighted(decided: Decided, theta: Vector) -> Vector:
    """Return innovations with other parameters, weighted as those of the pass."""
    there = [record.passed(theta, physics_of(theta)).filtered.residual for record in decided.records]
    pairs = zip(there, decided.passes.runs, strict=True)
    return np.concatenate([np.where(run.counts, run.influence * one, 0.0).ravel() for one, run in pairs])


def test_what_the_zero_of_the_jaw_absorbs_has_next_to_no_column(sticking: Decided) -> None:
    """Its prior alone tells a stretch of the wire at rest from that zero: 0.07 deviations a run and µm.

    Where masses stop, a column by a linear plant was 100 deviations off in single rows.
    """
    answers = _answers(sticking.passes, _directions(sticking.passes, "wire_permanent_stretch"))
    assert np.linalg.norm(answers) < 0.3


@pytest.mark.parametrize(
    "effect_id",
    ["wire_creep", "pulley_eccentricity", "load_dependent_friction", "wire_hysteresis", "presliding_friction"],
)
def test_an_answer_is_what_another_pass_makes(sticking: Decided, effect_id: str) -> None:
    directions = _directions(sticking.passes, effect_id)
    answers = _answers(sticking.passes, directions)
    for at, direction in enumerate(directions):
        assert direction.origin is not None
        change = direction.per * (_weighted(sticking, direction.theta) - _weighted(sticking, direction.origin))
        assert np.linalg.norm(answers[:, at] - change) < 0.05 * np.linalg.norm(change)


def test_plants_with_other_steps_are_compared_with_their_own(sticking: Decided) -> None:
    """Stribeck friction is stepped in pieces: without any of it, innovations are 0.005 deviations off.

    Over a ten-thousandth of its amplitude that is a twentieth of what it does.
    """
    directions = _directions(sticking.passes, "stribeck_friction")[:1]
    assert directions[0].origin is not None
    assert steps_of(physics_of(directions[0].origin)) != steps_of(sticking.passes.plant)
    own = _answers(sticking.passes, directions)
    without = _answers(sticking.passes, [direction._replace(origin=None) for direction in directions])
    assert np.linalg.norm(without - own) > 0.01 * np.linalg.norm(own)
