"""Invariant: whatever happens in whatever order, the drives of Python and of C say, are and count the same.

HFP_RANDOM_EVENTS sets how many events are tried (120,000 here; a million: `make -C firmware_protocol/c million`).
"""

import os
import random
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import codec
from firmware_protocol.drive.config import DriveConfig
from firmware_protocol.drive.machine import DriveMachine
from firmware_protocol.frames import Frame, arbitration_id
from firmware_protocol.golden.vectors import draw_messages
from firmware_protocol.messages import (
    AssignNode,
    Discover,
    DriveState,
    FaultReason,
    Function,
    HostHeartbeat,
    ParamOp,
    ParamRequest,
)
from firmware_protocol.parameters import DICTIONARY
from firmware_protocol.scales import wrap_int32
from firmware_protocol.states import DRIVE_TRANSITIONS
from tests.firmware_library import CDrive

EVENTS = int(os.environ.get("HFP_RANDOM_EVENTS", "120000"))
SEEDS = range(12)
NODE, SERIAL = 3, 0xA1B2_C3D4_E5F6
POOL = [codec.encode(message, fd) for message, fd in draw_messages(random.Random(6), 20)]
CONFIG = DriveConfig(
    NODE,
    SERIAL,
    theta_min_raw=-10_000,
    theta_max_raw=10_000,
    max_step_raw=500,
    reference_tolerance_raw=100,
    arm_timeout_us=4_000,
    watchdog_timeout_us=6_000,
    host_heartbeat_timeout_us=8_000,
    heartbeat_period_us=5_000,
    max_sample_age=3,
)


class Twins:
    """Both drives, given the same; each call compares all that they say and are."""

    def __init__(self, config: DriveConfig, now_us: int, theta: int) -> None:
        self.python, self.c = DriveMachine(config), CDrive(config)
        self.now_us, self.theta = now_us, theta
        self.steps = Counter[tuple[int, int]]()
        self.faults = Counter[FaultReason]()

    def receive(self, frame: Frame) -> None:
        wanted = self.python.receive(frame, self.now_us, self.theta)
        self.same(wanted, self.c.receive(frame, self.now_us, self.theta))

    def poll(self) -> None:
        self.same(self.python.poll(self.now_us), self.c.poll(self.now_us))

    def sample(self, current: int) -> None:
        wanted = self.python.sample(self.now_us, self.theta, current)
        self.same(wanted, self.c.sample(self.now_us, self.theta, current))

    def trip(self, reason: FaultReason) -> None:
        self.python.trip(reason)
        self.c.trip(reason)
        self.same([], [])

    def same(self, wanted: list[Frame], got: list[Frame]) -> None:
        drive = self.python
        reference = None if drive.reference_raw is None else wrap_int32(drive.reference_raw)
        assert got == wanted
        assert self.c.status() == (drive.node, drive.state, drive.fault, reference)
        assert tuple(self.c.head.counters) == tuple(drive.counters.values())
        self.faults[drive.fault] += 1


