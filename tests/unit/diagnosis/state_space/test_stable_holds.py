"""Holds: a change of the filter's state dies away there, and columns are those of another pass."""

from dataclasses import replace

import numpy as np
import pytest

from hil_forceps.data.even_rows import EvenRun
from hil_forceps.data.run import Run
from hil_forceps.diagnosis.evidence import gram, pass_all
from hil_forceps.diagnosis.identification import known_of, records_of
from hil_forceps.diagnosis.inference.fit import directions_of
from hil_forceps.diagnosis.preparation.records import Record
from hil_forceps.diagnosis.state_space.advance import physics_of
from hil_forceps.diagnosis.state_space.layout import JAW, LOAD_CELL, OMEGA_M, Noise
from hil_forceps.diagnosis.state_space.passes import pass_one
from hil_forceps.diagnosis.state_space.response_pass import response_run
from hil_forceps.model import parameters
from hil_forceps.rig import Rig
from tests.hidden_effects.generator import RIG, WHITE, generate
from tests.hidden_effects.generator_scenarios import SCENARIOS

NOISE = Noise(np.array([2e-4, 1e-5, 1e-3]), np.zeros(3), np.zeros(3))
ROWS, FORGOTTEN_ROWS = 4000, 50
STICKING = RIG.with_changes(
    {"forceps.motor_coulomb_N_m": 2e-4, "forceps.jaw_coulomb_N_m": 1e-4, "encoder.counts_per_rev": 65536}
)


def record_with(samples: int) -> tuple[Record, Rig]:
    """Return a run that reverses in slow motion beside dry friction, with so many samples of the drive in a row."""
    rig = STICKING.with_changes({"drive.sample_time_s": 1e-3 / samples})
    run = generate(rig, replace(SCENARIOS["multisine_mid"], row_s=1e-3), 3, WHITE, "slow")
    some = Run("slow", {name: values[:ROWS] for name, values in run.columns.items()})
    (record,), _ = records_of([EvenRun.whole(some)], [], rig, NOISE, map, parameters.vector(rig))
    return record, rig


@pytest.mark.parametrize("samples", [1, 2, 4])
def test_a_change_of_the_state_dies_away(samples: int) -> None:
    record, rig = record_with(samples)
    plant = physics_of(parameters.vector(rig))
    before = pass_one(record, plant)
    record = record.decided_by(before.filtered)
    changed = record.series.first_state.copy()
    changed[OMEGA_M] += 1e-6
    other = replace(record, series=record.series._replace(first_state=changed))
    change = np.abs(pass_one(other, plant).filtered.course - pass_one(record, plant).filtered.course)[:, OMEGA_M]
    held = record.series.friction_free_m[FORGOTTEN_ROWS:]
    assert held.sum() > 200
    assert change[FORGOTTEN_ROWS:].max() < 1e-8


@pytest.mark.parametrize("samples", [1, 2])
@pytest.mark.parametrize(
    ("name", "share"), [("forceps.motor_coulomb_N_m", 0.02), ("motor.torque_constant_N_m_per_A", 0.002)]
)
def test_columns_beside_friction_are_those_of_another_pass(samples: int, name: str, share: float) -> None:
    record, rig = record_with(samples)
    theta = parameters.vector(rig)
    record = record.decided_by(pass_one(record, physics_of(theta)).filtered)
    before = pass_one(record, physics_of(theta))
    other, near, place = theta.copy(), theta.copy(), parameters.index(name)
    other[place] *= 1.0 + share
    near[place] *= 1.0 + 1e-5
    after = pass_one(record, physics_of(other))
    answer = response_run(physics_of(near), physics_of(theta), record.series, before.filtered, share / 1e-5)
    both, change = before.counts & after.counts, after.filtered.residual - before.filtered.residual
    for channel in (JAW, LOAD_CELL):
        its, there = answer[both[:, channel], channel], change[both[:, channel], channel]
        assert float(there @ its) == pytest.approx(float(its @ its), rel=0.2)


def test_friction_that_is_no_state_is_the_plant_s_own_wherever_a_mass_may_stick() -> None:
    """Less than the load leaves open: that rows may hold a mass changes nothing of them."""
    record, rig = record_with(1)
    levels = np.zeros_like(record.series.friction_level_N_m)
    may = replace(record, series=record.series._replace(friction_level_N_m=levels))
    never = np.zeros_like(record.series.friction_free_m)
    slides = replace(may, series=may.series._replace(friction_free_m=never, friction_free_j=never))
    assert record.series.friction_free_m.sum() > 200
    plant = physics_of(parameters.vector(rig))
    assert np.array_equal(pass_one(may, plant).filtered.course, pass_one(slides, plant).filtered.course)


def test_little_friction_is_what_it_is_where_a_loop_hunts_in_holds() -> None:
    """It stops the motor within a row, again and again: the mean of what may hold it would turn it round."""
    rig = RIG.with_changes({"drive.cascade_time_s": 0.02, "encoder.counts_per_rev": 65536})
    runs = [generate(rig, SCENARIOS["hold"], seed, WHITE, f"{seed}") for seed in range(100, 108)]
    theta = parameters.vector(rig)
    records, _ = records_of([EvenRun.whole(run) for run in runs], [], rig, NOISE, map, theta)
    assert min(record.series.friction_free_m.mean() for record in records) > 0.5
    assert all((record.series.friction_level_N_m == 0.0).all() for record in records)
    free = [f for f in known_of(rig, records) if f.name == "forceps.motor_coulomb_N_m"]
    found = gram(pass_all(records, theta, map), directions_of(free, theta), map)
    assert abs(found.score[0]) < 2.0 * np.sqrt(found.information[0, 0])  # 2.2 with the mean


def test_friction_at_its_least_is_as_uncertain_as_a_little_of_it() -> None:
    record, rig = record_with(1)
    (free,) = (each for each in known_of(rig, (record,)) if each.name == "forceps.motor_coulomb_N_m")
    information = []
    for value in (free.least, 0.1 * free.scale):
        theta = parameters.vector(rig)
        theta[free.place] = value
        run = pass_all([record.with_friction_of(physics_of(theta))], theta, map)
        information.append(gram(run, directions_of([free], theta), map).information[0, 0])
    assert 0.1 < information[0] / information[1] < 10.0
