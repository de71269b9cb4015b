"""The drive's process as far as it needs no clock: lines that can't be done, transports that fail, its drive."""

import os
from pathlib import Path

import can
import pytest

from firmware_protocol.frames import Frame
from hil_forceps.rig import load_rig
from virtual_bus.drive import SimulatedDrive
from virtual_bus.realtime import process
from virtual_bus.realtime.transports import CanTransport, open_can

CONFIGS = Path(__file__).resolve().parents[4] / "configs"
RIG = CONFIGS / "paper.yaml"
ODRIVE = CONFIGS / "drives" / "odrive.yaml"


def code_of(arguments: list[str]) -> int:
    """Return how the process would end; its parser ends by itself."""
    try:
        return process.main(arguments)
    except SystemExit as ended:
        return int(str(ended.code))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--rig", "none.yaml", "--serial-pty", "p"], "none.yaml"),
        (["--rig", str(RIG), "--interface", "no_such", "--channel", "x"], "no_such"),
        (["--rig", str(RIG), "--interface", "udp_multicast"], "--channel"),
        (["--rig", str(RIG), "--interface", "udp_multicast", "--channel", "10.0.0.1"], "10.0.0.1"),
        (["--rig", str(RIG), "--serial-pty", "/no/such/place/port"], "/no/such/place/port"),
        (["--rig", str(RIG), "--serial-pty", "p", "--faults", "none.yaml"], "none.yaml"),
        (["--rig", str(RIG), "--serial-pty", "p", "--channel", "x"], "--channel"),
        (["--rig", str(RIG), "--interface", "virtual", "--channel", "x", "--option", "a"], "KEY=VALUE"),
        (["--rig", str(RIG)], "--interface"),
        (["--rig", str(RIG), "--serial-pty", "p", "--duration", "-1"], "duration"),
        (["--rig", str(ODRIVE), "--serial-pty", "p"], "odrive is on a CAN bus; give --interface and --channel"),
    ],
)
def test_what_can_not_be_done_is_told_in_a_line(
    arguments: list[str],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert code_of(arguments) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert words in said.err.splitlines()[-1]
    assert list(tmp_path.iterdir()) == []


def test_its_load_restarts_with_every_run() -> None:
    """The drive listens on while runs come and go; the load of each begins with its first operational sample."""
    drive = process._drive(load_rig(RIG), 2, 0, is_fd=False)
    assert isinstance(drive, SimulatedDrive)
    assert drive._load_restarts


def test_errors_that_have_a_remedy_name_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails_with(error: Exception) -> None:
        def open_bus(**_: object) -> None:
            raise error

        monkeypatch.setattr(can, "Bus", open_bus)

    cases = [
        ("udp_multicast", can.CanInitializationError("could not create or configure socket"), 19, "ip route add"),
        ("udp_multicast", can.CanInterfaceNotImplementedError("msgpack not installed"), None, "python-can[multicast]"),
        ("socketcan", OSError(97, "Address family not supported"), None, "this kernel has no CAN"),
        ("socketcan", OSError(19, "No such device"), None, "ip link add"),
    ]
    for interface, error, cause, remedy in cases:
        if cause is not None:
            error.__cause__ = OSError(cause, os.strerror(cause))
        fails_with(error)
        with pytest.raises(Exception, match="^" + interface) as caught:
            open_can(interface, "x", False, {})
        assert remedy in str(caught.value)


class DeadBus(can.BusABC):
    """A bus that has gone: everything fails."""

    def __init__(self) -> None:
        super().__init__("dead")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002
        raise can.CanOperationError("gone")

    def recv(self, timeout: float | None = None) -> can.Message | None:  # noqa: ARG002
        raise can.CanOperationError("gone")


def test_a_bus_that_fails_is_counted_not_raised() -> None:
    transport = CanTransport(DeadBus())
    transport.send([Frame(1, b""), Frame(2, b"")])
    assert transport.receive(0.001) == []
    assert transport.counters == {"send_failed": 2, "receive_failed": 1, "not_ours": 0}
    transport.close()
