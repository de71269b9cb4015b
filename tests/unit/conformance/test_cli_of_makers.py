"""`hil-forceps conformance --rig` of drives that speak their makers' protocols."""

import json
import signal
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from hil_forceps.bridge.drive_conformance.catalogue import PROMISES
from hil_forceps.cli.commands.drives import conformance_of_drive
from hil_forceps.cli.main import main

ROOT = Path(__file__).parents[3]
ODRIVE = ROOT / "configs" / "drives" / "odrive.yaml"


def run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["conformance", *arguments])
    assert isinstance(ended.value.code, int)
    return ended.value.code


def over_bus(rig: Path, *, simulation: int = 0, world: Path | None = None) -> list[str]:
    """Return the arguments for a simulated drive of that rig, or of another."""
    line = ["--rig", str(rig), "--interface", "virtual_forceps", "--channel", f"makers {rig} {simulation} {world}"]
    return [*line, "--option", f"rig={world or rig}", "--option", f"simulation={simulation}"]


def changed(folder: Path, *changes: tuple[str, str]) -> Path:
    text = ODRIVE.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    rig = folder / "rig.yaml"
    rig.write_text(text, encoding="utf-8")
    return rig


def test_a_drive_that_keeps_its_promises(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    written = []
    for name in ("first", "second"):
        assert run(*over_bus(ODRIVE), "--allow-motion", "--out", str(tmp_path / name)) == 0
        written.append((tmp_path / name / "certificate.json").read_bytes())
    assert written[0] == written[1]
    assert capsys.readouterr().out.splitlines()[-1] == f"{len(PROMISES)} pass"
    certificate = json.loads(written[0])
    assert certificate["motor_driver"]["profile"] == "odrive"
    assert "issued" not in certificate
    cases = list(ET.parse(tmp_path / "first" / "junit.xml").getroot())
    assert len(cases) == len(PROMISES)
    assert {case.get("classname") for case in cases} == {"DRV"}


def test_a_servo_on_a_serial_line(capsys: pytest.CaptureFixture[str]) -> None:
    rig = ODRIVE.with_name("dynamixel.yaml")
    assert run(*over_bus(rig), "--only", "DRV-020", "--only", "DRV-050", "--allow-motion") == 0
    assert capsys.readouterr().out.splitlines()[-1] == "2 pass"
    assert run("--rig", str(rig), "--interface", "socketcan", "--channel", "can0") == 2
    assert "is on a serial line; give --serial PORT" in capsys.readouterr().err


def test_without_motion_and_only(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(*over_bus(ODRIVE), "--only", "DRV-020", "--only", "drv-030") == 0
    assert capsys.readouterr().out.splitlines()[-1] == "2 pass"
    assert run(*over_bus(ODRIVE), "--only", "DRV-060") == 1
    assert "not run, because they need --allow-motion" in capsys.readouterr().out


def test_what_fails_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The rig says 1 ms, the drive sends each 2 ms."""
    drive = changed(tmp_path, ("feedback_period_s: 1.0e-3", "feedback_period_s: 2.0e-3"))
    assert run(*over_bus(ODRIVE, world=drive), "--only", "DRV-020", "--out", str(tmp_path)) == 1
    assert "mean period" in capsys.readouterr().out
    assert ET.parse(tmp_path / "junit.xml").getroot().get("failures") == "1"


def test_why_a_drive_was_refused_is_told_with_each_promise(tmp_path: Path) -> None:
    """The rig says 2 ms, the drive sends each 1 ms, as two drives with one id would."""
    rig = changed(tmp_path, ("feedback_period_s: 1.0e-3", "feedback_period_s: 2.0e-3"))
    assert run(*over_bus(rig, world=ODRIVE), "--only", "DRV-020", "--out", str(tmp_path)) == 1
    assert "come every 1 ms, and motor_driver.feedback_period_s is 2 ms" in (tmp_path / "certificate.json").read_text()


def test_list_needs_no_drive(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--rig", str(ODRIVE), "--list") == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(PROMISES)
    assert lines[0].startswith("DRV-010 MUST")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "is on a CAN bus; give --interface and --channel"),
        (["--interface", "virtual_forceps", "--only", "HFP-120"], "--only HFP-120: unknown check; --list shows all"),
        (["--node", "3"], "--node: "),
        (["--fd"], "--fd: "),
        (["--flood-s", "3"], "--flood-s: "),
        (["--serial", "/dev/null"], "--serial: "),
        (["--interface", "virtual_forceps", "--channel", "none", "--line-ms", "0"], "nothing is on channel"),
    ],
)
def test_user_errors(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--rig", str(ODRIVE), *arguments) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("watchdog_s: 0.1", "watchdog_s: 0.0", "motor_driver.watchdog_s: is 0: nothing stops the motor"),
        ("limits: ", "x_limits: ", "x_limits"),
        ("position_max_rad: 1.6", "position_max_rad: 1.0", "node 5: can't be tested: the motor is at 1.099 rad"),
        ("node_id: 5", "node_id: 6", "node 6: can't be tested: no drive answered: "),
    ],
)
def test_it_looks_first_whether_it_can_judge(
    old: str, new: str, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = changed(tmp_path, (old, new))
    assert run(*over_bus(rig, world=ODRIVE), "--allow-motion") == 2
    said = capsys.readouterr().err
    assert told in said
    assert said.count("\n") == 1


def test_no_limits_no_judgement(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = ODRIVE.read_text(encoding="utf-8")
    rig = tmp_path / "rig.yaml"
    rig.write_text(text[: text.index("\nlimits:")] + text[text.index("\nestimators:") :], encoding="utf-8")
    assert run(*over_bus(rig, world=ODRIVE), "--allow-motion") == 2
    assert "limits: is missing" in capsys.readouterr().err


def test_a_load_that_moves_the_motor_ends_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(*over_bus(ODRIVE, simulation=1), "--allow-motion") == 2
    said = capsys.readouterr().err
    assert "take the load off the jaw, or hold it" in said
    assert said.count("\n") == 1


def test_a_signal_ends_without_torque(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def show(name: str) -> None:
        if name.startswith("DRV-041"):
            signal.raise_signal(signal.SIGTERM)

    monkeypatch.setattr(conformance_of_drive, "progress", lambda _: show)
    assert run(*over_bus(ODRIVE), "--allow-motion") == 130
    assert capsys.readouterr().err == "hil-forceps: interrupted\n"


def test_a_rig_of_the_projects_own_protocol_is_judged_by_that(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--rig", str(ROOT / "configs" / "paper.yaml"), "--list") == 0
    assert "HFP-120" in capsys.readouterr().out
