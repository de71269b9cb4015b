"""An ODrive's machine in ticks, with frames made by hand."""

import struct
from collections.abc import Iterable

from firmware_protocol.frames import Frame
from firmware_protocol.states import HostPhase
from hil_forceps.drives.odrive.machine import FIRST_REFERENCES, ODrive, ODriveConfig

NODE, MS = 5, 1_000_000
CONFIG = ODriveConfig(NODE, "0.6", 1.0, 0.0, 100.0, 1.0, MS, MS)
IDLE, CLOSED_LOOP = 1, 8


def heartbeat(state: int, error: int = 0) -> Frame:
    return Frame(NODE << 5 | 0x01, struct.pack("<IB3x", error, state))


def estimates(position_rev: float, velocity: float = 0.5) -> Frame:
    return Frame(NODE << 5 | 0x09, struct.pack("<ff", position_rev, velocity))


def iq(measured_A: float) -> Frame:
    return Frame(NODE << 5 | 0x14, struct.pack("<ff", 0.0, measured_A))


def ready(config: ODriveConfig = CONFIG) -> ODrive:
    drive = ODrive(config)
    drive.connect(-100 * MS)
    drive.receive(heartbeat(IDLE), -99 * MS)
    for n in range(-99, 2):
        drive.receive(estimates(0.1), n * MS)
        drive.receive(iq(0.0), n * MS)
    drive.receive(heartbeat(IDLE), MS)
    drive.poll(2 * MS)
    assert drive.phase is HostPhase.READY
    drive.take_samples()
    return drive


def running() -> ODrive:
    drive = ready()
    drive.enable()
    sent = ticks(drive, 2, FIRST_REFERENCES + 1)
    assert sent[-1].arbitration_id == NODE << 5 | 0x07
    drive.receive(heartbeat(CLOSED_LOOP), 9 * MS)
    assert drive.phase is HostPhase.RUNNING
    return drive


def ticks(drive: ODrive, first_ms: int, count: int, raw: int = 1000) -> list[Frame]:
    """What goes out in some ticks, as the service asks for it: the reference, then what is due."""
    sent: list[Frame] = []
    for n in range(count):
        reference = drive.setpoint(raw + n)
        sent += [] if reference is None else [reference]
        sent += drive.poll((first_ms + n) * MS)
    return sent


def commands(frames: Iterable[Frame]) -> list[int]:
    return [frame.arbitration_id & 0x1F for frame in frames]
