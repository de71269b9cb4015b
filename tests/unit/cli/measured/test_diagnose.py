"""`hil-forceps diagnose` on bad input: one clear line and exit code 2, or an honest verdict, never a made-up cause."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.cli.main import main
from hil_forceps.data.readers.csv_table import write_csv
from hil_forceps.data.run import Run
from hil_forceps.rig.loading import dump_rig
from tests.hidden_effects.generator import RIG, generate
from tests.hidden_effects.generator_scenarios import Scenario

Columns = dict[str, NDArray[np.float64]]
SHORT = (Scenario("multisine", 3.0), Scenario("trapezoid", 3.0))
CSV = "time_s,theta_m_ref_rad,theta_m_rad,current_A,theta_j_rad,tau_w_N_m"


@pytest.fixture(scope="module")
def good() -> list[Run]:
    return [generate(RIG, scenario, 5, name=f"run{k}") for k, scenario in enumerate(SHORT)]


@pytest.fixture
def call(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, dict[str, Any]]]:
    """Write runs and the rig, diagnose them, and return the exit code, what was said, and diagnosis.json."""
    rig = tmp_path / "rig.yaml"
    rig.write_text(dump_rig(RIG))

    def run(*runs: Run | str, more: tuple[str, ...] = ()) -> tuple[int, str, dict[str, Any]]:
        paths = []
        for number, item in enumerate(runs):
            path = tmp_path / f"run{number}.csv"
            if isinstance(item, Run):
                write_csv(item, path)
            else:
                path.write_text(item)
            paths.append(str(path))
        with pytest.raises(SystemExit) as ended:
            main(["diagnose", *paths, "--rig", str(rig), "--out", str(tmp_path / "out"), "--jobs", "1", *more])
        result = tmp_path / "out" / "diagnosis.json"
        told = capsys.readouterr()
        code = ended.value.code
        assert isinstance(code, int)
        return code, told.err if code else told.out, json.loads(result.read_text()) if result.exists() else {}

    return run


def changed(run: Run, change: Callable[[Columns], None]) -> Run:
    columns = {name: values.copy() for name, values in run.columns.items()}
    change(columns)
    return Run(run.name, columns)


def text(rows: list[str], header: str = CSV) -> str:
    return "\n".join([header, *rows]) + "\n"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (text(["0,0,0,0,0,0", "0.001,0,0,0,0,0"], CSV.replace("theta_m_rad", "")), "column"),
        (text(["0,0,0,0,0,0"] * 2, CSV.replace("theta_m_rad", "theta_m_rad [deg]")), "theta_m_rad [deg]"),
        (text(["0,0,0,0", "0.001,0,0,0"], "time_s,theta_m_ref_rad,theta_j_rad,tau_w_N_m"), "theta_m_rad is missing"),
        (text(["0,0,0,0,0,0", "0.001,0,broken,0,0,0", "0.002,0,0,0,0,0"]), ":3"),
        (text(["0,0,0,0,0,0", "0.001,0,0,0,0,0", "0.001,0,1,0,0,0"]), ":4"),
        (text(["0,0,0,0,0,0"]), "2"),
        ("", "is empty"),
    ],
    ids=["unnamed column", "two units", "missing column", "no number", "repeated stamp", "one sample", "empty"],
)
def test_a_file_that_is_no_run_is_refused_in_one_line(call: Any, content: str, said: str) -> None:
    code, error, result = call(content)
    assert code == 2
    assert said in error
    assert all("run0.csv" in line for line in error.splitlines())  # one line for each thing to correct
    assert len(error.splitlines()) <= 2
    assert result == {}


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("--hold-out", "nobody"), "--hold-out nobody"),
        (("--hold-out", "run0", "run1"), "every run is held out"),
        (("--without", "gremlins"), "--without gremlins"),
    ],
)
def test_a_wrong_wish_is_refused_in_one_line(call: Any, good: list[Run], more: tuple[str, ...], said: str) -> None:
    code, error, _ = call(*good, more=more)
    assert code == 2
    assert len(error.splitlines()) == 1
    assert said in error


def test_too_few_rows_are_refused(call: Any, good: list[Run]) -> None:
    code, error, _ = call(Run("run0", {name: values[:40] for name, values in good[0].columns.items()}))
    assert code == 2
    assert "too few" in error


def frozen(columns: Columns) -> None:
    columns["theta_m_rad"][:] = columns["theta_m_rad"][0]


def without_jaw_and_load(columns: Columns) -> None:
    del columns["theta_j_rad"], columns["tau_w_N_m"]


@pytest.mark.parametrize("change", [frozen, without_jaw_and_load], ids=lambda change: change.__name__)
def test_runs_that_show_nothing_are_undetermined_with_a_reason(call: Any, good: list[Run], change: Any) -> None:
    code, said, result = call(*(changed(run, change) for run in good))
    assert code == 0
    assert result["verdict"] == "undetermined"
    assert result["effects"] == []
    assert result["reasons"]
    assert said.startswith("undetermined")


def in_degrees(columns: Columns) -> None:
    for name in ("theta_m_ref_rad", "theta_m_rad", "theta_j_rad"):
        columns[name] *= 180.0 / np.pi


def in_milliamperes(columns: Columns) -> None:
    columns["current_A"] *= 1e3


def constant_current(columns: Columns) -> None:
    columns["current_A"][:] = 0.1


def clipped_current(columns: Columns) -> None:
    columns["current_A"][:] = np.clip(columns["current_A"], -0.05, 0.05)


def of_another_rig(columns: Columns) -> None:
    columns["theta_j_rad"] *= -3.0
    columns["current_A"] *= -0.2


@pytest.mark.parametrize(
    "change",
    [in_degrees, in_milliamperes, constant_current, of_another_rig],
    ids=lambda change: change.__name__,
)
def test_data_that_cannot_be_right_are_undetermined(call: Any, good: list[Run], change: Any) -> None:
    code, _, result = call(*(changed(run, change) for run in good))
    assert code == 0
    assert result["verdict"] == "undetermined"
    assert result["effects"] == []
    problems = [finding["text"] for finding in result["data_audit"] if finding["severity"] == "problem"]
    assert problems
    assert set(result["reasons"]) == set(problems)


@pytest.mark.long
def test_a_clipped_current_gets_no_other_name(call: Any, good: list[Run]) -> None:
    code, _, result = call(*(changed(run, clipped_current) for run in good))
    assert code == 0
    assert {effect["id"] for effect in result["effects"]} <= {"current_saturation"}


@pytest.mark.long
@pytest.mark.slow
def test_gaps_are_told_and_do_not_become_a_cause(call: Any, good: list[Run]) -> None:
    kept = np.r_[0:900, 1000:2000, 2010:3000]
    gappy = [Run(run.name, {name: values[kept] for name, values in run.columns.items()}) for run in good]
    code, _, result = call(*gappy)
    assert code == 0
    assert result["effects"] == []
    assert any("gap" in finding["text"] or finding["kind"] == "gap" for finding in result["data_audit"])


@pytest.mark.slow
def test_a_good_run_is_diagnosed_and_writes_its_files(call: Any, good: list[Run], tmp_path: Path) -> None:
    code, said, result = call(*good)
    assert code == 0
    assert result["verdict"] in {"consistent", "parameters", "effects", "unnamed"}
    assert said.startswith(result["verdict"])
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written >= {"diagnosis.json", "report.html", "extended.yaml"}
