"""`hil-forceps doctor`: its table, its JSON, its exit codes; on this machine, with simulated drives."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from hil_forceps.bridge.doctor import timing
from hil_forceps.bridge.doctor.check import Check, Verdict
from hil_forceps.bridge.doctor.timing import Lateness
from hil_forceps.cli import main as cli
from hil_forceps.cli.terminal import check_table

CONFIGS = Path(__file__).parents[4] / "configs"
NATIVE = CONFIGS / "realistic.yaml"


@pytest.fixture(autouse=True)
def _punctual(monkeypatch: pytest.MonkeyPatch) -> None:
    """How late this machine wakes is no business of these tests."""
    monkeypatch.setattr(timing, "measure", lambda *_: Lateness((1e-5,) * 1000, 0.0, 1.0))


def doctor(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as ended:
        cli.main(["doctor", *arguments])
    captured = capsys.readouterr()
    return int(ended.value.code or 0), captured.out, captured.err


def simulated(rig: Path, folder: Path) -> tuple[str, ...]:
    return ("--interface", "virtual_forceps", "--channel", str(folder), "--option", f"rig={rig}")


def as_json(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, dict[str, dict[str, Any]]]:
    code, out, _ = doctor(capsys, *arguments, "--json")
    content = json.loads(out)
    assert content["ok"] == (code == 0)
    return code, {check["id"]: check for check in content["checks"]}


def test_without_options_the_machine_alone_is_looked_at(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    code, checks = as_json(capsys, "--out", str(tmp_path / "out"))
    assert code == 0
    assert {name.partition(".")[0] for name in checks} == {"machine", "disk", "timing"}
    assert not (tmp_path / "out").exists()
    assert set(checks["disk.space"]) == {"id", "what", "verdict", "text", "remedy", "value", "unit"}


def test_a_drive_as_its_rig_says_is_well_in_80_columns(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    code, out, err = doctor(capsys, "--rig", str(NATIVE), *simulated(NATIVE, tmp_path), "--out", str(tmp_path))
    assert (code, err) == (0, "")
    assert "ok   drive.answers         node 1 answers\n" in out
    assert max(map(len, out.splitlines())) <= 80


def test_a_drive_of_another_rig_fails(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(NATIVE.read_text(encoding="utf-8").replace("counts_per_rev: 16384", "counts_per_rev: 4096"))
    code, out, _ = doctor(capsys, "--rig", str(rig), *simulated(NATIVE, tmp_path))
    assert code == 1
    assert "FAIL drive.counts" in out
    assert "-> set encoder.counts_per_rev: 16384 in the rig" in out


def test_settings_that_do_not_go_together_are_in_it(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    text = (CONFIGS / "drives" / "odrive.yaml").read_text(encoding="utf-8")
    rig = tmp_path / "rig.yaml"
    rig.write_text(text.replace("watchdog_s: 0.1", "watchdog_s: 0.002"))
    nowhere = ("--interface", "socketcan", "--channel", "can_none")
    code, checks = as_json(capsys, "--rig", str(rig), *nowhere)
    assert (code, checks["rig.motor_driver.watchdog_s"]["verdict"]) == (1, "fail")
    rig.write_text(text.replace("node_id: 5", "node_id: 63"))
    code, checks = as_json(capsys, "--rig", str(rig), *nowhere)
    assert (code, checks["rig.motor_driver.node_id"]["verdict"]) == (1, "fail")
    rig.write_text(text)
    code, checks = as_json(capsys, "--rig", str(rig), *nowhere)
    assert checks["rig.settings"]["verdict"] == "ok"


def test_a_rig_without_a_line_is_not_called_well(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = doctor(capsys, "--rig", str(NATIVE))
    assert (code, out) == (2, "")
    assert "the line to its drive is missing; give --interface and --channel, or --serial" in err


def test_a_simulated_drive_without_its_rig_has_a_remedy(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    code, checks = as_json(capsys, "--interface", "virtual_forceps", "--channel", str(tmp_path))
    assert (code, checks["line.open"]["verdict"]) == (1, "fail")
    assert checks["line.open"]["remedy"] == "say what is there by the option rig=RIG.yaml"


def test_two_axes_are_told_apart(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    left, right = tmp_path / "left.yaml", tmp_path / "right.yaml"
    text = NATIVE.read_text(encoding="utf-8")
    left.write_text(text)
    right.write_text(text.replace("bench:\n", "bench:\n  node_id: 2\n"))
    lines = simulated(Path(f"{left},{right}"), tmp_path)
    code, checks = as_json(capsys, "--rig", str(left), "--rig", str(right), *lines)
    assert checks["drive.answers:left"]["text"] == "node 1 answers"
    assert checks["drive.answers:right"]["text"] == "node 2 answers"
    assert checks["rigs.bench.bitrate_bit_per_s"]["verdict"] == "fail"  # 94 % of the bus
    assert code == 1


def test_a_line_that_can_not_be_opened_is_a_check_that_fails(capsys: pytest.CaptureFixture[str]) -> None:
    code, checks = as_json(capsys, "--serial", "/dev/ttyUSB_none")
    assert code == 1
    assert checks["line.open"]["verdict"] == checks["serial.port"]["verdict"] == "fail"
    assert "list_ports" in checks["line.open"]["remedy"]
    code, checks = as_json(capsys, "--interface", "socketcan", "--channel", "can_none")
    assert (code, checks["can.up"]["verdict"]) == (1, "fail")


def test_a_line_without_a_rig_is_listened_to(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    code, checks = as_json(capsys, *simulated(NATIVE, tmp_path))
    assert code == 0
    assert "native 1" in checks["line.drives"]["text"]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--duration", "nan"), "--duration nan: must be a positive number"),
        (("--rig", "/no/such.yaml"), "/no/such.yaml"),
        (("--interface", "virtual", "--serial", "loop://"), "leave one out"),
        (("--option", "x", "--interface", "virtual"), "--option x: must be KEY=VALUE"),
        (("--rig", str(CONFIGS / "drives" / "odrive.yaml"), "--serial", "/dev/null"), "--serial: "),
        (("--nonsense",), "nonsense"),
    ],
)
def test_what_can_not_be_asked_is_one_line(
    capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], told: str
) -> None:
    code, out, err = doctor(capsys, *arguments)
    assert (code, out) == (2, "")
    assert told in err


def test_it_works_without_a_home_and_an_environment(tmp_path: Path) -> None:
    root = Path(__file__).parents[4]
    done = subprocess.run(
        [sys.executable, "-m", "hil_forceps.cli.main", "doctor", "--json"],
        env={"PYTHONPATH": str(root), "PATH": str(tmp_path)},
        cwd=tmp_path,
        capture_output=True,
        check=False,
    )
    assert done.returncode in {0, 1}, done.stderr  # 1: this machine is late just now
    assert {check["id"] for check in json.loads(done.stdout)["checks"]} >= {"machine.scheduling", "disk.space"}
    assert list(tmp_path.iterdir()) == []


def test_what_drives_and_files_say_can_not_steer_a_terminal() -> None:
    text = "\x1b]0;title\x07 \x9b2J \r\n drive \u202e \u2028" * 20
    checks = [Check(text, text, verdict, text, text) for verdict in Verdict]
    shown = "\n".join(
        check_table.lines([*checks, Check("a", "", Verdict.UNKNOWN, text), Check("b", "", Verdict.OK, "")])
    )
    assert all(line.isprintable() and len(line) <= 80 for line in shown.split("\n"))
