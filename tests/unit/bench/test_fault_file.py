"""A run that ends in a fault: three lines on the terminal, and the second before it kept apart, all of it."""

import json
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol.messages import DriveState, FaultReason
from hil_forceps.bench.fault_file import fault_path
from hil_forceps.bridge.course import Course
from hil_forceps.bridge.logs.flight_recorder import RECORDED_BEFORE_FAULT_NS
from hil_forceps.bridge.results import StopReason
from hil_forceps.bridge.service import Service
from hil_forceps.cli import main as cli
from hil_forceps.cli.commands.runs import run_checks
from hil_forceps.control.gate import GateTrip
from hil_forceps.data.readers.bus_logs.frames import read_frames
from hil_forceps.data.recording.reader import read_recording
from hil_forceps.data.strict_json import parse_json

CONFIGS = Path(__file__).parents[3] / "configs"
PAPER, ODRIVE = CONFIGS / "paper.yaml", CONFIGS / "drives" / "odrive.yaml"
NO_REFERENCES = "{fault: drop, direction: to_drive, from_s: 1.5}"
NO_SAMPLES = "{fault: drop, direction: to_host, from_s: 1.5}"
NO_BUS = "{fault: bus_gone, from_s: 1.5}"
NO_DRIVE = "{fault: drop, direction: to_host}"


def run(folder: Path, fault: str = "", rig: Path = PAPER, *more: str) -> int:
    """Run for two seconds, without the line that tells every few of the clock's; `fault` happens on the bus."""
    option = []
    if fault:
        (folder / "faults.yaml").write_text(f"- {fault}\n")
        option = ["--option", f"faults={folder / 'faults.yaml'}"]
    with pytest.raises(SystemExit) as ended:
        cli.main([
            "run", "--rig", str(rig), "--interface", "virtual_forceps", "--channel", str(folder),
            "--option", f"rig={rig}", "--option", "simulation=2", *option, "--duration", "2",
            "--out", str(folder / "out"), "--quiet", *more,
        ])  # fmt: skip
    return int(ended.value.code or 0)


def kept(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = parse_json((folder / "out" / "fault.json").read_text())
    return content


def column(table: dict[str, Any], name: str) -> list[Any]:
    place = table["columns"].index(name)
    return [row[place] for row in table["rows"]]


def test_the_last_second_of_everything_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(tmp_path, NO_REFERENCES) == 2
    out, fault = tmp_path / "out", kept(tmp_path)
    assert (fault["reason"], fault["stage"], fault["drive"]["state"]) == ("drive_fault", "running", "FAULT")
    assert fault["drive"]["fault"] == "WATCHDOG (watchdog: no fresh reference in time)"
    recording = read_recording(out / "run.mcap")
    assert recording.notes == ()
    assert recording.fault == (out / "fault.json").read_bytes()

    begin_ns = fault["time_ns"] - RECORDED_BEFORE_FAULT_NS
    for table, name, time in (("samples", recording.samples, "received_ns"),
                              ("references", recording.references, "tick_ns"),
                              ("bench", recording.bench, "received_ns")):  # fmt: skip
        rows = name[name[time] >= begin_ns]
        assert column(fault[table], time) == rows[time].tolist()
        assert len(fault[table]["rows"]) >= 990
    assert column(fault["samples"], "state")[-1] == DriveState.FAULT
    assert column(fault["samples"], "fault")[-1] == FaultReason.WATCHDOG
    ticks = column(fault["lateness"], "tick_ns")
    assert set(column(fault["references"], "tick_ns")) <= set(ticks)
    assert set(column(fault["lateness"], "late_ns")) == {0}  # in virtual time
    logged = (out / "bus.log").read_text().splitlines()
    assert fault["frames"] == logged[-len(fault["frames"]) :]
    assert {line[-1] for line in fault["frames"]} == {"R", "T"}
    result = json.loads((out / "run.json").read_text())
    assert result["fault"]["time_ns"] == fault["time_ns"]
    assert fault["counters"]["host"] == result["counters"]["host"]

    lines = capsys.readouterr().err.splitlines()
    assert lines == [
        "hil-forceps: the drive latched a fault: WATCHDOG (watchdog: no fresh reference in time)",
        f"  {fault['time_ns'] / 1e9:.3f} s after the start, while running; last state of the drive: FAULT",
        f"  the last second is in {out}/fault.json; hil-forceps explain {out}",
    ]


@pytest.mark.parametrize(
    ("fault", "reason", "check", "limit"),
    [
        (NO_SAMPLES, "drive_lost", "time since the last sample", 100.0),
        (NO_BUS, "bus_down", "bus down", None),
        (NO_DRIVE, "no_drive", "time to connect", 2.0),
    ],
)
def test_the_check_that_failed_is_kept_with_value_and_limit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], fault: str, reason: str, check: str, limit: float | None
) -> None:
    assert run(tmp_path, fault) == 2
    said = kept(tmp_path)
    assert (said["reason"], said["check"], said["limit"]) == (reason, check, limit)
    assert limit is None or said["value"] >= limit
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 3
    assert (limit is None) == ("limit" not in lines[0])


