"""`diagnose` and what it returns: the command line's words, a table without markup from data, numbers by names."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil_forceps as hf
from hil_forceps.api.diagnosis import DiagnosisResult, FittedParameter
from hil_forceps.cli.main import main
from hil_forceps.data.readers.csv_table import write_csv
from hil_forceps.diagnosis.result import (
    Diagnosis,
    Estimate,
    Gain,
    NamedEffect,
    NextExperiment,
    Shift,
    Verdict,
    to_json,
)
from hil_forceps.report.diagnosis.words import VERDICTS
from hil_forceps.rig.loading import dump_rig
from tests.hidden_effects.generator import RIG, generate
from tests.hidden_effects.generator_scenarios import Scenario
from tests.unit.report.diagnosis.cases import wire_slack
from tests.unit.security.test_pages import HOSTILE

DIFFERENCE = "difference_N_m_s_per_rad"
FROZEN = "the motor does not move in any run"


def result_of(diagnosis: Diagnosis) -> DiagnosisResult:
    return DiagnosisResult(diagnosis, RIG, None)


def found() -> Diagnosis:
    estimate = Estimate(4e-5, 3.9e-5, 4.1e-5, "N_m_s_per_rad")
    return Diagnosis(
        "effects",
        "The data show it.",
        effects=(NamedEffect("viscous_asymmetry", "motor", 0.97, {DIFFERENCE: estimate}),),
        candidate_sets=(("viscous_asymmetry",), ("coulomb_asymmetry",)),
        parameter_shifts={"motor.torque_constant_N_m_per_A": Shift(0.0135, Estimate(0.014, 0.013, 0.015, "N_m_per_A"))},
        gain={"current_A": Gain(3e-3, 1e-3, 9e-4, 0.98, 0.9, 1.0)},
        reasons=("one and the other can't be told apart",),
        next_experiment=NextExperiment("slow", (("a",), ("b",)), 4.2, "It excites both."),
    )


def test_it_reads_as_the_command_line_does() -> None:
    assert str(result_of(found())).splitlines() == [
        "effects: The data show it.",
        f"  viscous_asymmetry (motor), confidence 0.97: {DIFFERENCE} = 4e-05 N_m_s_per_rad [3.9e-05, 4.1e-05]",
        "  equally good: coulomb_asymmetry",
        "  motor.torque_constant_N_m_per_A: 0.0135 -> 0.014 [0.013, 0.015] N_m_per_A",
        "  held out, current_A: RMSE 0.003 -> 0.001 (noise 0.0009), explained 98 % [90, 100]",
        "  reason: one and the other can't be told apart",
        "  next: slow (separation 4.2 sd); It excites both.",
    ]


def test_its_parts_by_their_names(tmp_path: Path) -> None:
    result = result_of(wire_slack())
    assert result.verdict == result.diagnosis.verdict
    assert [cause.id for cause in result.causes] == [effect.id for effect in result.diagnosis.effects]
    assert result.gain is result.diagnosis.gain
    assert result.to_json() == to_json(result.diagnosis)
    assert repr(result).startswith(f"<DiagnosisResult {result.verdict}: wire_slack")
    assert result_of(found()).parameters == (
        FittedParameter(f"effects.viscous_asymmetry.{DIFFERENCE}", 4e-5, 3.9e-5, 4.1e-5, "N_m_s_per_rad", None),
        FittedParameter("motor.torque_constant_N_m_per_A", 0.014, 0.013, 0.015, "N_m_per_A", 0.0135),
    )
    result_of(found()).report(tmp_path / "deep" / "report.html")
    assert "viscous_asymmetry" in (tmp_path / "deep" / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("verdict", list(VERDICTS))
def test_every_verdict_has_a_table_and_a_text(verdict: Verdict) -> None:
    for diagnosis in (Diagnosis(verdict, "Said."), wire_slack()):
        html = result_of(diagnosis)._repr_html_()
        assert diagnosis.verdict in html
        assert "<script" not in html
        assert "style=" not in html


@pytest.mark.parametrize("text", HOSTILE)
def test_nothing_out_of_data_becomes_markup_in_a_notebook(text: str) -> None:
    estimate = Estimate(1.0, 0.0, 2.0, text)
    diagnosis = Diagnosis(
        "effects",
        text,
        effects=(NamedEffect(text, "motor", 1.0, {text: estimate}),),
        parameter_shifts={text: Shift(None, estimate)},
        gain={text: Gain(float("nan"), 1.0, 1.0, float("nan"), 0.0, 1.0)},
        reasons=(text,),
        next_experiment=NextExperiment(text, (), 1.0, text),
    )
    html = result_of(diagnosis)._repr_html_()
    plain = result_of(Diagnosis("effects", "x"))._repr_html_()
    tags = {piece.split(">")[0].split()[0].lstrip("/") for piece in html.split("<")[1:]}
    assert tags <= {"div", "p", "b", "table", "thead", "tbody", "tr", "th", "td", "code", "span", "ul", "li", "sup"}
    assert plain.count("<") == 6


@pytest.fixture(scope="module")
def frozen() -> hf.Run:
    run = generate(RIG, Scenario("multisine", 1.0), 5, name="still")
    return hf.Run("still", {**run.columns, "theta_m_rad": np.zeros(len(run))})


def test_the_command_says_and_writes_what_the_function_returns(
    frozen: hf.Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "rig.yaml").write_text(dump_rig(RIG))
    write_csv(frozen, tmp_path / "still.csv")
    out = tmp_path / "out"
    command = ["diagnose", tmp_path / "still.csv", "--rig", tmp_path / "rig.yaml", "--out", out, "--jobs", 1]
    with pytest.raises(SystemExit) as ended:
        main([*map(str, command)])
    assert ended.value.code == 0
    told: list[str] = []
    result = hf.diagnose(str(tmp_path / "still.csv"), tmp_path / "rig.yaml", jobs=1, progress=told.append)
    said = capsys.readouterr().out
    assert said == f"{result}\n  report.html, diagnosis.json and extended.yaml are in {out}/\n"
    assert json.loads((out / "diagnosis.json").read_text()) == result.to_json()
    assert (out / "extended.yaml").read_text() == dump_rig(result.extended_rig)
    result.report(tmp_path / "report.html")
    assert (tmp_path / "report.html").read_bytes() == (out / "report.html").read_bytes()
    assert FROZEN in str(result)


def test_runs_come_in_any_form(frozen: hf.Run) -> None:
    for runs in (frozen, [frozen], (frozen,), dict(frozen.columns), [dict(frozen.columns), frozen]):
        assert FROZEN in hf.diagnose(runs, RIG, jobs=1).sentence  # type: ignore[arg-type]  # each of them is one


@pytest.mark.parametrize(
    ("wish", "said"),
    [
        ({"without": ["gremlins"]}, "without gremlins: is not an effect of the catalogue"),
        ({"hold_out": ["nobody"]}, "hold_out nobody: no such run; the runs are still"),
        ({"hold_out": ["still"]}, "hold_out: every run is held out"),
        ({"jobs": 0}, "jobs 0: must be 1 or more"),
        ({"seed": -1}, "seed -1: must be 0 or more"),
        ({"budget_s": 0.0}, "budget_s 0.0: must be more than 0 seconds"),
    ],
)
def test_a_wrong_wish_is_refused_by_the_parameters_name(frozen: hf.Run, wish: dict[str, Any], said: str) -> None:
    with pytest.raises(hf.UserError, match=f"^{said}"):
        hf.diagnose(frozen, RIG, **wish)


def test_a_budget_needs_runs_whose_law_is_known(frozen: hf.Run) -> None:
    rig = RIG.with_changes({"drive": None})
    with pytest.raises(hf.UserError, match="budget_s: only for runs of a drive with known law and references"):
        hf.diagnose(frozen, rig, budget_s=1.0, jobs=1)


@pytest.mark.parametrize(
    ("option", "said"),
    [
        (("--hold-out", "nobody"), "--hold-out nobody: no such run; the runs are still"),
        (("--seed", "-1"), "--seed -1: must be 0 or more"),
        (("--budget", "-1"), "--budget -1.0: must be more than 0 seconds"),
    ],
)
def test_the_command_speaks_of_options(
    frozen: hf.Run, tmp_path: Path, capsys: pytest.CaptureFixture[str], option: tuple[str, str], said: str
) -> None:
    (tmp_path / "rig.yaml").write_text(dump_rig(RIG))
    write_csv(frozen, tmp_path / "still.csv")
    command = ["diagnose", tmp_path / "still.csv", "--rig", tmp_path / "rig.yaml", "--out", tmp_path / "out", *option]
    with pytest.raises(SystemExit) as ended:
        main([*map(str, command)])
    assert ended.value.code == 2
    assert capsys.readouterr().err == f"hil-forceps: {said}\n"
