"""Diagnosis where the drive's law isn't known: the measured motion drives the simulation."""

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from hil_forceps.data.readers.read_run import read_run
from hil_forceps.data.run import Run
from hil_forceps.diagnosis.conclude import Conclusion, diagnose, silent
from hil_forceps.diagnosis.driven import identification
from hil_forceps.diagnosis.driven import rows as driven_rows_of
from hil_forceps.diagnosis.driven.identification import identify_driven, known_of
from hil_forceps.diagnosis.driven.passed import driven_runs
from hil_forceps.diagnosis.driven.rows import driven_rows
from hil_forceps.diagnosis.driven.starting_values import completed, guess
from hil_forceps.diagnosis.driven.whitening import ORDER, rows_before, whitening
from hil_forceps.diagnosis.inference.fit import fit
from hil_forceps.diagnosis.inference.parameters import GAUGE
from hil_forceps.diagnosis.options import Options
from hil_forceps.diagnosis.validation.verdict import judge
from hil_forceps.model import parameters
from hil_forceps.rig import Rig, load_rig
from hil_forceps.rig.errors import UserError
from tests.hidden_effects.cases import SCENARIO_SETS
from tests.hidden_effects.generator import COLOURED, WHITE, Case, NoiseKind, make_case
from tests.unit.diagnosis.simulated_runs import POOL

REPOSITORY = Path(__file__).parents[4]
DATA = Path(os.environ.get("HIL_FORCEPS_DATA", REPOSITORY.parent / "shared" / "data"))
SCENARIOS = (("multisine", "trapezoid"), ("teleoperation",))
UNKNOWN = {
    "forceps.motor_pulley_radius_m": {"min": 1e-3, "max": 4e-3},
    "forceps.wire_stiffness_N_per_m": {"min": 1e3, "max": 1e6},
    "motor.torque_constant_N_m_per_A": {"min": 1e-3, "max": 1e-1},
}


def hidden(effects: Mapping[str, Mapping[str, float]], seed: int = 1) -> Case:
    return make_case(effects, seed, scenarios=SCENARIOS)


def without_drive(case: Case) -> Rig:
    return case.assumed.model_copy(update={"drive": None})


def concluded(case: Case) -> Conclusion:
    return diagnose(case.runs, without_drive(case), Options(hold_out=tuple(run.name for run in case.held_out)))


@pytest.mark.parametrize(
    ("effect_id", "values"),
    [
        ("wire_hardening", {"beta_per_m2": 3e8}),
        pytest.param("wire_hysteresis", {"force_N": 0.3, "stretch_m": 5e-6}, marks=pytest.mark.long),
        ("load_dependent_friction", {"mu": 0.1}),
    ],
)
def test_a_hidden_effect_is_the_first_that_is_named(
    effect_id: str, values: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(identification, "MOST_EFFECTS", 1)  # what the search then finds is not asked
    found = concluded(hidden({effect_id: values})).diagnosis
    assert next(c.id for c in found.candidates if c.state == "named") == effect_id
    first, second = found.ladder[0].rmse, found.ladder[1].rmse
    assert found.ladder[0].id == ""
    assert min(second[name] / first[name] for name in first) < 0.7


def test_nothing_hidden_leaves_little_unexplained() -> None:
    case = hidden({})
    found = concluded(case).diagnosis
    assert set(found.noise_sd) == {"current_A", "theta_j_rad"}
    # The sensors' white noise, as far as it passes the low pass: its share of the band is twice the corner.
    white = case.assumed.noise.current_A * np.sqrt(2.0 * driven_rows_of.PASS_SHARE)
    for rung in found.ladder:
        assert rung.rmse["current_A"] < 1.3 * white


@pytest.mark.parametrize("noise", [WHITE, COLOURED])
def test_nothing_hidden_is_named_and_the_jaw_keeps_its_inertia(noise: NoiseKind) -> None:
    """Noise of what drives is in the residual: with sensitivities that it drives, too, inertia came out at a fifth."""
    case = make_case({}, 1, scenarios=SCENARIO_SETS["work"], noise=noise)
    found = identify_driven(case.fit, case.held_out, without_drive(case), Options(mapper=POOL.map)).found
    assert judge(found, without_drive(case)).verdict == "consistent"
    fitted = found.found.baseline.passes.theta[parameters.index("forceps.jaw_inertia_kg_m2")]
    assert fitted == pytest.approx(case.true.plant().jaw_inertia_kg_m2, rel=0.25)


def test_starting_values_come_from_the_balances() -> None:
    case = hidden({})
    records, notes = driven_rows(case.fit)
    assert all("one row in 6 is used" in note.text for note in notes)
    plant = case.true.plant()
    found = guess(records)
    assert found.ratio == pytest.approx(plant.motor_pulley_radius_m / plant.jaw_pulley_radius_m, rel=0.01)
    rig = completed(records, without_drive(case).with_changes(UNKNOWN)).plant()
    assert rig.motor_pulley_radius_m == pytest.approx(plant.motor_pulley_radius_m, rel=0.01)
    assert rig.wire_stiffness_N_per_m == pytest.approx(plant.wire_stiffness_N_per_m, rel=0.1)
    assert rig.torque_constant_N_m_per_A == pytest.approx(plant.torque_constant_N_m_per_A, rel=0.05)


def test_what_is_unknown_is_fitted_and_no_channel_holds_a_length() -> None:
    case = hidden({})
    records, _ = driven_rows(case.fit)
    rig = completed(records, without_drive(case).with_changes(UNKNOWN))
    runs = driven_runs(records)
    free = known_of(rig, runs)
    names = {f.name for f in free}
    assert set(UNKNOWN) - names == set(GAUGE)
    fitted = fit(runs, parameters.vector(rig), free, POOL.map)
    stiffness = fitted.passes.theta[parameters.index("forceps.wire_stiffness_N_per_m")]
    assert stiffness == pytest.approx(case.true.plant().wire_stiffness_N_per_m, rel=0.1)


def test_what_nothing_bounds_is_refused() -> None:
    case = hidden({})
    records, _ = driven_rows(case.fit)
    with pytest.raises(UserError, match="neither a value nor bounds"):
        completed(records, without_drive(case).with_changes({"forceps.wire_stiffness_N_per_m": "unknown"}))


def test_the_load_may_be_missing_where_the_jaw_is_seen() -> None:
    case = make_case({}, 1, scenarios=SCENARIOS, drop=("tau_w_N_m", "theta_m_ref_rad"))
    records, _ = driven_rows(case.fit)
    assert all(list(r.rows.channels) == ["current_A"] and r.theta_j_rad is not None for r in records)
    assert not silent(case.runs, case.assumed)


def test_rows_at_rest_near_jumps_and_in_gaps_do_not_count() -> None:
    time_s = np.arange(4000) * 1e-3
    angle = np.where(time_s < 2.0, np.sin(np.pi * time_s), 0.0)
    load = np.where(time_s < 1.2, 0.0, 1e-3)
    kept = (time_s < 0.6) | (time_s > 0.7)
    columns = {"time_s": time_s, "theta_m_rad": angle, "current_A": 0.01 * np.ones(4000), "tau_w_N_m": load}
    (record,), _ = driven_rows([Run("a", {name: v[kept] for name, v in columns.items()})])
    counted = record.rows.time_s[record.rows.weights > 0.0]
    assert counted.size > 150
    assert not np.any((counted > 0.6) & (counted < 0.7))
    assert not np.any((counted > 1.17) & (counted < 1.23))
    assert not np.any(counted > 2.1)


def test_many_long_runs_are_thinned_out_to_the_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driven_rows_of, "MOST_ROWS", 2000)
    records, notes = driven_rows(hidden({}).fit)
    assert sum(record.rows.time_s.size for record in records) < 2100
    assert len(notes) == len(records)


