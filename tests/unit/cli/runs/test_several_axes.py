"""Two drives on one bus in one service: one fails and the other stops or goes on; what can't be is told."""

import json
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol.messages import DriveState
from hil_forceps.bridge.pipeline import NOWHERE_NS
from hil_forceps.cli import main as cli
from hil_forceps.data.recording.reader import read_recording
from hil_forceps.drives.promises import Promises, damage
from hil_forceps.drives.registry import PROFILES
from hil_forceps.rig import load_rig
from virtual_bus.drives.cia402 import SimulatedCia402
from virtual_bus.drives.odrive import SimulatedODrive
from virtual_bus.drives.vesc import SimulatedVesc

DRIVES = Path(__file__).parents[4] / "configs" / "drives"


def rigs_in(folder: Path, *, node: int = 6) -> tuple[Path, Path]:
    """Two ODrives; the second with another node."""
    text = (DRIVES / "odrive.yaml").read_text(encoding="utf-8")
    left, right = folder / "left.yaml", folder / "right.yaml"
    left.write_text(text, encoding="utf-8")
    right.write_text(text.replace("node_id: 5", f"node_id: {node}"), encoding="utf-8")
    return left, right


def run(folder: Path, *rigs: Path, more: tuple[str, ...] = ()) -> int:
    named = [part for rig in rigs for part in ("--rig", str(rig))]
    channel = [
        "--interface",
        "virtual_forceps",
        "--channel",
        str(folder),
        "--option",
        f"rig={','.join(map(str, rigs))}",
    ]
    with pytest.raises(SystemExit) as ended:
        cli.main(["run", *named, *channel, "--duration", "3", "--out", str(folder / "out"), *more])
    return int(ended.value.code or 0)


def told(folder: Path, name: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "out" / name / "run.json").read_text())
    return found