def test_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    assert run(tmp_path, NO_REFERENCES) == 2
    (tmp_path / "out").rename(tmp_path / "before")
    assert run(tmp_path, NO_REFERENCES) == 2
    for file in ("run.mcap", "bus.log", "fault.json"):
        assert (tmp_path / "before" / file).read_bytes() == (tmp_path / "out" / file).read_bytes(), file


def test_a_run_that_ended_well_leaves_nothing_and_takes_away_what_was_there(tmp_path: Path) -> None:
    assert run(tmp_path, NO_REFERENCES) == 2
    assert fault_path(tmp_path / "out" / "run.mcap").exists()
    assert run(tmp_path, "", PAPER, "--overwrite") == 0
    assert not fault_path(tmp_path / "out" / "run.mcap").exists()
    assert read_recording(tmp_path / "out" / "run.mcap").fault is None


def test_a_used_folder_is_not_written_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(tmp_path) == 0
    before = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    capsys.readouterr()
    assert run(tmp_path) == 2
    said = capsys.readouterr().err
    assert said == (
        f"hil-forceps: --out {tmp_path}/out: contains a run (run.mcap); name another folder, or use --overwrite\n"
    )
    assert {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()} == before
    assert run(tmp_path, "", PAPER, "--overwrite", "--bus-log", "asc") == 0
    assert not (tmp_path / "out" / "bus.log").exists(), "a log of another run beside this one's recording"


def test_replay_says_how_many_references_left_as_run_does(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(tmp_path) == 0
    said_by_run = capsys.readouterr().out
    with pytest.raises(SystemExit):
        cli.main(["replay", str(tmp_path / "out")])
    said = capsys.readouterr().out
    sent = int(said_by_run.split(";")[1].split()[0])
    counts = [int(part.split()[0]) for part in said.partition("all identical; ")[2].split(", ")]
    assert counts[0] == sent
    assert f"{sum(counts)} references from" in said


def test_a_maker_s_words_are_kept(tmp_path: Path) -> None:
    assert run(tmp_path, NO_REFERENCES, ODRIVE) == 2
    drive = kept(tmp_path)["drive"]
    assert (drive["profile"], drive["fault"]) == ("odrive", "axis error 0x1000000 (watchdog expired)")


def test_a_gate_that_says_what_stopped_it_is_believed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(PAPER.read_text().replace("position_max_rad: 3.0", "position_max_rad: 0.5"))
    monkeypatch.setattr(run_checks, "check_trajectory", lambda *_: None)  # or nothing would begin at all
    assert run(tmp_path, "", rig) == 2
    assert kept(tmp_path)["check"] == "time to become operational"
    monkeypatch.setattr(Course, "_connecting", stop_as_denied)
    assert run(tmp_path, "", rig, "--overwrite") == 2
    said = kept(tmp_path)
    assert [said[key] for key in ("check", "value", "limit", "unit", "time_ns")] == [
        "reference position", 3.5, 3.0, "rad", 1_200_000_000,
    ]  # fmt: skip


def stop_as_denied(course: Course, _now_ns: int) -> None:
    course._pipeline.gate_trip = GateTrip("reference position", 3.5, 3.0, "rad", 1_200_000_000)
    course._end(StopReason.REFERENCE_DENIED, "the gate denied 5 references in a row")


def test_a_program_that_fails_keeps_the_last_second_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tick = Service._tick

    def fails(self: Service, now_ns: int) -> None:
        if now_ns > 1_000_000_000:
            raise RuntimeError("a bug")
        tick(self, now_ns)

    monkeypatch.setattr(Service, "_tick", fails)
    with pytest.raises(RuntimeError, match="a bug"):
        run(tmp_path)
    said = kept(tmp_path)
    assert (said["reason"], said["message"], said["stage"]) == ("crashed", "RuntimeError: a bug", "running")
    assert len(said["samples"]["rows"]) > 900
    assert len(list(read_frames(tmp_path / "out" / "bus.log"))) > 1000
    assert read_recording(tmp_path / "out" / "run.mcap").fault == (tmp_path / "out" / "fault.json").read_bytes()
