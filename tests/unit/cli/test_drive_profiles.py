"""`run`, `drive` and rigs whose drive speaks its maker's protocol: what doesn't go together is told in one line."""

import json
from pathlib import Path

import pytest

from hil_forceps.cli import main as cli
from virtual_bus.realtime import process

ODRIVE = Path(__file__).parents[3] / "configs" / "drives" / "odrive.yaml"


def changed(folder: Path, old: str, new: str) -> Path:
    text = ODRIVE.read_text(encoding="utf-8")
    assert old in text
    rig = folder / "rig.yaml"
    rig.write_text(text.replace(old, new), encoding="utf-8")
    return rig


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    with pytest.raises(SystemExit) as ended:
        cli.main(list(arguments))
    assert ended.value.code == 2
    return capsys.readouterr().err


def test_an_odrive_is_not_on_a_serial_port(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    said = refused(capsys, "run", "--rig", str(ODRIVE), "--serial", "/dev/null", "--out", str(tmp_path / "out"))
    assert "--serial: " in said
    assert "--interface" in said
    assert not (tmp_path / "out").exists()


def test_a_rig_of_another_drive_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    said = refused(capsys, "run", "--rig", str(ODRIVE), "--drive", "cia402", "--out", str(tmp_path / "out"))
    assert "speaks odrive" in said


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("watchdog_s: 0.1", "watchdog_s: 0.0", "motor_driver.watchdog_s: is 0: nothing stops the motor"),
        ("node_id: 5", "node_id: 63", "motor_driver.node_id: is 63, but a drive of the profile odrive has 0 to 62"),
    ],
)
def test_run_refuses_what_check_calls_a_problem(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, old: str, new: str, told: str
) -> None:
    rig = changed(tmp_path, old, new)
    virtual = ("--interface", "virtual_forceps", "--channel", "profiles")
    said = refused(capsys, "run", "--rig", str(rig), *virtual, "--out", str(tmp_path / "out"))
    assert told in said
    assert not (tmp_path / "out").exists()


def test_a_vesc_behind_such_a_path_is_not_enabled(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    text = (ODRIVE.parent / "vesc.yaml").read_text(encoding="utf-8")
    rig.write_text(text.replace("latency_s: 1.5e-4", "latency_s: 5.0e-3"), encoding="utf-8")
    channel = ("--interface", "virtual_forceps", "--channel", str(tmp_path), "--option", f"rig={rig}")
    said = refused(capsys, "run", "--rig", str(rig), *channel, "--duration", "2", "--out", str(tmp_path / "out"))
    assert "older than limits.max_sample_age_s" in said
    assert json.loads((tmp_path / "out" / "run.json").read_text())["counters"]["host"]["setpoints_sent"] == 0


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("node_id: 5", "node_id: 253", "motor_driver.node_id"),
        ("watchdog_s: 0.1", "watchdog_s: 1.0", "motor_driver.watchdog_s: is 1 s; the service sees the timeout expire"),
        ("position_max_rad: 1.6", "position_max_rad: 6.0", "limits: span 1.03 turns of the VESC's angle"),
    ],
)
def test_a_vesc_whose_rig_can_not_work_is_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, old: str, new: str, told: str
) -> None:
    text = (ODRIVE.parent / "vesc.yaml").read_text(encoding="utf-8")
    assert old in text
    rig = tmp_path / "rig.yaml"
    rig.write_text(text.replace(old, new), encoding="utf-8")
    virtual = ("--interface", "virtual_forceps", "--channel", "profiles")
    said = refused(capsys, "run", "--rig", str(rig), *virtual, "--out", str(tmp_path / "out"))
    assert told in said
    assert not (tmp_path / "out").exists()


def test_the_simulated_process_does_not_pretend_to_be_an_odrive(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--rig", str(ODRIVE), "--interface", "virtual", "--channel", "profiles", "--duration", "0.1"]
    assert process.main(arguments) == 2
    assert "motor_driver.profile: is odrive" in capsys.readouterr().err


def test_a_path_that_takes_too_long_is_told_by_its_age(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """A SYNC's answer comes 10 ms later; the age is that, and no reference leaves from such a sample."""
    rig = tmp_path / "rig.yaml"
    text = (ODRIVE.parent / "cia402.yaml").read_text(encoding="utf-8")
    rig.write_text(text.replace("latency_s: 1.5e-4", "latency_s: 5.0e-3"), encoding="utf-8")
    channel = ("--interface", "virtual_forceps", "--channel", str(tmp_path), "--option", f"rig={rig}")
    said = refused(capsys, "run", "--rig", str(rig), *channel, "--duration", "2", "--out", str(tmp_path / "out"))
    assert "older than limits.max_sample_age_s" in said
    rig.write_text(rig.read_text(encoding="utf-8").replace("max_sample_age_s: 3.0e-3", "max_sample_age_s: 0.02"))
    with pytest.raises(SystemExit) as ended:
        cli.main(["run", "--rig", str(rig), *channel, "--duration", "2", "--out", str(tmp_path / "out")])
    assert ended.value.code == 0
    age_us = json.loads((tmp_path / "out" / "run.json").read_text())["timing"]["age"]["p50_us"]
    assert age_us > 10_000.0
