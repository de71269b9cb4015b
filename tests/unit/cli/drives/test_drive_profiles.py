"""`run`, `drive` and rigs whose drive speaks its maker's protocol: what doesn't go together is told in one line."""

import json
from pathlib import Path

import pytest

from hil_forceps.cli import main as cli
from virtual_bus.realtime import process

ODRIVE = Path(__file__).parents[4] / "configs" / "drives" / "odrive.yaml"
DYNAMIXEL = ODRIVE.parent / "dynamixel.yaml"


def changed(folder: Path, old: str, new: str, rig: Path = ODRIVE) -> Path:
    text = rig.read_text(encoding="utf-8")
    assert old in text
    path = folder / "rig.yaml"
    path.write_text(text.replace(old, new), encoding="utf-8")
    return path


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


@pytest.mark.parametrize("line", [("--interface", "virtual", "--channel", "profiles"), ()])
def test_a_dynamixel_is_not_on_a_can_bus(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, line: tuple[str, ...]
) -> None:
    said = refused(capsys, "run", "--rig", str(DYNAMIXEL), *line, "--out", str(tmp_path / "out"))
    assert "motor_driver.profile: dynamixel is on a serial line; give --serial PORT, or --interface virtual_" in said
    assert not (tmp_path / "out").exists()


def test_an_odrive_wants_an_interface(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    said = refused(capsys, "run", "--rig", str(ODRIVE), "--out", str(tmp_path / "out"))
    assert "motor_driver.profile: odrive is on a CAN bus; give --interface and --channel" in said


def test_a_line_has_one_rate(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    line = ("--serial", "/dev/null", "--baudrate", "1000000")
    said = refused(capsys, "run", "--rig", str(DYNAMIXEL), *line, "--out", str(tmp_path / "out"))
    assert "motor_driver.baudrate_bit_per_s: 3000000" in said


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (
            "watchdog_s: 0.1",
            "watchdog_s: 0.05",
            "motor_driver.watchdog_s: is 0.05 s, but the bus watchdog of a servo has steps",
        ),
        ("watchdog_s: 0.1", "watchdog_s: 2.56", "steps of 0.02 s up to 2.54 s"),
        ("zero_rev: 0.25", "zero_rev: 256.0", "motor_driver.encoder_zero_rev: with `limits:` the servo's range is"),
        ("limit_A: 1.0   ", "limit_A: 0.001 ", "less than the servo's resolution of 0.00269 A"),
    ],
)
def test_what_a_servo_can_not_be_told_is_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, old: str, new: str, told: str
) -> None:
    rig = changed(tmp_path, old, new, DYNAMIXEL)
    said = refused(capsys, "run", "--rig", str(rig), "--serial", "/dev/null", "--out", str(tmp_path / "out"))
    assert told in said
    assert not (tmp_path / "out").exists()


def test_a_rig_of_another_drive_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    said = refused(capsys, "run", "--rig", str(ODRIVE), "--drive", "cia402", "--out", str(tmp_path / "out"))
    assert "profile odrive" in said


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("watchdog_s: 0.1", "watchdog_s: 0.0", "motor_driver.watchdog_s: is 0: nothing stops the motor"),
        ("node_id: 5", "node_id: 63", "motor_driver.node_id: is 63, but the nodes of the profile odrive are 0 to 62"),
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


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("  mit_variant: bgkatz\n", "", "motor_driver.mit_variant: is missing; set bgkatz, cubemars or damiao"),
        (
            "  torque_range_N_m: 1.35e-2 ",
            "  # ",
            "motor_driver.torque_range_N_m: is missing; a drive of the profile mit",
        ),
        ("node_id: 5", "node_id: 0", "motor_driver.node_id: is 0, but the nodes of the profile mit are 1 to 126"),
        ("position_range_rad: 3.2", "position_range_rad: 1.6", "but limits: allow 1.6 rad of the drive's shaft"),
        (
            "kp_N_m_per_rad: 0.05",
            "kp_N_m_per_rad: 0.6",
            "motor_driver.kp_N_m_per_rad: is 0.6, but the largest value of its field is 0.5",
        ),
    ],
)
def test_a_rig_that_a_mini_cheetah_drive_can_not_take(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, old: str, new: str, told: str
) -> None:
    text = ODRIVE.with_name("mit.yaml").read_text(encoding="utf-8")
    assert text.count(old) == 1
    rig = tmp_path / "rig.yaml"
    rig.write_text(text.replace(old, new), encoding="utf-8")
    assert told in refused(capsys, "check", str(rig))


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
        ("watchdog_s: 0.1", "watchdog_s: 1.0", "motor_driver.watchdog_s: is 1 s, but the service tests the timeout"),
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
        cli.main(["run", "--rig", str(rig), *channel, "--duration", "2", "--out", str(tmp_path / "out"), "--overwrite"])
    assert ended.value.code == 0
    age_us = json.loads((tmp_path / "out" / "run.json").read_text())["timing"]["age"]["p50_us"]
    assert age_us > 10_000.0


MOTEUS = ODRIVE.with_name("moteus.yaml")


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("transport: fd", "transport: classic", "bench.transport: is classic, but a moteus supports only CAN FD"),
        ("node_id: 5", "node_id: 0", "motor_driver.node_id: is 0, but the nodes of the profile moteus are 1 to 126"),
    ],
)
def test_run_refuses_what_a_moteus_can_not_have(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, old: str, new: str, told: str
) -> None:
    text = MOTEUS.read_text(encoding="utf-8")
    assert old in text
    rig = tmp_path / "rig.yaml"
    rig.write_text(text.replace(old, new), encoding="utf-8")
    virtual = ("--interface", "virtual_forceps", "--channel", "profiles")
    said = refused(capsys, "run", "--rig", str(rig), *virtual, "--out", str(tmp_path / "out"))
    assert told in said
    assert not (tmp_path / "out").exists()


def test_the_simulated_process_has_a_servo_on_a_serial_line_alone(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--rig", str(DYNAMIXEL), "--interface", "virtual", "--channel", "profiles", "--duration", "0.1"]
    assert process.main(arguments) == 2
    assert "dynamixel is on a serial line; give --serial-pty LINK" in capsys.readouterr().err
