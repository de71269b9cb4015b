"""What goes wrong at a bench, with each maker's drive: one line that says it, no torque, a whole recording.

Two drives with one id destroy each other's frames where these differ, as on a real bus; where both get through, one
answers more often than it is asked.
"""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from firmware_protocol.frames import Frame
from hil_forceps.cli import main as cli
from hil_forceps.data.recording.reader import read_recording
from virtual_bus.drives import cia402 as simulated_cia402
from virtual_bus.drives.registry import SIMULATED_DRIVES

CONFIGS = Path(__file__).parents[3] / "configs" / "drives"
CASES = ("mode", "gear sign", "node id", "firmware", "one id", "silence", "reset")


class Row(NamedTuple):
    """A drive, what is wrong with it, and what has to be said."""

    profile: str
    case: str
    said: str
    made: Callable[[Any], object] = lambda _: None  # done to the drive before it is on the bus
    running: Callable[[Any, int], object] | None = None  # and while it runs
    host: tuple[tuple[str, str], ...] = ()  # other lines of the host's rig
    both: tuple[tuple[str, str], ...] = ()  # of that and of the drive's
    drives: int = 1
    twice: bool = False  # it says everything twice
    is_confirmed: bool = True  # the drive says itself that it has no torque

    @property
    def name(self) -> str:
        return f"{self.profile}, {self.case}"


def mute(drive: Any, _: int = 0) -> None:
    drive.is_mute = True


def stays_in_mode_1(drive: Any) -> None:
    refresh = drive._refresh

    def refreshed() -> None:
        refresh()
        drive.objects[0x6061, 0] = 1

    drive._refresh = refreshed


def lacks_its_current(drive: Any) -> None:
    objection = drive._objection
    drive._objection = lambda index, subindex, value: (
        simulated_cia402._NO_MAPPING if value == 0x30D10220 else objection(index, subindex, value)
    )


def is_deaf_to_special(drive: Any) -> None:
    drive._obey = lambda *_: None


def is_calibrated(drive: Any) -> None:
    drive.state = 4


def is_driven_by_another(drive: Any) -> None:
    drive.mode = 10


def is_of_another_model(drive: Any) -> None:
    drive.table.put(0, 1060)


def goes_to_another_mode(drive: Any, _: int) -> None:
    drive.table.put(64, 0)
    drive.table.put(11, 1)


def answers_nothing(drive: Any) -> None:
    drive._packet = lambda *_: None


def restarts_for_20_ms(drive: Any, now_ns: int) -> None:
    drive.reset()
    drive.deaf_until_ns = now_ns + 20_000_000


GEAR = "the gate denies the measured angle: DENIED_CLOSED; check whether it is within `limits:`"
NOBODY = "no drive answered"
LOST = "the drive sent no more samples or restarted"
DAMIAO = (("mit_variant: bgkatz", "mit_variant: damiao"),)
OTHER_NODE = (("node_id: 5", "node_id: 6"),)
TABLE = (
    Row("odrive", "mode", "is calibrating or homing (axis state 4)", is_calibrated, is_confirmed=False),
    Row("odrive", "gear sign", GEAR),
    Row("odrive", "node id", NOBODY, host=OTHER_NODE),
    Row("odrive", "firmware", "", host=(("firmware: 0.6", "firmware: 0.5"),)),  # the same frames but for error bits
    Row("odrive", "one id", "another drive has the same node id", twice=True),
    Row("odrive", "one id", "the drive has a latched fault", drives=2),
    Row("odrive", "silence", LOST, running=mute, is_confirmed=False),
    Row(
        "odrive",
        "reset",
        "the drive left the operational state without a request",
        running=lambda drive, _: setattr(drive, "state", 1),
    ),
    Row("cia402", "mode", "node 5 stays in mode 1 (6061h)", stays_in_mode_1),
    Row("cia402", "gear sign", "error code 0x8130; the gate denied the reference: DENIED_CLOSED"),
    Row("cia402", "node id", NOBODY, host=OTHER_NODE),
    Row("cia402", "firmware", "node 5 refuses 1A01h:01 (abort 0x06040041", lacks_its_current),
    Row("cia402", "one id", "node 5 answers SYNC more than once", twice=True),
    Row("cia402", "silence", LOST, running=mute, is_confirmed=False),
    Row("cia402", "reset", LOST, running=lambda drive, now_ns: drive.reboot(now_ns), is_confirmed=False),
    Row("moteus", "mode", "node 5 is already in mode 10", is_driven_by_another),
    Row("moteus", "gear sign", GEAR),
    Row("moteus", "node id", NOBODY, host=OTHER_NODE),
    Row("moteus", "firmware", "has register map version 4", lambda drive: setattr(drive, "_register_map", 4)),
    Row("moteus", "one id", "node 5 sends more answers than requested", drives=2),
    Row("moteus", "silence", LOST, running=mute, is_confirmed=False),
    Row("moteus", "reset", LOST, running=lambda drive, now_ns: drive.reboot(now_ns)),
    Row("mit", "mode", "the drive did not become operational", is_deaf_to_special, both=DAMIAO),
    Row("mit", "gear sign", GEAR),
    Row("mit", "node id", NOBODY, host=OTHER_NODE),
    Row("mit", "firmware", "answers have 7 bytes; check motor_driver.mit_variant", host=DAMIAO),
    Row("mit", "one id", "node 5 sends more answers than requested", drives=2, is_confirmed=False),
    Row("mit", "silence", LOST, running=mute, is_confirmed=False),
    Row("mit", "reset", LOST, running=restarts_for_20_ms),
    Row("dynamixel", "mode", "left the operational state without a request", running=goes_to_another_mode),
    Row("dynamixel", "gear sign", GEAR),
    Row("dynamixel", "node id", NOBODY, host=OTHER_NODE),
    Row("dynamixel", "firmware", "servo 5 has the unknown model number 1060", is_of_another_model),
    Row("dynamixel", "one id", NOBODY, drives=2),
    Row("dynamixel", "silence", LOST, running=mute, is_confirmed=False),
    Row("dynamixel", "reset", LOST, running=lambda drive, _: drive.restart()),
    Row("vesc", "mode", "node 5 broadcasts its status, but does not answer", answers_nothing),
    Row("vesc", "gear sign", GEAR),
    Row("vesc", "node id", NOBODY, host=OTHER_NODE),
    Row("vesc", "firmware", "update its firmware to 5.03", lambda drive: setattr(drive, "_has_status_bit", False)),
    Row("vesc", "one id", "two VESCs have this id", twice=True),
    Row("vesc", "silence", LOST, running=mute, is_confirmed=False),
    Row("vesc", "reset", LOST, running=lambda drive, now_ns: drive.reboot(now_ns)),
)


