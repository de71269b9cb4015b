"""The world outside a firmware, as its clock: the truth plant on one side, the host's link and clock on the other.

A drive sample is one request over the plant's line (firmware_protocol/c/host/lockstep.c): what the sensors read,
answered by the current to hold. The firmware takes all frames that the host has sent before, and the host gets all
that the firmware sent with the sample, so a run is the same each time, however slow lines, emulator and machine are.
Only the latencies are of the wall clock. The jaw's sensors, which no firmware has, are sent by the world itself.
"""

import socket
import struct
import time
from collections.abc import Mapping
from typing import Final, Protocol

from firmware_protocol import codec
from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState
from firmware_protocol.scales import SEQUENCE_MODULUS
from hil_forceps.bridge.ports import Link, Received, SendResult
from virtual_bus.plant.forceps import SimulatedForceps

PATIENCE_S: Final = 10.0
ANSWER_BYTES: Final = 8
_REQUEST: Final = struct.Struct("<IiiI")
_ANSWER: Final = struct.Struct("<fBBBB")
_SAMPLE, _FRAMES = 1, 2


class PlantLine(Protocol):
    """Where the firmware takes its plant from."""

    def exchange(self, request: bytes) -> bytes:
        """Send a request and wait for its answer; OSError when none comes."""


class UdpPlantLine:
    """A request a datagram, as the process has it."""

    def __init__(self, address: tuple[str, int]) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(address)
        self._socket.settimeout(PATIENCE_S)

    def exchange(self, request: bytes) -> bytes:
        self._socket.send(request)
        return self._socket.recv(64)

    def close(self) -> None:
        self._socket.close()


class LockstepWorld:
    """A `Link` and its `Clock` in virtual time, with the firmware behind `inner` and its plant behind `line`."""

    def __init__(self, inner: Link, line: PlantLine, forceps: SimulatedForceps, node: int, period_ns: int) -> None:
        self.exchange_us: list[float] = []  # a sample asked of the firmware until its frames were with the host
        self.samples = 0
        self._inner, self._line, self._forceps = inner, line, forceps
        self._node, self._period_ns = node, period_ns
        self._now_ns = 0
        self._next_ns = 0
        self._sent = self._received = 0  # frames
        self._waiting: list[Received] = []
        self._zero_ns: int | None = None

    @property
    def counters(self) -> Mapping[str, int]:
        return self._inner.counters

    def now_ns(self) -> int:
        return self._now_ns

    def sleep_until_ns(self, time_ns: int) -> None:
        while self._next_ns <= time_ns:
            self._sample(self._next_ns)
            self._next_ns += self._period_ns
        self._now_ns = max(self._now_ns, time_ns)

    def send(self, frame: Frame) -> SendResult:
        result = self._inner.send(frame)
        self._sent += result is SendResult.SENT
        return result

    def receive(self) -> list[Received]:
        waiting, self._waiting = self._waiting, []
        return waiting

    def is_up(self) -> bool:
        return self._inner.is_up()

    def close(self) -> None:
        self._inner.close()

    def _sample(self, at_ns: int) -> None:
        reading = self._forceps.read(at_ns)
        what = _SAMPLE | _FRAMES | (self._sent & 0xFF) << 8
        asked_ns = time.perf_counter_ns()
        now_us = at_ns // 1_000 & 0xFFFF_FFFF
        answer = self._line.exchange(_REQUEST.pack(now_us, reading.theta_m, reading.current, what))
        current_A, state, _, _, sent = _ANSWER.unpack(answer)
        self._take(at_ns, sent)
        self.exchange_us.append((time.perf_counter_ns() - asked_ns) * 1e-3)
        if state == DriveState.OPERATIONAL and self._zero_ns is None:
            self._zero_ns = at_ns
            self._forceps.start_load(at_ns)
        bench = codec.encode_bench_sensor(self._node, reading.theta_j, reading.tau_w, self.samples % SEQUENCE_MODULUS)
        self._waiting.append(Received(at_ns, bench))
        self._forceps.hold(at_ns, at_ns + self._period_ns, current_A)
        self.samples += 1

    def _take(self, at_ns: int, sent: int) -> None:
        """Take from the link until all is there that the firmware has sent."""
        end_s = time.monotonic() + PATIENCE_S
        while (self._received ^ sent) & 0xFF:
            frames = self._inner.receive()
            self._received += len(frames)
            self._waiting += [Received(at_ns, frame) for _, frame in frames]
            if not frames and (time.monotonic() > end_s or not self._inner.is_up()):
                raise AssertionError(f"frames of the firmware are missing: {self._received}, and it says {sent}")
