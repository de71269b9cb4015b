"""Small nodes in place of the drive, on the python-can interface in virtual time."""

from collections import deque
from pathlib import Path

import can

from firmware_protocol.frames import Frame
from virtual_bus.bus.faults import FOREVER_NS

ROOT = Path(__file__).resolve().parents[3]
MS = 1_000_000


class Clockwork:
    """Sends a numbered frame every millisecond; answers 0x41 with 0xA1 and the same data."""

    def __init__(self, period_ns: int = MS) -> None:
        self.period_ns = period_ns
        self.next_ns = period_ns
        self.number = 0
        self.outbox: deque[Frame] = deque()
        self.heard: list[tuple[int, Frame]] = []

    def receive(self, frame: Frame, now_ns: int) -> None:
        self.heard.append((now_ns, frame))
        if frame.arbitration_id == 0x41:
            self.outbox.append(Frame(0xA1, frame.data))

    def next_wake_ns(self) -> int:
        return self.next_ns

    def wake(self, now_ns: int) -> None:
        self.number += 1
        self.next_ns = now_ns + self.period_ns
        self.outbox.append(Frame(0x81, self.number.to_bytes(8, "little")))

    def take_outbox(self) -> list[Frame]:
        frames = list(self.outbox)
        self.outbox.clear()
        return frames


class Mute(Clockwork):
    def __init__(self) -> None:
        super().__init__(FOREVER_NS)


def message(arbitration_id: int, data: bytes = b"", **more: bool) -> can.Message:
    return can.Message(arbitration_id=arbitration_id, data=data, is_extended_id=more.pop("extended", False), **more)