def test_two_axes_run_on_one_bus_with_nothing_lost(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(tmp_path, *rigs_in(tmp_path)) == 0
    said = capsys.readouterr()
    assert "2 axes load the line by 81 % at worst" in said.err
    for name in ("left", "right"):
        result = told(tmp_path, name)
        assert (result["reason"], result["drive_disabled"]) == ("completed", True)
        assert result["counters"]["host"]["samples"] >= 3000
        # What was on the bus is what was foretold, but for the way in and out.
        assert 0.75 < result["bus_share_at_most"] <= 0.81
        with pytest.raises(SystemExit) as ended:
            cli.main(["replay", str(tmp_path / "out" / name)])
        assert not ended.value.code
    # Each has the references of its own samples: nodes are not mixed up.
    left, right = (read_recording(tmp_path / "out" / name / "run.mcap").samples for name in ("left", "right"))
    assert (left["current_A"][:3000] != right["current_A"][:3000]).mean() > 0.5  # their noise is another


def test_axes_may_speak_different_protocols(tmp_path: Path) -> None:
    first = DRIVES / "odrive.yaml"
    other = tmp_path / "other.yaml"
    phase = load_rig(first).bench.host_phase_s
    other.write_text((DRIVES / "cia402.yaml").read_text().replace("host_phase_s: 5.0e-4", f"host_phase_s: {phase}"))
    assert run(tmp_path, first, other) == 0
    assert told(tmp_path, "odrive")["reason"] == told(tmp_path, "other")["reason"] == "completed"


@pytest.mark.parametrize("go_on", [False, True])
def test_one_axis_fails(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, go_on: bool
) -> None:
    loop = SimulatedODrive._loop

    def fails(self: SimulatedODrive, at_ns: int) -> None:
        if self._settings.node_id == 6 and self.zero_ns is not None and at_ns == self.zero_ns + 1_000_000_000:
            self._fail(0x40)
        loop(self, at_ns)

    monkeypatch.setattr(SimulatedODrive, "_loop", fails)
    assert run(tmp_path, *rigs_in(tmp_path), more=("--go-on",) if go_on else ()) == 2
    said = capsys.readouterr()
    left, right = told(tmp_path, "left"), told(tmp_path, "right")
    assert (right["reason"], right["drive_disabled"]) == ("drive_fault", True)
    assert "right: the drive latched a fault" in said.err
    assert left["drive_disabled"] is True
    samples = read_recording(tmp_path / "out" / "left" / "run.mcap").samples["stamp_ns"]
    if go_on:
        assert left["reason"] == "completed"
        assert len(samples) > 3000
    else:
        assert left["reason"] == "other_axis"
        assert "left: stopped, because axis right ended: the drive latched a fault" in said.err
        assert len(samples) < 2000


def test_what_does_not_go_together_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    left, right = rigs_in(tmp_path, node=5)
    assert run(tmp_path, left, right) == 2
    assert "left and right use the same ids, such as 0A0h; change one node id" in capsys.readouterr().err
    right.write_text(right.read_text().replace("host_period_s: 1.0e-3", "host_period_s: 2.0e-3"), encoding="utf-8")
    assert run(tmp_path, left, right) == 2
    assert "bench.host_period_s: is 0.001 in left, 0.002 in right" in capsys.readouterr().err
    (tmp_path / "b").mkdir()
    twin = tmp_path / "b" / "left.yaml"
    twin.write_text(left.read_text(), encoding="utf-8")
    assert run(tmp_path, left, twin) == 2
    assert "another rig file is also named left" in capsys.readouterr().err


def test_a_full_bus_is_told_before_anything_is_opened(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    left, right = rigs_in(tmp_path)
    third = tmp_path / "third.yaml"
    third.write_text(right.read_text().replace("node_id: 6", "node_id: 7"), encoding="utf-8")
    assert run(tmp_path, left, right, third) == 2
    assert "3 axes load the line by 122 % at worst; 90 % is reached at 738 Hz" in capsys.readouterr().err


def twins(folder: Path, profile: str) -> tuple[Path, Path]:
    """Two drives of a profile; the adapter of 0.1 ms is what two EPOS4 take for 1 kHz."""
    text = (DRIVES / f"{profile}.yaml").read_text(encoding="utf-8").replace("latency_s: 1.5e-4", "latency_s: 1.0e-4")
    assert "latency_s: 1.0e-4" in text
    left, right = folder / "left.yaml", folder / "right.yaml"
    left.write_text(text, encoding="utf-8")
    right.write_text(text.replace("node_id: 5", "node_id: 6"), encoding="utf-8")
    return left, right


@pytest.mark.parametrize(
    ("profile", "samples", "foretold", "least"),
    [("cia402", 3000, 73, 0.70), ("vesc", 1500, 89, 0.75)],  # an EPOS4 at 1 kHz, a VESC at 500 Hz
)
def test_two_drives_whose_bus_has_something_in_common(
    profile: str, samples: int, foretold: int, least: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """SYNC for both from one; answers to a host's id each. Nothing is lost, and each axis has its own samples."""
    assert run(tmp_path, *twins(tmp_path, profile)) == 0
    assert f"2 axes load the line by {foretold} % at worst" in capsys.readouterr().err
    for name in ("left", "right"):
        result = told(tmp_path, name)
        assert (result["reason"], result["drive_disabled"]) == ("completed", True)
        host = result["counters"]["host"]
        assert host["samples"] >= samples
        assert not any(damage(host, promises(tmp_path / f"{name}.yaml")).values())
        assert host.get("syncs_withheld", 0) == 0
        assert least < result["bus_share_at_most"] <= foretold / 100.0 + 0.005
        with pytest.raises(SystemExit) as ended:
            cli.main(["replay", str(tmp_path / "out" / name)])
        assert not ended.value.code
    left, right = (read_recording(tmp_path / "out" / name / "run.mcap").samples for name in ("left", "right"))
    if profile == "cia402":  # stamps of both are those of the same SYNCs
        assert set(right["stamp_ns"]) <= set(left["stamp_ns"])
    assert (left["theta_m_rad"][:1000] != right["theta_m_rad"][:1000]).mean() > 0.1  # their noise is another


def promises(path: Path) -> Promises:
    rig = load_rig(path)
    assert rig.motor_driver is not None
    return PROFILES[rig.drive_profile].promises(rig, rig.motor_driver)


def reboots(drive: Any, now_ns: int) -> None:
    drive.reboot(now_ns)


def falls_silent(drive: Any, now_ns: int) -> None:
    del now_ns
    drive._send = lambda *_: None


@pytest.mark.parametrize("go_on", [False, True])
@pytest.mark.parametrize("profile", ["cia402", "vesc"])
@pytest.mark.parametrize("accident", [reboots, falls_silent])
def test_one_of_two_such_drives_fails(
    accident: Any, profile: str, go_on: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kind: Any = {"cia402": SimulatedCia402, "vesc": SimulatedVesc}[profile]
    loop = kind._loop

    def fails(self: Any, at_ns: int) -> None:
        is_due = self.node == 6 and self.zero_ns is not None and at_ns >= self.zero_ns + 1_000_000_000
        if is_due and not hasattr(self, "has_failed"):
            self.has_failed = True
            accident(self, at_ns)
        loop(self, at_ns)

    monkeypatch.setattr(kind, "_loop", fails)
    assert run(tmp_path, *twins(tmp_path, profile), more=("--go-on",) if go_on else ()) == 2
    left, right = told(tmp_path, "left"), told(tmp_path, "right")
    assert right["reason"] == "drive_lost"
    assert left["drive_disabled"] is True
    assert left["reason"] == ("completed" if go_on else "other_axis")
    stamps = read_recording(tmp_path / "out" / "left" / "run.mcap").samples["stamp_ns"]
    if go_on:  # what the other EPOS4 did not answer holds SYNC up twice for 20 ms, and no longer
        assert sum((stamps[1:] - stamps[:-1]) > 10_000_000) == (2 if profile == "cia402" else 0)


def test_more_drives_than_a_host_has_ids_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (DRIVES / "cia402.yaml").read_text(encoding="utf-8")
    rigs = []
    for node in range(1, 10):
        rigs.append(tmp_path / f"axis{node}.yaml")
        rigs[-1].write_text(text.replace("node_id: 5", f"node_id: {node}"), encoding="utf-8")
    assert run(tmp_path, *rigs) == 2
    assert "9 drives on one bus; the profile supports at most 8" in capsys.readouterr().err


@pytest.mark.parametrize("profile", ["cia402", "vesc"])
def test_two_drives_with_one_id_are_told(profile: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    left, right = twins(tmp_path, profile)
    right.write_text(left.read_text(), encoding="utf-8")
    assert run(tmp_path, left, right) == 2
    assert "left and right use the same ids" in capsys.readouterr().err


def test_an_odrive_on_the_id_of_sync_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = tmp_path / "other.yaml"
    other.write_text((DRIVES / "odrive.yaml").read_text().replace("node_id: 5", "node_id: 4"), encoding="utf-8")
    assert run(tmp_path, DRIVES / "cia402.yaml", other) == 2
    assert "cia402 and other use the same ids, such as 080h" in capsys.readouterr().err


def test_every_profile_says_which_ids_it_uses() -> None:
    for profile in PROFILES.values():
        if profile.link == "can":
            assert profile.ids.__module__ == profile.machine.__module__, profile.name


def states_of(folder: Path, name: str) -> list[int]:
    return sorted(set(read_recording(folder / "out" / name / "run.mcap").samples["state"].tolist()))


def test_no_axis_gets_torque_while_another_drive_is_missing(tmp_path: Path) -> None:
    """It once moved for as long as the other was searched for."""
    left, right = rigs_in(tmp_path)
    deaf = tmp_path / "deaf.yaml"
    deaf.write_text(right.read_text().replace("node_id: 6", "node_id: 9"), encoding="utf-8")
    named = ("--rig", str(left), "--rig", str(deaf), "--interface", "virtual_forceps", "--channel", str(tmp_path))
    with pytest.raises(SystemExit) as ended:
        cli.main(["run", *named, "--option", f"rig={left},{right}", "--duration", "3", "--out", str(tmp_path / "out")])
    assert ended.value.code == 2
    assert told(tmp_path, "deaf")["reason"] == "no_drive"
    first = told(tmp_path, "left")
    assert (first["reason"], first["drive_disabled"]) == ("other_axis", True)
    assert states_of(tmp_path, "left") == [DriveState.DISABLED]
    assert len(read_recording(tmp_path / "out" / "left" / "run.mcap").references) == 0


def test_no_axis_moves_while_another_is_enabled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The right drive goes on saying that it is idle; the left one holds the angle at which it became operational."""
    request = SimulatedODrive._request

    def stays_idle(self: SimulatedODrive, state: int) -> None:
        if self._settings.node_id != 6:
            request(self, state)

    monkeypatch.setattr(SimulatedODrive, "_request", stays_idle)
    assert run(tmp_path, *rigs_in(tmp_path)) == 2
    left, right = told(tmp_path, "left"), told(tmp_path, "right")
    assert (left["reason"], right["reason"]) == ("other_axis", "enable_failed")
    references = read_recording(tmp_path / "out" / "left" / "run.mcap").references
    assert (references["trajectory_ns"] == NOWHERE_NS).all()
    held = references[references["requested_rad"] == references["requested_rad"][-1]]
    assert len(held) > 500
    with pytest.raises(SystemExit) as ended:
        cli.main(["replay", str(tmp_path / "out" / "left")])
    assert not ended.value.code
