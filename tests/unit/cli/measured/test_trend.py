"""`hil-forceps trend` and `diagnose --batch` on the command line: tables, files, one clear line for what is wrong."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hil_forceps.api import diagnosis
from hil_forceps.api.batch import diagnoses
from hil_forceps.cli.main import main
from hil_forceps.data.readers.csv_table import write_csv
from hil_forceps.data.run import Run
from hil_forceps.drift.change_test import Change
from hil_forceps.drift.family import Estimated, instrument_trend
from hil_forceps.drift.result import InstrumentTrend, SessionLine, Trend, When
from hil_forceps.report.trend.files import write_figures, write_report
from hil_forceps.rig.loading import dump_rig
from tests.hidden_effects.generator import generate
from tests.hidden_effects.generator_scenarios import Scenario
from tests.trend.simulated_sessions import ASSUMED, FRICTION, STIFFNESS, file_name, write_sessions


def call(*words: str | Path) -> int:
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    assert isinstance(ended.value.code, int)
    return ended.value.code


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("logs")
    write_sessions(folder, 2, 1.0, onset=9, rise_a_session=0.0)
    (folder / "2026-02-01_broken.csv").write_text("time_s,theta_m_rad\n0,0\n")
    return folder


def test_a_trend_leaves_its_files_and_a_table(logs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("trend", logs, "--out", tmp_path, "--jobs", "1", "--figures", "--quiet") == 0
    said = capsys.readouterr()
    assert said.err == ""
    assert FRICTION in said.out
    assert "not used: 2026-02-01_broken: " in said.out
    assert "2 of 3 sessions used" in said.out
    written = {path.name for path in tmp_path.iterdir()}
    assert written == {"estimates.parquet", "sessions", "trend.json", "trend.html", "figures"}
    assert [path.suffix for path in sorted((tmp_path / "figures").iterdir())] == [".pdf", ".png"]

    assert call("trend", logs, "--out", tmp_path, "--jobs", "1", "--json") == 0
    again = capsys.readouterr()
    assert json.loads(again.out) == json.loads((tmp_path / "trend.json").read_text())
    assert "3 of 3 sessions are done already" in again.err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--jobs", "0"), "--jobs 0: must be 1 or more"),
        (("--false-alarms", "2"), "--false-alarms 2.0: must be above 0 and below 1"),
        (("--executor", "pbs"), "--executor pbs: is unknown"),
        (("--rig", "nowhere.yaml"), "nowhere.yaml"),
    ],
)
def test_a_wrong_wish_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], said: str
) -> None:
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "a.csv").write_text("x")
    assert call("trend", tmp_path / "logs", "--out", tmp_path / "out", *words) == 2
    error = capsys.readouterr().err.splitlines()
    assert len(error) == 1
    assert said in error[0]


def test_each_log_and_each_folder_is_diagnosed_by_itself(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    home, out = tmp_path / "logs", tmp_path / "out"
    (home / "two").mkdir(parents=True)
    (home / "rig.yaml").write_text(dump_rig(ASSUMED))
    still = generate(ASSUMED, Scenario("rest", 1.0), 1)  # tells nothing, so that each diagnosis ends at once
    for name in ("one", "two/a", "two/b"):
        write_csv(still, home / f"{name}.csv")
    (home / "broken.csv").write_text("time_s,theta_m_rad\n0,0\n")
    made: list[str] = []
    conclude = diagnosis.conclude

    def counted(runs: list[Run], *rest: Any) -> Any:
        made.append("+".join(run.name for run in runs))
        return conclude(runs, *rest)

    monkeypatch.setattr(diagnoses, "conclude", counted)
    words = ("diagnose", home, "--batch", "--out", out, "--jobs", "1")
    assert call(*words) == 0
    said = capsys.readouterr().out
    lines = {line["name"]: line for line in json.loads((out / "verdicts.json").read_text())}
    assert lines["broken.csv"]["verdict"] == ""
    assert "current_A" in lines["broken.csv"]["sentence"]
    assert lines["two"]["verdict"] == "undetermined"
    assert lines["one.csv"]["verdict"] == "undetermined"
    assert "3 diagnoses: " in said
    assert {path.name for path in (out / "two").iterdir()} == {
        "verdict.json",
        "diagnosis.json",
        "report.html",
        "extended.yaml",
    }
    assert len(made) == 2

    (home / "two" / "b.csv").unlink()
    assert call(*words) == 0
    assert made[2:] == ["a"]


def test_logs_are_never_written_over_nor_removed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    home = tmp_path / "data" / "sessions"
    (home / "day").mkdir(parents=True)
    (home / "rig.yaml").write_text(dump_rig(ASSUMED))
    log = home / "day" / "a.csv"
    write_csv(generate(ASSUMED, Scenario("rest", 1.0), 1), log)
    before = {path: path.read_bytes() for path in home.rglob("*") if path.is_file()}
    refused = (
        ("diagnose", home, "--batch", "--out", home),
        ("diagnose", home, "--batch", "--out", home / "day" / ".."),
        ("trend", home, "--out", home.parent),
    )
    for words in refused:
        assert call(*words, "--jobs", "1") == 2
        assert "is within the folder of the logs" in capsys.readouterr().err
        assert {path: path.read_bytes() for path in home.rglob("*") if path.is_file()} == before


def test_what_else_lies_among_the_results_stays(logs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own = tmp_path / "sessions" / "mine.parquet"
    own.parent.mkdir()
    pq.write_table(pa.table({"time_s": [0.0]}), own)
    assert call("trend", logs, "--out", tmp_path, "--jobs", "1", "--quiet") == 0
    assert own.is_file()

    home, out = tmp_path / "logs", tmp_path / "out"
    home.mkdir()
    (home / "rig.yaml").write_text(dump_rig(ASSUMED))
    (out / "a.csv").mkdir(parents=True)
    (out / "a.csv" / "notes.txt").write_text("mine")
    for seed in (1, 2):
        write_csv(generate(ASSUMED, Scenario("rest", 1.0), seed), home / "a.csv")
        assert call("diagnose", home, "--batch", "--out", out, "--jobs", "1") == 0
    assert (out / "a.csv" / "notes.txt").read_text() == "mine"
    assert (out / "a.csv" / "report.html").is_file()
    capsys.readouterr()


def test_batch_takes_one_folder_and_without_it_a_rig_is_needed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("diagnose", tmp_path, tmp_path, "--batch", "--out", tmp_path / "out") == 2
    assert "--batch: takes one folder" in capsys.readouterr().err
    assert call("diagnose", tmp_path, "--batch", "--node", "3", "--out", tmp_path / "out") == 2
    assert "--node: not possible with --batch" in capsys.readouterr().err
    assert call("diagnose", tmp_path, "--executor", "ray", "--out", tmp_path / "out") == 2
    assert "--executor: only with --batch" in capsys.readouterr().err
    assert call("diagnose", tmp_path, "--out", tmp_path / "out") == 2
    assert "--rig: missing" in capsys.readouterr().err


def drawn_trend() -> Trend:
    rng = np.random.default_rng(1)
    sessions = tuple(When(file_name(k), f"{file_name(k)[:10]}T09:30:00Z") for k in range(40))
    wear = 1.0 + 0.01 * np.clip(np.arange(40) - 20, 0, None)
    parameters = [
        Estimated(
            FRICTION, "N_m", 1e-4, sessions, tuple(1e-4 * wear * (1 + 0.02 * rng.standard_normal(40))), (5e-7,) * 40
        ),
        Estimated(
            STIFFNESS, "N_per_m", 2.6e4, sessions, tuple(2.6e4 * (1 + 3e-3 * rng.standard_normal(40))), (10.0,) * 40
        ),
    ]
    lines = [SessionLine(s.session, "<left>", s.date, "name", None) for s in sessions]
    lines.append(SessionLine("odd", "<left>", None, "", "<b>no</b>"))
    steady = InstrumentTrend("empty", ())
    return Trend((instrument_trend("<left>", parameters, 0.05, 0), steady), tuple(lines), 0.05)


def test_the_page_tells_all_and_escapes_what_it_is_told(tmp_path: Path) -> None:
    trend = drawn_trend()
    assert [bool(p.changes) for p in trend.instruments[0].parameters] == [True, False]
    assert isinstance(trend.instruments[0].parameters[0].changes[0].kind, str)
    assert Change("slope", 1).onset == 1
    write_report(trend, tmp_path / "a.html")
    write_report(trend, tmp_path / "b.html")
    page = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert page == (tmp_path / "b.html").read_text(encoding="utf-8")
    assert "<left>" not in page
    assert "<b>no</b>" not in page
    assert "dry friction of the motor rises" in page
    assert "at most 5 %" in page
    assert "http" not in page.replace("http-equiv", "")
    assert len(write_figures(trend, tmp_path / "figures")) == 2
