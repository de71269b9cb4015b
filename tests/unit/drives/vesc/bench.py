"""A VESC's machine in ticks of 2 ms, with answers made by hand."""

import binascii
import struct
from collections.abc import Callable

from firmware_protocol.frames import Frame
from firmware_protocol.scales import ANGLE_LSB_PER_REV
from firmware_protocol.states import HostPhase
from hil_forceps.drives.vesc.machine import Vesc, VescConfig
from hil_forceps.drives.vesc.turns import TurnsConfig

NODE, HOST, MS = 5, 253, 1_000_000
TURNS = TurnsConfig(low_rev=-0.2, high_rev=0.6, speed_rev_per_s=10.0, period_ns=2 * MS, count_rev=1e-4)
CONFIG = VescConfig(NODE, 1.0, 0.0, 100 * MS, TURNS)
SET_CURRENT, SET_POS, REQUEST = 1, 4, 8
asked = [0x218020]  # the mask of the last request, which an answer has too


def answer(
    position_deg: float = 36.0,
    current: int = 0,
    fault: int = 0,
    status: int = 0,
    node: int = NODE,
    *,
    cut: int = 0,
) -> list[Frame]:
    """The frames of an answer; `current` in hundredths of an ampere."""
    data = struct.pack(">BIiBiB", 50, asked[0], current, fault, round(position_deg * 1e6), status)
    data = data[: len(data) - cut]
    parts = [Frame(5 << 8 | HOST, bytes((at,)) + data[at : at + 7], is_extended=True) for at in range(0, len(data), 7)]
    end = struct.pack(">BBHH", node, 1, len(data), binascii.crc_hqx(data, 0))
    return [*parts, Frame(7 << 8 | HOST, end, is_extended=True)]


class Bench:
    """A machine with a VESC that answers each request a millisecond later, as `says` tells it; ticks of 2 ms."""

    def __init__(self, config: VescConfig = CONFIG) -> None:
        self.drive = Vesc(config)
        self.now_ms = 0
        self.fed_ms = -1000
        self.timeout_ms = 100
        self.says: Callable[[], list[Frame]] = lambda: answer(status=self.has_timeout())
        self.raw: int | None = None  # what the service asks for
        self.sent: list[Frame] = []

    def has_timeout(self) -> int:
        return int(self.timeout_ms > 0 and self.now_ms // 10 * 10 - self.fed_ms > self.timeout_ms)

    def tick(self, count: int = 1) -> list[Frame]:
        """What goes out in some ticks, without the requests."""
        sent: list[Frame] = []
        for _ in range(count):
            self.now_ms += 2
            reference = None if self.raw is None else self.drive.setpoint(self.raw)
            frames = [] if reference is None else [reference]
            frames += self.drive.poll(self.now_ms * MS)
            for frame in frames:
                assert frame.is_extended
                assert frame.arbitration_id & 0xFF == NODE
                if command(frame) in {SET_CURRENT, SET_POS}:
                    self.fed_ms = self.now_ms + 1
                    sent.append(frame)
                elif command(frame) == REQUEST:
                    (asked[0],) = struct.unpack_from(">I", frame.data, 3)
                    self.hear(*self.says())
        self.sent += sent
        return sent

    def hear(self, *frames: Frame) -> None:
        for at, frame in enumerate(frames):
            self.drive.receive(frame, (self.now_ms + 1) * MS + at * 100_000)

    def ready(self) -> "Bench":
        self.drive.connect(0)
        self.tick(100)
        assert self.drive.phase is HostPhase.READY
        self.drive.take_samples()
        self.sent = []
        return self

    def running(self) -> "Bench":
        self.ready()
        self.drive.enable()
        self.raw = round(0.1 * ANGLE_LSB_PER_REV)
        self.tick(12)
        assert self.drive.phase.name == "RUNNING"
        return self


def command(frame: Frame) -> int:
    return frame.arbitration_id >> 8


def position_deg(frame: Frame) -> float:
    return float(struct.unpack(">i", frame.data)[0]) / 1e6