def rig_of(folder: Path, name: str, row: Row, changes: tuple[tuple[str, str], ...]) -> Path:
    text = (CONFIGS / f"{row.profile}.yaml").read_text()
    if name == "host" and row.case == "gear sign":
        text, count = re.subn(r"(encoder_rev_per_pulley_rev: +)", r"\1-", text)
        assert count == 1
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / f"{name}.yaml"
    path.write_text(text)
    return path


def set_up(row: Row, monkeypatch: pytest.MonkeyPatch) -> None:
    kind: Any = SIMULATED_DRIVES[row.profile]
    loop, take, receive = kind._loop, kind.take_outbox, kind.receive

    def made(*arguments: Any, **keywords: Any) -> Any:
        drive = kind(*arguments, **keywords)
        row.made(drive)
        return drive

    def looped(self: Any, at_ns: int) -> None:
        is_due = self.zero_ns is not None and at_ns >= self.zero_ns + 300_000_000
        if row.running is not None and is_due and not hasattr(self, "has_happened"):
            self.has_happened = True
            row.running(self, at_ns)
        loop(self, at_ns)

    def taken(self: Any) -> list[Frame]:
        frames: list[Frame] = take(self)
        return [] if hasattr(self, "is_mute") else frames * 2 if row.twice else frames

    def received(self: Any, frame: Frame, now_ns: int) -> None:
        if now_ns >= getattr(self, "deaf_until_ns", 0):
            receive(self, frame, now_ns)

    monkeypatch.setitem(SIMULATED_DRIVES, row.profile, made)
    monkeypatch.setattr(kind, "_loop", looped)
    monkeypatch.setattr(kind, "take_outbox", taken)
    monkeypatch.setattr(kind, "receive", received)


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row.name)
def test_one_line_says_what_is_wrong(
    row: Row, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    set_up(row, monkeypatch)
    drives = ",".join(str(rig_of(tmp_path, f"drive{place}", row, row.both)) for place in range(row.drives))
    host = rig_of(tmp_path, "host", row, row.host + row.both)
    arguments = ["run", "--rig", str(host), "--interface", "virtual_forceps", "--channel", str(tmp_path)]
    with pytest.raises(SystemExit) as ended:
        cli.main([*arguments, "--option", f"rig={drives}", "--duration", "1", "--out", str(tmp_path / "out")])
    lines = [line for line in capsys.readouterr().err.splitlines() if not line.startswith(("note: ", "  "))]
    result = json.loads((tmp_path / "out" / "run.json").read_text())
    recording = read_recording(tmp_path / "out" / "run.mcap")
    assert recording.notes == ()
    assert recording.result["reason"] == result["reason"]
    assert len(recording.samples) == result["counters"]["pipeline"]["samples"]
    assert result["drive_disabled"] is row.is_confirmed
    if not row.said:
        assert (ended.value.code or 0, lines) == (0, [])
        return
    assert ended.value.code == 2
    (line,) = lines
    assert row.said in line
    if row.running is not None:
        assert len(recording.samples) > 100  # all up to what happened
    else:
        assert result["reason"] not in {"completed", "drive_stopped"}


def test_every_drive_has_every_case() -> None:
    assert {(row.profile, row.case) for row in TABLE} == {(name, case) for name in SIMULATED_DRIVES for case in CASES}
