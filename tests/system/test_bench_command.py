"""`hil-forceps bench` as a user meets it: what it leaves, that it repeats to the byte, and that it stops clean."""

import json
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hil_forceps.data.recording.reader import read_recording

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
REALISTIC = ROOT / "configs" / "realistic.yaml"
PAPER = ROOT / "configs" / "paper.yaml"
MEASURED = ["tau_w_rmse_N_m", "tau_w_peak_error_N_m", "jaw_error_steady_deg", "elongation_rmse_m"]
KEYS = {"simulation", "algorithm", "compensated", "sample_time_s", "finite", *MEASURED, "frames_sent", "frames_lost"}

Start = Callable[..., Any]


@pytest.fixture(scope="module")
def small_bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The realistic bench with one algorithm over the bus, and none without."""
    text = REALISTIC.read_text()
    changed = text.replace("direct_sample_times_s: [1.0e-4]", "direct_sample_times_s: []")
    assert changed != text
    path = tmp_path_factory.mktemp("rig") / "small.yaml"
    path.write_text(changed)
    return path


def bench(start: Start, config: Path, out: Path, *more: str) -> Any:
    return start("bench", "--config", config, "--out", out, "--simulation", "2", "--algorithm", "kalman", *more).end()


def results(out: Path) -> dict[str, bytes]:
    """Return what must repeat: all but figures and times."""
    kinds = {".mcap", ".log"}
    return {p.name: p.read_bytes() for p in out.iterdir() if p.suffix in kinds or p.name == "summary.json"}


@pytest.mark.long
def test_bench_repeats_to_the_byte_and_the_seed_matters(start: Start, small_bench: Path, tmp_path: Path) -> None:
    runs = {"one": ("4", "1"), "two": ("4", "2"), "other": ("5", "2", "--json")}
    for name, (seed, jobs, *more) in runs.items():
        ended = bench(start, small_bench, tmp_path / name, "--seed", seed, "--jobs", jobs, *more)
        assert ended.code == 0, ended.err
        assert "kalman" in ended.out
        assert (ended.out == (tmp_path / name / "summary.json").read_text(encoding="utf-8")) is bool(more)
    first = results(tmp_path / "one")
    names = {f"sim2_kalman_{c}_0.001s.{kind}" for c in ("compensated", "uncompensated") for kind in ("mcap", "log")}
    assert set(first) == names | {"summary.json"}
    assert results(tmp_path / "two") == first
    other = results(tmp_path / "other")
    assert [name for name in first if other[name] == first[name]] == []

    summary = json.loads(first["summary.json"])
    assert summary["seed"] == 4
    assert [run["compensated"] for run in summary["runs"]] == [True, False]
    for run in summary["runs"]:
        assert set(run) >= KEYS
        assert run["finite"] is True
        assert all(isinstance(run[key], float) for key in MEASURED)
        assert run["frames_sent"] >= 20_000
        assert run["frames_lost"] == 0
    timing = json.loads((tmp_path / "one" / "timing.json").read_text())
    assert timing["real_time_factor"] > 0.0
    assert {run["name"] for run in timing["runs"]} == {name.rpartition(".")[0] for name in names}
    for run in timing["runs"]:
        assert {"period", "age", "lateness"} <= set(run["loop"])
        assert {"p50_us", "p99_us", "max_us"} <= set(run["loop"]["age"])
    figures = {path.suffix for path in (tmp_path / "one").iterdir()}
    assert {".png", ".pdf"} <= figures

    replayed = start("replay", tmp_path / "one" / "sim2_kalman_compensated_0.001s.mcap").end()
    assert (replayed.code, replayed.err) == (0, "")
    decoded = start("decode", "--form", "csv", tmp_path / "one" / "sim2_kalman_compensated_0.001s.log").end()
    assert (decoded.code, decoded.err) == (0, "")
    samples = len(read_recording(tmp_path / "one" / "sim2_kalman_compensated_0.001s.mcap").samples)
    assert samples <= decoded.out.count(",Feedback,theta_m_rad,") <= samples + 100


@pytest.mark.long
def test_bench_before_and_after_an_effect_is_known(start: Start, tmp_path: Path) -> None:
    text = PAPER.read_text()
    plain = text.replace("direct_sample_times_s: [1.0e-4]", "direct_sample_times_s: []")
    assert plain != text
    extended = tmp_path / "extended.yaml"
    effect = "effects: {cogging: {sine_N_m: 3.0e-4, cosine_N_m: 3.0e-4, harmonic: 6.0}}\n"
    assert "\neffects:" not in plain
    extended.write_text(plain + effect)
    ended = bench(start, extended, tmp_path / "out", "--estimator-rig", str(PAPER), "--jobs", "2")
    assert ended.code == 0, ended.err
    assert "paper.yaml" in ended.out
    runs = json.loads((tmp_path / "out" / "summary.json").read_text())["runs"]
    assert [(run["compensated"], run.get("estimator_rig")) for run in runs] == [
        (True, None),
        (True, "paper.yaml"),
        (False, None),
        (False, "paper.yaml"),
    ]
    for told, blind in (runs[:2], runs[2:]):
        assert told["tau_w_rmse_N_m"] < 0.5 * blind["tau_w_rmse_N_m"]
    assert abs(runs[0]["jaw_error_steady_deg"]) < 0.2 * abs(runs[1]["jaw_error_steady_deg"])


def children_of(pid: int) -> list[int]:
    """Return the processes of the session that `pid` leads, itself left out."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and int(entry.name) != pid:
            try:
                session = os.getsid(int(entry.name))
            except OSError:
                continue
            if session == pid:
                found.append(int(entry.name))
    return found