def test_whitening_makes_an_autoregression_white_from_the_first_row_behind_a_gap_on() -> None:
    rng = np.random.default_rng(1)
    n = 20_000
    noise, values = rng.standard_normal(n), np.zeros(n)
    for k in range(2, n):
        values[k] = 1.5 * values[k - 1] - 0.7 * values[k - 2] + 0.3 * noise[k]
    mask = np.ones(n, dtype=np.bool_)
    mask[:50] = False
    mask[rng.integers(100, n, 400)] = False
    hidden_values = np.where(mask, values, 1e3)  # what doesn't count has no say
    found = whitening([hidden_values], [mask]).of(hidden_values[:, np.newaxis], mask)[:, 0]
    assert not found[~mask].any()
    before = rows_before(mask)
    for first, last in ((0, 0), (1, 1), (2, ORDER - 1), (ORDER, ORDER)):
        here = found[mask & (before >= first) & (before <= last)]
        assert here.size > 100
        assert float(np.mean(here**2)) == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / here.size))
    whole = found[mask & (before == ORDER)]
    assert abs(float(np.mean(whole[1:] * whole[:-1]))) < 0.03


def needed(path: Path) -> Path:
    if not path.exists():
        pytest.skip(f"{path} is not there; see docs/real-data.md for where to get it")
    return path


@pytest.mark.shared_data
def test_emps_has_the_published_parameters() -> None:
    runs = read_run(needed(DATA / "emps" / "DATA_EMPS.mat"))
    records, _ = driven_rows(runs)
    rig = completed(records, load_rig(REPOSITORY / "configs" / "emps.yaml"))
    # As published: least squares, every frequency alike, which is what runs have before a model was fitted.
    made = driven_runs(records)
    free = known_of(rig, made)
    found = fit(made, parameters.vector(rig), free, POOL.map)
    made = [run.adapted(found.passes.theta, run.white) for run in made]  # what the noise of the motion does
    found = fit(made, found.passes.theta, free, POOL.map)
    values = {f.name: v for f, v in zip(found.free, found.values, strict=True)}
    per_metre = 5e-3**2
    assert values["forceps.motor_inertia_kg_m2"] / per_metre == pytest.approx(95.1089, rel=0.02)
    assert values["forceps.motor_viscous_N_m_s_per_rad"] / per_metre == pytest.approx(203.5, rel=0.02)
    assert values["forceps.motor_coulomb_N_m"] / 5e-3 == pytest.approx(20.394, rel=0.03)
    passed = found.passes.runs[0]
    assert passed.zeros["tau_m_N_m"] / 5e-3 == pytest.approx(-3.165, rel=0.05)
    here = records[0].rows.weights > 0.0
    measured = records[0].rows.channels["tau_m_N_m"][here]
    left = passed.raw["tau_m_N_m"][here] - passed.zeros["tau_m_N_m"]
    assert np.linalg.norm(left) / np.linalg.norm(measured) < 0.0408


@pytest.mark.shared_data
def test_the_surgical_tool_starts_from_its_own_balances() -> None:
    path = needed(DATA / "surgical_tool" / "Tool_4_Maryland_L_4.zip")
    runs = [run for run in read_run(path) if run.name in ("02", "25", "48")]
    records, _ = driven_rows(runs)
    found = guess(records)
    assert 0.5 < found.ratio < 2.0
    assert found.give_rad_per_N_m > 0.0
    assert found.coulomb > 0.01
