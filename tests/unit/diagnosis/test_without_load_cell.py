"""Without a load cell, what acts on the jaw is a load, as any: nothing at the jaw is named, and no curve acts there."""

import math

import pytest

from hil_forceps.data.even_rows import EvenRun
from hil_forceps.data.run import Run
from hil_forceps.diagnosis.identification import identify
from hil_forceps.diagnosis.lack_of_fit.omnibus_test import curves_for
from hil_forceps.diagnosis.options import Options
from hil_forceps.diagnosis.starting_parameters import starting_parameters
from hil_forceps.diagnosis.validation.verdict import judge
from hil_forceps.drift.session_fit import WITHOUT_LOAD_CELL, fit_session
from hil_forceps.model import parameters
from hil_forceps.rig.catalogue import effect
from tests.hidden_effects.generator import RIG
from tests.unit.diagnosis.simulated_runs import POOL, STICKING, runs_of


def without_cell(run: Run) -> EvenRun:
    return EvenRun.whole(Run(run.name, {key: values for key, values in run.columns.items() if key != "tau_w_N_m"}))


# Before the stretch told how a load changes, these were `unnamed`: hundreds of χ² where 16 are chance.
@pytest.mark.parametrize(
    ("kinds", "stiffer"),
    [
        (("grasp", "trapezoid"), 1.0),
        pytest.param(("short_hold", "multisine"), 1.0, marks=pytest.mark.long),
        (("multisine", "hold"), 1.15),
    ],
)
def test_a_load_that_nothing_measures_is_no_effect(kinds: tuple[str, ...], stiffer: float) -> None:
    k = stiffer * RIG.plant().wire_stiffness_N_per_m
    true = RIG.with_changes({"forceps.wire_stiffness_N_per_m": k})
    found = identify([without_cell(run) for run in runs_of(true, kinds, 7650)], [], RIG, Options(mapper=POOL.map))
    verdict = judge(found, RIG)
    assert verdict.verdict in {"consistent", "parameters"}
    if stiffer != 1.0:
        fitted = verdict.shifts["forceps.wire_stiffness_N_per_m"].fitted
        assert fitted.low < k < fitted.high


def test_entries_and_curves_at_the_jaw_are_left_out() -> None:
    run = runs_of(RIG, ("short_hold",), 7600)[0]
    for even, there in ((without_cell(run), False), (EvenRun.whole(run), True)):
        found = identify([even], [], RIG, Options(mapper=POOL.map)).found
        looked_at = {effect(place.effect_id).location for place in found.steps[0].places}
        assert ("jaw" in looked_at) is there
        assert any(curve.place == "jaw" for curve in curves_for(found.best.fit.passes.runs)) is there


def test_the_jaws_friction_is_in_the_load() -> None:
    """Fitted, it came out as none beside a rig with a tenth of the load, and was called a shift."""
    rig = STICKING.with_changes({"encoder.counts_per_rev": 16384})
    runs = [without_cell(run) for run in runs_of(rig, ("multisine", "slow", "trapezoid"), 7700)]
    found = identify(runs, [], rig, Options(mapper=POOL.map))
    assert "forceps.jaw_coulomb_N_m" not in {free.name for free in found.found.best.fit.free}
    verdict = judge(found, rig)
    assert verdict.verdict in {"consistent", "parameters"}
    assert set(verdict.shifts) <= {"forceps.motor_inertia_kg_m2"}  # 5 % low: inertias are too sure without a load cell


def test_beside_a_load_cell_it_is_the_rigs() -> None:
    (run,) = runs_of(STICKING, ("short_hold",), 7600)
    place = parameters.index("forceps.jaw_coulomb_N_m")
    assert starting_parameters([EvenRun.whole(run)], STICKING)[place] == parameters.vector(STICKING)[place] > 0.0
    assert starting_parameters([without_cell(run)], STICKING)[place] == 0.0


def test_a_session_of_a_trend_says_why_it_does_not_measure_it() -> None:
    measured = fit_session(
        [without_cell(run).run for run in runs_of(STICKING, ("multisine",), 7600)], STICKING
    ).parameters
    (untold,) = (p for p in measured if p.name == "forceps.jaw_coulomb_N_m")
    assert untold.reason == WITHOUT_LOAD_CELL
    assert math.isnan(untold.value)
