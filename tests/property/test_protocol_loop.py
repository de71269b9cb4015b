"""Host and drive in one memory, over a line that loses, doubles and reorders. Invariant: every measurement and every
reference is accounted for by sequence, what is delivered is in order, and a motor moves only for a host that follows.
"""

import heapq
import random
from typing import NamedTuple

import pytest

from firmware_protocol.drive.machine import DriveConfig, DriveMachine
from firmware_protocol.frames import Frame
from firmware_protocol.host.machine import HostConfig, HostMachine, HostPhase, RawSample
from firmware_protocol.messages import DriveState, FaultReason
from firmware_protocol.serial_framing import SerialReader, encode_serial

US = 1_000
NODE = 7


class Faults(NamedTuple):
    """Per frame: probabilities, and the longest extra delay."""

    loss: float = 0.0
    double: float = 0.0
    delay_us: int = 0


class Loop:
    """1 kHz: the drive measures at 0, the host computes at 600 µs; every frame takes 100 µs and what the line adds."""

    def __init__(self, faults: Faults, seed: int = 0, fd: bool = False, serial: bool = False) -> None:
        self.rng = random.Random(seed)
        self.faults = faults
        self.drive = DriveMachine(DriveConfig(NODE, 0x42, fd=fd, max_step_raw=100))
        self.host = HostMachine(HostConfig(NODE, fd=fd))
        self.now_us = 123_456
        self.theta = 1 << 31  # at the wrap from the start
        self.readers = {True: SerialReader(), False: SerialReader()} if serial else None
        self.line: list[tuple[int, int, bool, Frame]] = []
        self.count = 0
        self.samples: list[RawSample] = []
        self.sent = 0
        self.host_alive = True
        self.references: list[int | None] = []

    def send(self, frames: list[Frame], to_host: bool) -> None:
        for frame in frames:
            for _ in range(1 + (self.rng.random() < self.faults.double)):
                if self.rng.random() >= self.faults.loss:
                    self.count += 1  # frames of one instant keep their order
                    at = self.now_us + 100 + self.rng.randint(0, self.faults.delay_us)
                    heapq.heappush(self.line, (at, self.count, to_host, frame))

    def arrive(self, until_us: int) -> None:
        while self.line and self.line[0][0] <= until_us:
            at, _, to_host, frame = heapq.heappop(self.line)
            self.now_us = max(self.now_us, at)
            frames = [frame] if self.readers is None else self.readers[to_host].feed(encode_serial(frame))
            for one in frames:
                if to_host and self.host_alive:
                    self.host.receive(one, self.now_us * US)
                elif not to_host:
                    self.send(self.drive.receive(one, self.now_us, self.theta), True)
        self.now_us = until_us

    def millisecond(self, connect: bool = True) -> None:
        start = self.now_us
        self.send(self.drive.poll(start), True)
        self.references.append(self.drive.reference_raw)
        if self.drive.reference_raw is not None:
            self.theta = self.drive.reference_raw  # a perfect motor
        self.send(self.drive.sample(start, self.theta, 0), True)
        self.arrive(start + 600)
        if self.host_alive:
            self.tick(connect)
        self.arrive(start + 1_000)

    def tick(self, connect: bool) -> None:
        host = self.host
        new = host.take_samples()
        self.samples += new
        if host.phase is HostPhase.DISCONNECTED and connect:
            host.connect(self.now_us * US)
        elif host.phase is HostPhase.READY:
            host.enable()
        elif host.phase is HostPhase.FAULT:
            host.reset_fault()
        self.send(host.poll(self.now_us * US), False)
        target = self.samples[-1].theta_m + 20 if self.samples else 0
        frame = host.setpoint(target) if new else None
        if frame is not None:
            self.sent += 1
            self.send([frame], False)


@pytest.mark.parametrize("fd", [False, True])
@pytest.mark.parametrize("serial", [False, True])
def test_a_perfect_line_loses_nothing(fd: bool, serial: bool) -> None:
    loop = Loop(Faults(), fd=fd, serial=serial)
    for _ in range(2_000):
        loop.millisecond()
    host, drive = loop.host, loop.drive
    assert (host.phase, drive.state) == (HostPhase.RUNNING, DriveState.OPERATIONAL)
    assert drive.rejected() == 0
    for name in ("lost_feedback", "lost_setpoints", "stale_feedback", "unpaired", "rejected_by_drive", "bad_crc"):
        assert host.counters[name] == 0
    assert drive.counters["setpoints_accepted"] == loop.sent == host.counters["setpoints_sent"]
    assert loop.sent > 1_900  # identified within 32 ms, enabled within 50
    assert loop.theta > (1 << 31) + 30_000  # went on across the wrap
    assert [s.theta_m for s in loop.samples] == sorted(s.theta_m for s in loop.samples)
    assert {b.stamp_ns - a.stamp_ns for a, b in zip(loop.samples, loop.samples[1:], strict=False)} == {1_000_000}


FAULTS = [Faults(loss=0.02), Faults(double=0.2), Faults(delay_us=3_000), Faults(loss=0.05, double=0.1, delay_us=2_000)]