class Events:
    """Draws what happens next: mostly what makes sense for the state, at the edges of its bounds and timeouts."""

    def __init__(self, rng: random.Random, twins: Twins) -> None:
        self.rng, self.twins = rng, twins
        self.host = 0
        self.trips = rng.randrange(len(FaultReason))
        self.kinds: tuple[tuple[Callable[[], None], int], ...] = (
            (self.pass_time, 20),
            (self.to_an_edge, 6),
            (twins.poll, 12),
            (self.sample, 18),
            (self.heartbeat, 14),
            (self.setpoint, 30),
            (self.parameter, 3),
            (self.rare, 2),
            (self.any_frame, 6),
        )

    def run(self, count: int) -> None:
        calls, weights = zip(*self.kinds, strict=True)
        for call in self.rng.choices(calls, weights, k=count):
            before = self.twins.python.state
            call()
            after = self.twins.python.state
            if after is not before:
                self.twins.steps[before, after] += 1

    def near(self, value: int) -> int:
        return value + self.rng.choice((-1, 0, 0, 0, 1))

    def pass_time(self) -> None:
        self.twins.now_us += self.rng.choice((0, 1, 200, 500, 1_000))

    def to_an_edge(self) -> None:
        """Go to within a microsecond of something that falls due, if that is ahead."""
        drive = self.twins.python
        due = [
            drive._fed_us + drive._watchdog_timeout_us,
            drive._armed_us + drive._arm_timeout_us,
            drive._host_us + drive._host_timeout_us,
            drive._heartbeat_us + drive._heartbeat_period_us,
        ]
        if drive._identity_due_us is not None:
            due.append(drive._identity_due_us)
        self.twins.now_us = max(self.near(self.rng.choice(due)), self.twins.now_us)

    def sample(self) -> None:
        self.twins.theta += self.rng.choice((0, 0, 0, 1, -1, 30, -30))
        self.twins.sample(self.rng.choice((0, 5, -5, 32_767, 32_768, -32_768, -32_769, 1 << 30, -(1 << 31))))

    def heartbeat(self) -> None:
        rng, state = self.rng, self.twins.python.state
        wanted = {DriveState.DISABLED: (0, 1, 3), DriveState.FAULT: (0, 2, 3)}.get(state, (1, 1, 1, 1, 1, 1, 0))
        control = rng.choice(wanted) if rng.random() < 0.95 else rng.randrange(256)
        self.host += rng.choice((1, 1, 1, 1, 1, 2, 127)) if rng.random() < 0.97 else rng.choice((0, 128, 200))
        major = 1 if rng.random() < 0.99 else rng.choice((0, 2))
        message = HostHeartbeat(self.twins.python.node, control, major, rng.randrange(256), self.host & 0xFF)
        self.twins.receive(codec.encode(message))

    def setpoint(self) -> None:
        rng, drive = self.rng, self.twins.python
        advance = rng.choice((1,) * 30 + (2, 3, 7, 8, 9, 127, 128, 0, -1))
        age = self.near(rng.choice((0, 0, 0, 1, 1, 2, drive._max_sample_age)))
        if rng.random() < 0.01:
            age = rng.randrange(256)
        reference = self.twins.theta + rng.randrange(-40, 41)
        if rng.random() < 0.05:
            sign, factor = rng.choice((-1, 1)), min(max(advance, 1), 8)
            edges = (
                self.twins.theta + sign * drive._reference_tolerance_raw,
                drive._reference_wire + sign * drive._max_step_raw * factor,
                drive._theta_min_raw,
                drive._theta_max_raw,
                self.twins.theta + (1 << 31),
            )
            reference = self.near(rng.choice(edges))
        sequences = (drive._setpoint_sequence + advance) & 0xFF, (drive._sequence - age) & 0xFF
        is_fd = drive.config.fd if rng.random() < 0.99 else not drive.config.fd
        self.twins.receive(codec.encode_setpoint(drive.node, wrap_int32(reference), *sequences, is_fd))

    def parameter(self) -> None:
        rng = self.rng
        row = rng.choice(DICTIONARY)
        index = int(row.number) if rng.random() < 0.9 else rng.randrange(0x500)
        op = rng.choice((ParamOp.READ, ParamOp.WRITE, rng.randrange(256)))
        # Mostly values about those at power-up, so that the drive stays one that can be enabled.
        usual = getattr(self.twins.python.config, row.name, 0)
        bound = rng.choice((row.minimum, row.maximum))
        near = wrap_int32(self.near(usual if rng.random() < 0.9 else bound))
        self.twins.receive(codec.encode(ParamRequest(self.twins.python.node, op, index, near)))

    def rare(self) -> None:
        rng, node = self.rng, self.twins.python.node
        match rng.randrange(8):
            case 0:
                payload = rng.randbytes(rng.choice((0, 8, 64)))
                self.twins.receive(Frame(arbitration_id(Function.ESTOP, rng.choice((0, node, node + 1))), payload))
            case 1:
                self.trips = self.trips % (len(FaultReason) - 1) + 1  # each reason in turn
                self.twins.trip(FaultReason(self.trips))
            case 2 | 3:
                serial = SERIAL if rng.random() < 0.8 else rng.randrange(1 << 48)
                wanted = rng.choice((0, 1, 3, 3, 30, 31, 255))
                self.twins.receive(codec.encode(AssignNode(0, serial, wanted)))
            case _:
                self.twins.receive(codec.encode(Discover(rng.choice((0, node, 31 - node)))))

    def any_frame(self) -> None:
        """Let come a message of any kind to this drive or another, whole or damaged, or noise."""
        rng = self.rng
        identifier, data, is_fd, _ = rng.choice(POOL)
        if identifier >> 5 == Function.ESTOP:
            return
        if rng.random() < 0.7:
            identifier = identifier & ~31 | self.twins.python.node
        kind = rng.randrange(4)
        if kind == 0 and data:
            data = bytes((data[0] ^ 1 << rng.randrange(8), *data[1:]))
        elif kind == 1:
            data = data[:-1] if rng.random() < 0.5 else data + b"\0"
        elif kind == 2:
            is_fd = not is_fd
        self.twins.receive(Frame(identifier, data, is_fd))


