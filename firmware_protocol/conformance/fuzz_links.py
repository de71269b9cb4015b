"""Fuzzing of the host, alone and at the end of a line: what a drive, a line and a user may do to it."""

import random
from collections.abc import Callable
from typing import Final

from firmware_protocol.conformance.fuzz_source import (
    MAX_PACKET_BYTES,
    NODE,
    SERIAL_NUMBER,
    Finding,
    Outcome,
    mutated,
    random_frame,
    require,
)
from firmware_protocol.drive.machine import DriveConfig, DriveMachine
from firmware_protocol.frames import Frame
from firmware_protocol.host.machine import HostConfig, HostMachine, HostPhase
from firmware_protocol.host.samples import MAX_PENDING_HALVES, MAX_QUEUED_SAMPLES
from firmware_protocol.serial_framing import SerialReader, encode_serial

CONNECT_MS: Final = 2000
NOISE_BYTES: Final = 256  # at once
_CONNECTED: Final = (HostPhase.READY, HostPhase.RUNNING, HostPhase.FAULT)


def fuzz_host(total_bytes: int, seed: int) -> Outcome:
    """Give a host anything between the frames of a good drive, in every phase; its queues stay bounded."""
    chance = random.Random(f"host {seed}")
    fd = bool(seed % 2)
    host = HostMachine(HostConfig(node=NODE, fd=fd))
    drive = DriveMachine(DriveConfig(NODE, SERIAL_NUMBER, fd))
    now_ns = fed = probes = got = 0

    def link(at_ns: int) -> int:
        return _good_link(host, drive, at_ns)

    while fed < total_bytes:
        if chance.random() < 0.3:
            frame = random_frame(chance)
            host.receive(frame, now_ns)
            fed += len(frame.data) + 2
        now_ns += 300_000_000 if chance.random() < 0.001 else 1_000_000
        got += link(now_ns)
        _use(chance, host, now_ns, f"seed {seed}", fed)
        if chance.random() < 0.001:
            now_ns = _connects(host, link, now_ns, f"seed {seed}: no connection at {fed}")
            probes += 1
    return Outcome(fed, probes, got)


class _Line:
    """Host and drive at the ends of two byte streams, each spoiled on its way while `noisy`."""

    def __init__(self, chance: random.Random, host: HostMachine, drive: DriveMachine) -> None:
        self.noisy = True
        self.bytes_in = 0
        self.to_drive, self.to_host = SerialReader(), SerialReader()
        self._chance, self._host, self._drive = chance, host, drive

    def pass_ms(self, now_ns: int) -> int:
        """Let a millisecond pass; return how many frames got through to the host."""
        host, drive, now_us = self._host, self._drive, now_ns // 1000
        sent = host.poll(now_ns)
        reference = host.setpoint(0)
        frames = [*sent, reference] if reference is not None else sent
        answers = drive.poll(now_us)
        for frame in self.to_drive.feed(self._carried(frames)):
            answers += drive.receive(frame, now_us, 0)
        got = self.to_host.feed(self._carried(answers + drive.sample(now_us, 0, 0)))
        for frame in got:
            host.receive(frame, now_ns)
        return len(got)

    def _carried(self, frames: list[Frame]) -> bytes:
        data = b"".join(map(encode_serial, frames))
        if self.noisy and self._chance.random() < 0.3:
            kind = self._chance.randrange(4)
            if kind == 0:
                data = mutated(self._chance, data)
            elif kind == 1:
                data = data[: self._chance.randrange(len(data) + 1)]
            elif kind == 2:
                data += self._chance.randbytes(self._chance.randrange(1, NOISE_BYTES))
            else:
                data += bytes((self._chance.randrange(1, 256),)) * self._chance.randrange(1, NOISE_BYTES)
        self.bytes_in += len(data)
        return data


def fuzz_line(total_bytes: int, seed: int) -> Outcome:
    """Spoil a serial line between host and drive both ways; whenever it is good again, they find each other."""
    chance = random.Random(f"line {seed}")
    fd = bool(seed % 2)
    host = HostMachine(HostConfig(node=NODE, fd=fd))
    line = _Line(chance, host, DriveMachine(DriveConfig(NODE, SERIAL_NUMBER, fd)))
    now_ns = probes = got = 0
    while line.bytes_in < total_bytes:
        now_ns += 1_000_000
        got += line.pass_ms(now_ns)
        _use(chance, host, now_ns, f"seed {seed}", line.bytes_in)
        for reader in (line.to_drive, line.to_host):
            kept = len(reader._partial)
            require(kept <= MAX_PACKET_BYTES, f"seed {seed}: {kept} bytes kept at {line.bytes_in}")
        if chance.random() < 0.03:
            line.noisy = False
            now_ns = _connects(host, line.pass_ms, now_ns, f"seed {seed}: no connection at {line.bytes_in}")
            line.noisy = True
            probes += 1
    return Outcome(line.bytes_in, probes, got)


def _use(chance: random.Random, host: HostMachine, now_ns: int, seed: str, fed: int) -> None:
    """Press buttons and take samples now and then; queues must not grow in between."""
    if chance.random() < 0.05:
        _press(chance, host, now_ns)
    if chance.random() < 0.01:
        host.take_samples()
        host.take_bench()
    samples = host._samples
    bounded = len(samples._queue) <= MAX_QUEUED_SAMPLES and len(samples._bench) <= MAX_QUEUED_SAMPLES
    require(bounded, f"{seed}: queues grow at {fed}")
    pending = max(len(samples._feedback), len(samples._timing))
    require(pending <= MAX_PENDING_HALVES, f"{seed}: {pending} halves kept at {fed}")


def _good_link(host: HostMachine, drive: DriveMachine, now_ns: int) -> int:
    """Let a millisecond pass between host and drive; return how many frames the host sent."""
    now_us = now_ns // 1000
    sent = host.poll(now_ns)
    reference = host.setpoint(0)
    for frame in [*sent, reference] if reference is not None else sent:
        for answer in drive.receive(frame, now_us, 0):
            host.receive(answer, now_ns)
    for frame in drive.poll(now_us) + drive.sample(now_us, 0, 0):
        host.receive(frame, now_ns)
    return len(sent)


def _connects(host: HostMachine, link: Callable[[int], int], now_ns: int, finding: str) -> int:
    """Leave the host alone with the good drive: it must be connected after a while; return the time then."""
    for _ in range(CONNECT_MS):
        now_ns += 1_000_000
        if host.phase in (HostPhase.DISCONNECTED, HostPhase.REFUSED):
            host.connect(now_ns)
        link(now_ns)
        if host.phase in _CONNECTED:
            return now_ns
    raise Finding(f"{finding}: {host.phase}")


def _press(chance: random.Random, host: HostMachine, now_ns: int) -> None:
    """Do what a user might; a command that does not fit the phase is a ValueError, and only that."""
    actions: tuple[Callable[[], object], ...] = (
        lambda: host.connect(now_ns),
        host.enable,
        host.disable,
        host.reset_fault,
        lambda: host.setpoint(chance.randrange(-(1 << 31), 1 << 31)),
    )
    try:
        chance.choice(actions)()
    except ValueError:
        return
