"""A CiA 402 drive's machine in ticks of 1 ms, with answers made by hand."""

import struct
from collections.abc import Iterable

from firmware_protocol.frames import Frame
from firmware_protocol.states import HostPhase
from hil_forceps.drives.cia402 import messages as wire
from hil_forceps.drives.cia402.machine import Cia402
from hil_forceps.drives.cia402.messages import State
from hil_forceps.drives.cia402.objects import Cia402Config

NODE, MS = 5, 1_000_000
CONFIG = Cia402Config(NODE, 16384.0, 0.0, MS, 100 * MS)
STATUS = {state: bits for state in State for _, bits in [state.value]}


def position(counts: int, state: State, mode: int = 8) -> Frame:
    return Frame(0x180 + NODE, struct.pack("<ihb", counts, STATUS[state], mode))


def current(milliamperes: int) -> Frame:
    return Frame(0x280 + NODE, struct.pack("<i", milliamperes))


def answer(request: Frame, device_type: int = 0x20192) -> Frame:
    """What a server says that takes everything."""
    command, index, subindex = struct.unpack_from("<BHB", request.data)
    if command == 0x40:
        return Frame(0x580 + NODE, struct.pack("<BHBI", 0x43, index, subindex, device_type))
    return Frame(0x580 + NODE, struct.pack("<BHB4x", 0x60, index, subindex))


def set_up(config: Cia402Config = CONFIG) -> tuple[Cia402, list[Frame], int]:
    """Return a drive that has been set up, what was sent to it, and the next tick in ms."""
    drive = Cia402(config)
    drive.connect(0)
    sent: list[Frame] = []
    for n in range(100):
        frames = drive.poll(n * MS)
        sent += frames
        for frame in frames:
            if frame.arbitration_id == 0x600 + NODE:
                drive.receive(answer(frame), n * MS)
            if frame == wire.nmt(wire.Nmt.START, NODE):
                return drive, sent, n + 1
    raise AssertionError(drive.phase)


def tick(drive: Cia402, n: int, state: State, raw: int = 1000, counts: int = 1) -> list[Frame]:
    """What the drive says to the last SYNC, then what goes out, as the service asks for it."""
    drive.receive(position(counts, state), n * MS)
    drive.receive(current(100), n * MS)
    reference = drive.setpoint(raw)
    return ([] if reference is None else [reference]) + drive.poll(n * MS)


def ready() -> tuple[Cia402, int]:
    drive, _, n = set_up()
    drive.poll(n * MS)
    tick(drive, n + 1, State.SWITCH_ON_DISABLED)
    assert drive.phase is HostPhase.READY
    return drive, n + 2


def running() -> tuple[Cia402, int]:
    drive, n = ready()
    drive.enable()
    for state in (State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.OPERATION_ENABLED):
        tick(drive, n, state)
        n += 1
    assert drive.phase is HostPhase.RUNNING
    return drive, n


def controls(frames: Iterable[Frame]) -> list[int]:
    return [struct.unpack_from("<H", frame.data)[0] for frame in frames if frame.arbitration_id == 0x200 + NODE]


def boot_up() -> Frame:
    return Frame(0x700 + NODE, b"\x00")