@pytest.mark.parametrize("fd", [False, True])
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("faults", FAULTS)
def test_every_frame_is_accounted_for(faults: Faults, seed: int, fd: bool) -> None:
    """HFP-042, HFP-044, HFP-045, HFP-046, to the frame."""
    loop = Loop(faults, seed, fd)
    for _ in range(3_000):
        loop.millisecond()
    loop.faults = Faults()
    for _ in range(300):
        loop.millisecond()
    host, drive = loop.host, loop.drive
    assert host.phase is HostPhase.RUNNING
    assert host.counters["drive_gone"] == 0
    stamps = [sample.stamp_ns for sample in loop.samples]
    assert stamps == sorted(set(stamps))
    measured = (stamps[-1] - stamps[0]) // 1_000_000 + 1
    assert len(stamps) + host.counters["lost_feedback"] == measured
    steps = [(b.sequence - a.sequence) & 0xFF for a, b in zip(loop.samples, loop.samples[1:], strict=False)]
    assert sum(steps) + 1 == measured
    counters = drive.counters
    assert host.counters["lost_setpoints"] == counters["setpoints_lost"]
    if counters["faults"] == 0:
        # Before OPERATIONAL the host may have sent more than the one that made it so.
        unseen = loop.sent - counters["setpoints_accepted"] - counters["setpoints_lost"]
        assert 0 <= unseen <= 12
    if faults.loss:
        assert counters["setpoints_lost"] > 20
        assert host.counters["lost_feedback"] > 20
    for before, after in zip(loop.references, loop.references[1:], strict=False):
        if before is not None and after is not None:
            assert abs(after - before) <= 8 * 100


@pytest.mark.parametrize("faults", [Faults(), *FAULTS])
def test_a_host_that_dies_stops_the_motor(faults: Faults) -> None:
    """HFP-120: by silence, 20 ms after the last fresh reference, and nobody enables it again."""
    loop = Loop(faults, 4)
    for _ in range(1_000):
        loop.millisecond()
    assert loop.drive.state is DriveState.OPERATIONAL
    loop.host_alive = False
    for _ in range(25):
        loop.millisecond()
    assert loop.drive.fault is FaultReason.WATCHDOG
    for _ in range(1_000):
        loop.millisecond()
    assert loop.references[-1_000:] == [None] * 1_000


def test_a_new_host_takes_over_by_reset_and_enable() -> None:
    loop = Loop(Faults(), 4)
    for _ in range(500):
        loop.millisecond()
    loop.host = HostMachine(HostConfig(NODE))
    loop.samples.clear()
    for _ in range(500):
        loop.millisecond()
    assert loop.drive.counters["faults"] == 1
    assert (loop.host.phase, loop.drive.state) == (HostPhase.RUNNING, DriveState.OPERATIONAL)


def test_a_drive_that_restarts_is_found_and_enabled_again() -> None:
    loop = Loop(Faults(), 4)
    for _ in range(500):
        loop.millisecond()
    loop.drive = DriveMachine(loop.drive.config)
    loop.now_us = 0  # its clock, too
    loop.line.clear()
    theta = loop.theta
    for _ in range(5):
        loop.millisecond(connect=False)
    assert loop.host.phase is HostPhase.DISCONNECTED
    assert loop.host.counters["drive_restarted"] == 1
    assert loop.drive.state is DriveState.DISABLED
    assert loop.theta == theta


def test_an_adapter_that_repeats_the_last_frames_of_a_dead_host_moves_nothing() -> None:
    """Cyclic sending in the kernel outlives its process; what repeats is not fresh."""
    loop = Loop(Faults(), 4)
    for _ in range(500):
        loop.millisecond()
    loop.host_alive = False
    newest = loop.host.setpoint(loop.samples[-1].theta_m)
    assert newest is not None
    accepted = loop.drive.counters["setpoints_accepted"]
    for _ in range(30):
        loop.drive.receive(newest, loop.now_us, loop.theta)
        loop.millisecond()
    assert loop.drive.counters["setpoints_accepted"] == accepted + 1
    assert loop.drive.fault is FaultReason.WATCHDOG


def test_a_pipeline_that_hangs_stops_the_motor() -> None:
    """HFP-102, HFP-112: frames come in and references go out, but nobody looks at the measurements any more."""
    loop = Loop(Faults(), 4)
    for _ in range(500):
        loop.millisecond()
    reference = loop.samples[-1].theta_m
    for _ in range(45):
        loop.send(loop.drive.poll(loop.now_us) + loop.drive.sample(loop.now_us, loop.theta, 0), True)
        frame = loop.host.setpoint(reference)
        loop.send(loop.host.poll(loop.now_us * US) + ([frame] if frame else []), False)
        loop.arrive(loop.now_us + 1_000)
    assert loop.drive.fault is FaultReason.WATCHDOG
    assert loop.drive.counters["sample_old"] > 0


def test_measurements_alone_keep_nothing_alive() -> None:
    """A host that still sends heartbeats and reads, but computes no references any more."""
    loop = Loop(Faults(), 4)
    for _ in range(500):
        loop.millisecond()
    assert loop.drive.state is DriveState.OPERATIONAL
    for _ in range(25):
        loop.samples += loop.host.take_samples()
        loop.send(loop.host.poll(loop.now_us * US), False)
        loop.send([loop.host.read_parameter(0x0201)], False)
        loop.send(loop.drive.sample(loop.now_us, loop.theta, 0), True)
        loop.arrive(loop.now_us + 1_000)
        loop.drive.poll(loop.now_us)
    assert loop.drive.fault == FaultReason.WATCHDOG
    assert len(loop.host.take_responses()) == 25
