"""`explain`: runs that ended well and badly, recordings whole, cut off and old, and fault.json alone."""

import json
from pathlib import Path
from typing import Any

import pytest
from mcap.opcode import Opcode

from hil_forceps.bench.explanation.causes import causes_of
from hil_forceps.bench.explanation.events import events_of
from hil_forceps.bench.explanation.evidence import Evidence, read_evidence
from hil_forceps.cli import main as cli
from tests.reader_fuzz import sound_files

CONFIGS = Path(__file__).parents[4] / "configs"
PAPER, ODRIVE = CONFIGS / "paper.yaml", CONFIGS / "drives" / "odrive.yaml"
GOLDEN = Path(__file__).parent / "golden"
NO_REFERENCES = "{fault: drop, direction: to_drive, from_s: 1.5, to_s: 2.5}"


def command(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        cli.main([str(each) for each in arguments])
    return int(ended.value.code or 0)


def a_run(folder: Path, rig: Path = PAPER, fault: str = "") -> Path:
    more: list[object] = []
    if fault:
        (folder / "faults.yaml").write_text(f"- {fault}\n")
        more = ["--option", f"faults={folder / 'faults.yaml'}"]
    line = ("--interface", "virtual_forceps", "--channel", folder, "--option", f"rig={rig}", "--duration", "2")
    command("run", "--rig", rig, *line, "--option", "simulation=2", *more, "--out", folder / "out")
    return folder / "out"


@pytest.fixture(scope="module")
def native(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return a_run(tmp_path_factory.mktemp("native"), PAPER, NO_REFERENCES)


def told(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    capsys.readouterr()
    assert command("explain", *arguments) == 0
    return capsys.readouterr().out


def test_a_native_drive_s_fault_in_words(native: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert told(capsys, native) == (GOLDEN / "explain_native.txt").read_text(encoding="utf-8")


def test_a_maker_s_fault_in_the_maker_s_words(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert told(capsys, a_run(tmp_path, ODRIVE, NO_REFERENCES)) == (GOLDEN / "explain_odrive.txt").read_text(
        encoding="utf-8"
    )


def test_a_run_that_ended_well(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = told(capsys, a_run(tmp_path))
    assert said.startswith("run.mcap: ended normally: completed\n")
    assert "Likely causes" not in said
    assert "zero: the time of trajectory and load counts from here" in said


def test_as_json(native: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = json.loads(told(capsys, native, "--json"))
    keys = "name notes events reason message has_trip compared ended_s counted_from rows causes"
    assert set(said) == set(keys.split())
    assert [event["time_s"] for event in said["events"]] == sorted(event["time_s"] for event in said["events"])
    assert said["rows"][-1]["state"] == "FAULT"


def test_fault_json_alone_tells_the_second(native: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "fault.json").write_bytes((native / "fault.json").read_bytes())
    said = told(capsys, tmp_path)
    whole = told(capsys, native)
    assert "only the last second is available" in said
    assert said.partition("End\n")[2] == whole.partition("End\n")[2]


def test_the_attachment_serves_where_the_file_is_gone(
    native: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "run.mcap").write_bytes((native / "run.mcap").read_bytes())
    assert told(capsys, tmp_path) == told(capsys, native)


def test_recordings_of_versions_without_it(native: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = sound_files.records((native / "run.mcap").read_bytes())
    old = [(opcode, body) for opcode, body in found if opcode != Opcode.ATTACHMENT]
    end = next(place for place, (opcode, _) in enumerate(old) if opcode == Opcode.DATA_END)
    (tmp_path / "run.mcap").write_bytes(sound_files.mcap([*old[:end], (int(Opcode.DATA_END), bytes(4))]))
    said = told(capsys, tmp_path)
    assert "the drive latched a fault: WATCHDOG" in said
    assert "  1. 20 references were sent, but the samples of the drive confirm none of them" in said


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_a_recording_that_was_cut_off(
    native: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], share: float
) -> None:
    data = (native / "run.mcap").read_bytes()
    (tmp_path / "run.mcap").write_bytes(data[: int(share * len(data))])
    said = told(capsys, tmp_path)
    assert said.startswith("run.mcap: its end is not recorded\nnote: recording is cut off or damaged at byte ")
    assert "hil-forceps recover lists what is missing" in said


def test_a_file_that_was_changed_later_is_no_power_failure(
    native: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = bytearray((native / "run.mcap").read_bytes())
    data[len(data) // 4] ^= 0x10
    (tmp_path / "run.mcap").write_bytes(data)
    said = told(capsys, tmp_path)
    assert "its end is not recorded" in said
    assert "power" not in said
    assert "the file was damaged after the run" in said
    assert "hil-forceps recover" in said
    (tmp_path / "run.mcap").write_bytes(data[: len(data) // 2])
    cut = told(capsys, tmp_path)
    assert "power" in cut
    assert "Events (time in s since the first recorded message; the start of the run is not recorded)" in cut


def test_what_can_not_be_read_is_said_in_one_line(
    native: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = json.loads((native / "fault.json").read_text())
    changes: tuple[dict[str, Any], ...] = (
        {"format": 7},
        {"samples": 3},
        {"samples": {"columns": ["stamp_ns"], "rows": [["x"]]}},
        {"reason": None},
        {"lateness": {"rows": [[1]]}},
        {"time_ns": None},
        {"drive": []},
    )
    for change in changes:
        path = tmp_path / "fault.json"
        path.write_text(json.dumps({**good, **change}))
        assert command("explain", path) == 2
        said = capsys.readouterr().err
        assert said.startswith(f"hil-forceps: {path}: ")
        assert said.count("\n") == 1
    (tmp_path / "out" / "left").mkdir(parents=True)
    (tmp_path / "out" / "left" / "run.mcap").write_bytes(b"")
    assert command("explain", tmp_path / "out") == 2
    assert "contains no run.mcap, but its folders left do" in capsys.readouterr().err


def test_the_figure(native: Path, tmp_path: Path) -> None:
    assert command("explain", native, "--out", tmp_path / "a") == 0
    assert command("explain", native, "--out", tmp_path / "b") == 0
    assert (tmp_path / "a" / "fault.png").read_bytes() == (tmp_path / "b" / "fault.png").read_bytes()
    assert (tmp_path / "a" / "fault.png").read_bytes().startswith(b"\x89PNG")


def kinds(evidence: Evidence) -> dict[str, str]:
    return {event.kind: event.text for event in events_of(evidence)}


def changed(evidence: Evidence, **tables: Any) -> Evidence:
    names = Evidence.__dataclass_fields__
    return Evidence(**{name: tables.get(name, getattr(evidence, name)) for name in names})


def test_lost_samples_late_ticks_and_limits_are_events(native: Path) -> None:
    evidence = read_evidence(native / "run.mcap")
    assert "missing samples" not in kinds(evidence)
    keep = [row for row in range(len(evidence.samples)) if not 500 <= row < 505]
    assert kinds(changed(evidence, samples=evidence.samples[keep]))["missing samples"].startswith("5 samples")
    references = evidence.references.copy()
    references = references[[row for row in range(len(references)) if not 1480 <= row < 1490]]
    late = changed(evidence, references=references)
    assert kinds(late)["overruns"] == "this host was late: 10 ticks skipped, longest pause 11.0 ms"
    assert causes_of(late, events_of(late))[0].cause.startswith("the loop on this host paused")
    limited = evidence.references.copy()
    limited["verdict"][700:712] = next(code for code, name in evidence.verdicts.items() if name == "LIMITED_SPEED")
    said = kinds(changed(evidence, references=limited))["ticks"]
    assert said == "12 ticks with their references limited by the gate (speed)"


def test_stale_samples_before_a_watchdog_are_the_first_cause(native: Path) -> None:
    evidence = read_evidence(native / "run.mcap")
    references = evidence.references.copy()
    references["verdict"][-30:] = 1
    stale = changed(evidence, references=references)
    assert causes_of(stale, events_of(stale))[0].cause.startswith("samples were too old")


def test_a_gap_that_closed_the_gate_goes_before_what_it_denied_since(native: Path) -> None:
    evidence = read_evidence(native / "run.mcap")
    references = evidence.references.copy()
    codes = {name: code for code, name in evidence.verdicts.items()}
    references["verdict"][-5:] = [codes["DENIED_GAP"], *[codes["DENIED_CLOSED"]] * 4]
    closed = changed(evidence, references=references, reason="reference_denied")
    assert causes_of(closed, events_of(closed))[0].cause.startswith("no reference was sent for longer than")


def test_the_approach_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    motion = tmp_path / "motion.csv"
    motion.write_text("time_s,theta_j_rad\n0,1.2\n2,1.2\n")
    line = ("--interface", "virtual_forceps", "--channel", tmp_path, "--option", f"rig={PAPER}")
    assert command("run", "--rig", PAPER, *line, "--trajectory", motion, "--out", tmp_path / "out") == 0
    said = told(capsys, tmp_path / "out")
    assert "approach: the motor is +0.2" in said
    assert "rad from the trajectory; the difference is removed in 0." in said