def wait_for(what: Callable[[], bool], patience_s: float = 60.0) -> None:
    end = time.monotonic() + patience_s
    while not what():
        assert time.monotonic() < end, "it did not come"
        time.sleep(0.05)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("jobs", ["1", "2"])
def test_bench_stops_on_a_signal_and_leaves_nobody_behind(
    start: Start, small_bench: Path, tmp_path: Path, jobs: str, number: int
) -> None:
    out = tmp_path / "out"
    command = start("bench", "--config", small_bench, "--out", out, "--jobs", jobs)
    wait_for(lambda: out.is_dir() and any(p.stat().st_size > 100_000 for p in out.glob("*.mcap")))
    if number == signal.SIGINT:
        os.killpg(command.process.pid, number)  # as the terminal does: to all of them
    else:
        command.signal(number)
    ended = command.end()
    assert ended.code == 130
    assert ended.err.splitlines()[-1] == "hil-forceps: interrupted"
    assert "Traceback" not in ended.err
    wait_for(lambda: children_of(command.process.pid) == [], 10.0)
    reasons = [read_recording(path).result["reason"] for path in out.glob("*.mcap")]
    assert set(reasons) <= {"stop_requested", "completed"}
    assert "stop_requested" in reasons  # those under way ended early, none was waited for
    assert [path for path in out.iterdir() if path.is_dir()] == []
    assert not (out / "summary.json").exists()


def drives_with(folder: Path) -> list[int]:
    """Return drive processes whose command line names this folder's rig."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                line = (entry / "cmdline").read_bytes()
            except OSError:
                continue
            if b"drive" in line and str(folder).encode() in line and b"bench" not in line.split(b"\0"):
                found.append(int(entry.name))
    return found


@pytest.mark.realtime
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_bench_by_the_clock_disables_its_drive_when_stopped(start: Start, tmp_path: Path, number: int) -> None:
    text = PAPER.read_text().replace("host_period_s: 1.0e-3", "host_period_s: 1.0e-2")
    config = tmp_path / "patient.yaml"
    config.write_text(text)
    out = tmp_path / "out"
    command = start(
        "bench", "--config", config, "--out", out, "--realtime", "--simulation", "2", "--algorithm", "kalman"
    )
    recording = out / "sim2_kalman_compensated_0.01s.mcap"
    wait_for(lambda: recording.exists() and recording.stat().st_size > 50_000)
    assert len(drives_with(tmp_path)) == 1
    os.killpg(command.process.pid, number)
    ended = command.end()
    assert ended.code == 130
    assert ended.err.splitlines()[-1] == "hil-forceps: interrupted"
    assert drives_with(tmp_path) == []
    assert read_recording(recording).result["reason"] == "stop_requested"
    told = json.loads(next(out.glob("*.drive.json")).read_text())
    assert (told["drive"]["state"], told["drive"]["faults"]) == ("DISABLED", 0)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("name", ["sim2_kalman_compensated_0.001s.mcap", "sim2_kalman_uncompensated_0.001s.log"])
def test_bench_on_a_full_disk_ends_with_a_line(
    start: Start, small_bench: Path, tmp_path: Path, name: str, always_full: Callable[[Path], None]
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    always_full(out / name)
    ended = bench(start, small_bench, out, "--jobs", "1")
    assert ended.code == 2
    lines = [line for line in ended.err.splitlines() if line.startswith("hil-forceps: ")]
    assert len(lines) == 1
    assert "No space left on device" in lines[0]
    assert "Traceback" not in ended.err
