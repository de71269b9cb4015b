"""`track` and `trend`: intervals that hold, drift that is found, results that are kept, and logs that can't be used."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import hil_forceps as hf
from hil_forceps.api.batch import work
from hil_forceps.api.batch.executor import check_executor, spread
from hil_forceps.api.batch.store import file_of
from hil_forceps.data.sessions.session import Session
from hil_forceps.drift.session_fit import WITHOUT_LOAD_CELL, SessionFit, fit_session
from tests.trend.simulated_sessions import ASSUMED, FRICTION, file_name, run_of, shares_of, true_rig, write_sessions

pytestmark = pytest.mark.xdist_group("trend")  # what they look at is made once, for all

ROOT = Path(__file__).parents[3]
SESSIONS, ONSET, RISE = 30, 15, 0.03  # of friction, by session
SECONDS = 3.0


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of sessions whose friction rises from the middle on."""
    folder = tmp_path_factory.mktemp("logs") / "left"
    write_sessions(folder, SESSIONS, SECONDS, onset=ONSET, rise_a_session=RISE, seed=3)
    return folder


@pytest.fixture(scope="module")
def tracked(logs: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[hf.TrendResult, Path]:
    """Return what becomes of them."""
    out = tmp_path_factory.mktemp("tracked")
    return hf.trend(logs, out=out, jobs=1), out


@pytest.mark.slow
def test_the_friction_that_rises_is_found_and_nothing_else(tracked: tuple[hf.TrendResult, Path]) -> None:
    result, _ = tracked
    (instrument,) = result.instruments
    changed = {p.name: p.changes for p in instrument.parameters if p.changes}
    assert set(changed) == {FRICTION}
    first = changed[FRICTION][0]
    assert first.direction == "rises"
    assert first.low.session <= file_name(ONSET) <= first.high.session
    assert sum(change.total for change in changed[FRICTION]) == pytest.approx(
        1e-4 * RISE * (SESSIONS - ONSET), rel=0.25
    )
    (text,) = (text for text in result.changes if first.onset.session in text)
    assert text.startswith("dry friction of the motor rises from")


@pytest.mark.slow
def test_intervals_hold_the_truth_of_each_session(tracked: tuple[hf.TrendResult, Path]) -> None:
    result, _ = tracked
    inside = []
    for row in result.rows:
        number = next(n for n in range(SESSIONS) if file_name(n) == row["session"])
        drift = {FRICTION: 1.0 + RISE * max(0, number - ONSET + 1)}
        rig = true_rig(shares_of(number, drift, 3))
        if row["value"] is not None:
            inside.append(row["low"] <= getattr(rig.plant(), row["parameter"].partition(".")[2]) <= row["high"])
    assert len(inside) > 7 * SESSIONS
    assert 0.92 <= np.mean(inside) <= 0.98


@pytest.mark.slow
def test_results_are_tables_and_pages_that_others_read(tracked: tuple[hf.TrendResult, Path], tmp_path: Path) -> None:
    result, out = tracked
    table = pq.read_table(out / "estimates.parquet")
    assert table.num_rows == len(result.rows) == 8 * SESSIONS
    assert set(table["date_from"].to_pylist()) == {"name"}
    assert pq.read_table(out / "sessions").num_rows == table.num_rows  # as they came
    assert json.loads((out / "trend.json").read_text()) == json.loads(json.dumps(result.to_json()))
    frame = result.to_pandas()
    assert list(frame.columns) == table.schema.names
    result.report(tmp_path / "trend.html")
    page = (tmp_path / "trend.html").read_text(encoding="utf-8")
    assert "<script" not in page
    assert "data:image/svg+xml" in page
    assert page.count("<tr>") >= SESSIONS + 8


@pytest.mark.slow
def test_what_is_done_is_not_done_again_but_what_changed_is(
    logs: Path, tracked: tuple[hf.TrendResult, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, done = tracked
    out, home = tmp_path / "out", tmp_path / "left"
    shutil.copytree(done, out)
    shutil.copytree(logs, home)  # other times, the same bytes
    fitted: list[str] = []

    def counted(runs: list[hf.Run], rig: hf.Rig) -> SessionFit:
        fitted.append(runs[0].name)
        return fit_session(runs, rig)

    monkeypatch.setattr(work, "fit_session", counted)
    again = hf.trend(home, out=out, jobs=1)
    assert fitted == []
    assert again.to_json() == tracked[0].to_json()

    shutil.copy(home / f"{file_name(2)}.parquet", home / f"{file_name(5)}.parquet")
    (home / f"{file_name(9)}.parquet").unlink()
    of_seven = file_of(out, Session(file_name(7), home, "left", home))
    of_seven.write_bytes(of_seven.read_bytes()[:100])  # as a disk may leave it
    changed = hf.trend(home, out=out, jobs=1)
    assert sorted(fitted) == [file_name(5), file_name(7)]
    assert len(changed.sessions) == SESSIONS - 1
    assert len(list((out / "sessions").iterdir())) == SESSIONS - 1

    fitted.clear()
    for number in range(12, SESSIONS):
        (home / f"{file_name(number)}.parquet").unlink()
    (home / "rig.yaml").write_text(
        (home / "rig.yaml").read_text().replace("1.35e-02", "1.36e-02").replace("0.0135", "0.0136")
    )
    hf.trend(home, out=out, jobs=1)
    assert len(fitted) == 11


def few(folder: Path, count: int = 2) -> Path:
    write_sessions(folder, count, 1.0, onset=99, rise_a_session=0.0)
    return folder


def test_logs_that_can_not_be_used_stand_in_the_table_and_stop_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    home = few(tmp_path / "logs")
    (home / "2026-02-01_empty.csv").write_text("")
    (home / "2026-02-02_cut.parquet").write_bytes((home / f"{file_name(0)}.parquet").read_bytes()[:999])
    (home / "2026-02-03_odd.csv").write_text("time_s,theta_m_rad\n0,0\n")
    (home / "undated.parquet").write_bytes((home / f"{file_name(1)}.parquet").read_bytes())

    def failing(runs: list[hf.Run], rig: hf.Rig) -> object:
        if runs[0].name == file_name(1):
            raise FloatingPointError("overflow")
        return fit_session(runs, rig)

    monkeypatch.setattr(work, "fit_session", failing)
    result = hf.trend(home, out=tmp_path / "out", jobs=1)
    reasons = {line.name: line.reason for line in result.sessions}
    assert reasons[file_name(0)] is None
    assert reasons[file_name(1)] == "the fit failed, FloatingPointError: overflow"
    for name, said in (
        ("2026-02-01_empty", "is empty"),
        ("2026-02-02_cut", "Parquet"),
        ("2026-02-03_odd", "current_A"),
        ("undated", "no date is known; name its file by its date"),
    ):
        reason = reasons[name]
        assert reason is not None
        assert said in reason
        assert "\n" not in reason
    dated = hf.trend(home, out=tmp_path / "out", jobs=1, file_dates=True)
    assert {line.name: line.date_from for line in dated.sessions}["undated"] == "file"


def test_an_end_in_between_leaves_sound_results_and_the_rest_to_do(tmp_path: Path) -> None:
    home, out = few(tmp_path / "logs", 4), tmp_path / "out"

    class EndedError(Exception):
        """Ends it."""

    def end_after_two(_: str) -> None:
        if len(list((out / "sessions").glob("*.parquet"))) >= 2:
            raise EndedError

    import hil_forceps.api.batch.sessions as batch  # noqa: PLC0415

    before, batch.TOLD_EVERY_S = batch.TOLD_EVERY_S, 0.0
    try:
        with pytest.raises(EndedError):
            hf.trend(home, out=out, jobs=1, progress=end_after_two)
    finally:
        batch.TOLD_EVERY_S = before
    assert pq.read_table(out / "sessions").num_rows == 16
    ended = {path: path.stat().st_mtime_ns for path in (out / "sessions").iterdir()}
    resumed = hf.trend(home, out=out, jobs=1)
    assert all(path.stat().st_mtime_ns == at for path, at in ended.items())
    assert resumed.to_json() == hf.trend(home, out=tmp_path / "other", jobs=1).to_json()


def test_one_session_is_tracked_by_its_own_data_alone() -> None:
    run, true = run_of(2, {}, 3, 6.0)
    far = ASSUMED.with_changes(
        {"motor.torque_constant_N_m_per_A": 1.42e-2, FRICTION: 1.5e-4, "forceps.motor_inertia_kg_m2": 3.6e-8}
    )
    found = {p.name: p for p in hf.track(run, far).parameters}
    for name, p in found.items():
        if not p.reason:
            assert abs(p.value - getattr(true.plant(), name.partition(".")[2])) < 4.0 * p.sd
    near = {p.name: p for p in hf.track(run, ASSUMED).parameters}
    for name in ("forceps.wire_stiffness_N_per_m", FRICTION, "forceps.motor_inertia_kg_m2"):
        assert abs(found[name].value - near[name].value) < 0.5 * near[name].sd
    without = hf.Run(run.name, {name: v for name, v in run.columns.items() if name != "tau_w_N_m"})
    unmeasured = {p.name: p.reason for p in hf.track(without, ASSUMED).parameters}
    assert unmeasured["forceps.jaw_coulomb_N_m"] == WITHOUT_LOAD_CELL


@pytest.mark.parametrize(
    ("wish", "said"),
    [
        ({"executor": "slurm"}, "executor slurm: is unknown; use processes, dask://HOST:PORT, ray"),
        ({"executor": "dask://"}, "executor dask://: is unknown"),
        ({"jobs": 0}, "jobs 0: must be 1 or more"),
        ({"false_alarms": 0.0}, "false_alarms 0.0: must be above 0 and below 1"),
        ({"seed": -1}, "seed -1: must be 0 or more"),
    ],
)
def test_wrong_wishes_are_refused_in_one_line(tmp_path: Path, wish: dict[str, object], said: str) -> None:
    with pytest.raises(hf.UserError) as refused:
        hf.trend(tmp_path, ASSUMED, out=tmp_path / "out", **wish)  # type: ignore[arg-type]
    assert said in str(refused.value)
    assert len(refused.value.problems) == 1


def test_an_executor_that_is_not_installed_is_named_with_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(hf.UserError, match=r"ray is not installed; pip install 'hil-forceps\[ray\]'"):
        check_executor("ray")


def test_tasks_are_spread_over_processes() -> None:
    assert sorted(spread(abs, [-3, -1, -2], "processes", 2)) == [1, 2, 3]


@pytest.mark.long
def test_a_killed_trend_goes_on_where_it_was(tmp_path: Path) -> None:
    home, out = few(tmp_path / "logs", SESSIONS), tmp_path / "out"
    command = [sys.executable, "-m", "hil_forceps.cli.main", "trend", str(home), "--out", str(out), "--jobs", "2"]
    process = subprocess.Popen(command, cwd=ROOT, start_new_session=True, stderr=subprocess.DEVNULL)
    try:
        while len(list((out / "sessions").glob("[!.]*.parquet"))) < 3:
            assert process.poll() is None
            time.sleep(0.02)
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    there = {path: path.stat().st_mtime_ns for path in (out / "sessions").glob("[!.]*.parquet")}
    assert 3 <= len(there) < SESSIONS
    assert all(pq.read_table(path).num_rows == 8 for path in there)
    resumed = hf.trend(home, out=out, jobs=2)
    assert all(path.stat().st_mtime_ns == at for path, at in there.items())
    assert not list((out / "sessions").glob(".*"))
    assert resumed.to_json() == hf.trend(home, out=tmp_path / "whole", jobs=1).to_json()
    assert (out / "trend.json").read_bytes() == (tmp_path / "whole" / "trend.json").read_bytes()


@pytest.mark.long
@pytest.mark.filterwarnings("default")  # of both clusters' own
@pytest.mark.parametrize("executor", ["dask", "ray"])
@pytest.mark.timeout(600)
def test_a_cluster_gives_the_same_results(tmp_path: Path, executor: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip(executor)
    monkeypatch.setenv("RAY_worker_niceness", "0")  # else they wait for all else that the machine does
    home = few(tmp_path / "logs", 4)
    here = hf.trend(home, out=tmp_path / "here", jobs=1)
    if executor == "dask":
        distributed = pytest.importorskip("distributed")
        with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
            there = hf.trend(home, out=tmp_path / "there", executor=cluster.scheduler_address.replace("tcp", "dask"))
    else:
        there = hf.trend(home, out=tmp_path / "there", executor="ray", jobs=2)
    assert there.to_json() == here.to_json()
    assert there.rows == here.rows


@pytest.mark.filterwarnings("default")
def test_a_cluster_that_does_not_answer_is_a_user_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")

    def refused(*_: object, **__: object) -> object:
        raise OSError("no answer")

    monkeypatch.setattr(distributed, "Client", refused)
    home = few(tmp_path / "logs", 1)
    with pytest.raises(hf.UserError, match=r"executor dask://nowhere:8786: no scheduler answers at this address"):
        hf.trend(home, out=tmp_path / "out", executor="dask://nowhere:8786")
