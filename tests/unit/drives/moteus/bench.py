"""A moteus' machine in ticks, with answers made by hand."""

import struct
from typing import Any

from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState
from hil_forceps.drives.moteus.machine import Moteus, MoteusConfig
from hil_forceps.drives.moteus.messages import Mode

NODE, MS = 5, 1_000_000
CONFIG = MoteusConfig(NODE, 1.0, 0.0, 0.0135, 0.1, 100 * MS)
IDENTITY = struct.pack("<BBBii", 0x2A, 0x81, 0x02, 0x010100, 5)
MODE_AND = b"\x01\x00"  # a frame that writes the mode begins so


def answer(
    mode: int, ms: int, position: float = 0.1, current: float = 0.0, fault: int = 0, more: bytes = b"", node: int = NODE
) -> Frame:
    data = (
        struct.pack("<BBb", 0x21, 0, mode)
        + struct.pack("<BBff", 0x2E, 1, position, 0.0)
        + struct.pack("<BBf", 0x2D, 4, current)
        + struct.pack("<BBb", 0x21, 0x0F, fault)
        + struct.pack("<BBI", 0x29, 0x70, ms & 0xFFFFFFFF)
        + more
    )
    length = 32 if len(data) <= 32 else 48
    return Frame(node << 8, data.ljust(length, b"\x50"), True, node > 7)


class Session:
    """A machine, tick by tick: what it sends, and what the drive answers to it half a millisecond later."""

    def __init__(self, config: MoteusConfig = CONFIG) -> None:
        self.drive = Moteus(config)
        self.ms = 0
        self.drive.connect(0)

    def tick(self, mode: int | None, raw: int = 1000, **more: Any) -> list[Frame]:
        """Send what is due, and answer it with a mode, or not at all; return what was sent."""
        now_ns = self.ms * MS
        reference = self.drive.setpoint(raw)
        sent = ([] if reference is None else [reference]) + self.drive.poll(now_ns)
        if mode is not None and sent:
            identity = IDENTITY if self.drive.phase.name == "IDENTIFYING" else b""
            reply = answer(mode, self.ms, more=identity, node=self.drive.config.node, **more)
            self.drive.receive(reply, now_ns + MS // 2)
        self.ms += 1
        return sent

    def state(self) -> DriveState | None:
        return self.drive.drive_state

    def ready(self) -> "Session":
        self.tick(Mode.STOPPED)
        assert self.drive.phase.name == "READY"
        return self

    def running(self) -> "Session":
        self.ready()
        self.drive.enable()
        for mode in (Mode.STOPPED, Mode.ENABLING, Mode.CALIBRATING, Mode.POSITION):
            self.tick(mode)
        assert self.drive.phase.name == "RUNNING"
        return self


def commands(frames: list[Frame]) -> list[int]:
    """The modes that frames write; -1 for one that writes none."""
    return [frame.data[2] if frame.data.startswith(MODE_AND) else -1 for frame in frames]