def run(seed: int, config: DriveConfig, count: int) -> Twins:
    rng = random.Random(seed)
    twins = Twins(config, (1 << 32) - rng.randrange(10_000_000), rng.choice((0, 50, 1 << 32, -(1 << 33))))
    Events(rng, twins).run(count)
    return twins


@pytest.mark.parametrize("fd", [False, True])
def test_both_drives_are_one(fd: bool) -> None:
    """Every transition of the table and every fault is met, each counter grows, and all of it compared."""
    steps, faults, counters = Counter[tuple[int, int]](), Counter[FaultReason](), Counter[str]()
    for seed in SEEDS:
        twins = run(seed + 100 * fd, replace(CONFIG, fd=fd), EVENTS // len(SEEDS) // 2)
        steps += twins.steps
        faults += twins.faults
        counters += Counter(twins.python.counters)
    assert set(steps) == {(before, after) for before, row in DRIVE_TRANSITIONS.items() for after in row.values()}
    assert set(faults) == set(FaultReason)
    assert {name for name, count in twins.python.counters.items() if not counters[name]} == {"unknown_id"}
    assert counters["setpoints_accepted"] > EVENTS // 100


@pytest.mark.parametrize("theta", [(1 << 31) - 20, -(1 << 31) + 20, (1 << 33) + (1 << 31)])
def test_both_drives_are_one_where_the_angle_wraps(theta: int) -> None:
    config = DriveConfig(NODE, SERIAL, reference_tolerance_raw=60, max_step_raw=200, max_sample_age=3)
    twins = Twins(config, 0, theta)
    Events(random.Random(theta), twins).run(EVENTS // 20)
    assert twins.python.counters["setpoints_accepted"] > EVENTS // 2_000


rows = st.tuples(
    st.sampled_from(("receive", "poll", "sample", "trip")),
    st.sampled_from(POOL),
    st.integers(0, 50_000),
    st.integers(-(1 << 31), (1 << 31) - 1),
    st.sampled_from([reason for reason in FaultReason if reason]),
)


@given(st.booleans(), st.lists(rows, max_size=40))
def test_any_sequence_of_events(fd: bool, events: list[tuple[str, Frame, int, int, FaultReason]]) -> None:
    twins = Twins(replace(CONFIG, fd=fd), 0xFFFF_F000, 0)
    for kind, frame, wait_us, angle, reason in events:
        twins.now_us += wait_us
        twins.theta = angle
        match kind:
            case "receive":
                twins.receive(frame._replace(arbitration_id=frame.arbitration_id & ~31 | NODE))
            case "poll":
                twins.poll()
            case "sample":
                twins.sample(angle)
            case _:
                twins.trip(reason)
