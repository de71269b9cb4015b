"""Invariant, for any frames, times and angles: neither machine raises; every frame for the drive is taken or counted;
there is a reference only in OPERATIONAL; FAULT keeps its reason and is left to DISABLED only; torque is never reached
but by DISABLED, ARMED, OPERATIONAL; what the host delivers is in order.
"""

import random
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import codec
from firmware_protocol.drive.machine import DriveConfig, DriveMachine
from firmware_protocol.frames import Frame, arbitration_id
from firmware_protocol.golden.vectors import draw_messages
from firmware_protocol.host.machine import HostConfig, HostMachine, HostPhase
from firmware_protocol.messages import DriveState, Estop, FaultReason, Function, HostHeartbeat, Identity, Message
from firmware_protocol.states import DRIVE_TRANSITIONS

NODE = 3
STEPS = {(before, after) for before, row in DRIVE_TRANSITIONS.items() for after in row.values()}


@given(st.integers(0, 0x7FF), st.binary(max_size=64), st.booleans())
def test_any_frame_is_decoded_or_counted_once(identifier: int, data: bytes, is_fd: bool) -> None:
    decoder = codec.Decoder()
    message = decoder.decode(Frame(identifier, data, is_fd))
    assert sum(decoder.counters.values()) == (message is None)


messages = st.sampled_from(draw_messages(random.Random(8), 30))


@given(messages)
def test_round_trips(drawn: tuple[Message, bool]) -> None:
    message, fd = drawn
    frame = codec.encode(message, fd)
    decoded = codec.Decoder().decode(frame)
    assert decoded == message
    assert decoded is not None
    assert codec.encode(decoded, fd) == frame


def hostile_frames(rng: random.Random, drive: DriveMachine, sent: int) -> Iterator[Frame]:
    """Mostly frames that make sense now, some damaged, some foreign, some noise."""
    theta = rng.choice((0,) * 80 + (5, -7, 3_000, -9_000, 20_000))
    if rng.random() < 0.4:
        controls = rng.choice((0, 2, 3) + (1,) * 12)
        major = rng.choice((1,) * 40 + (2,))
        yield codec.encode(HostHeartbeat(NODE, controls, major, 0, (sent + rng.randrange(2)) & 0xFF))
    for _ in range(rng.randrange(4)):
        yield codec.encode_setpoint(NODE, theta, (sent + rng.randrange(4)) & 0xFF, (drive._sequence - 1) & 0xFF)
    if rng.random() < 0.01:
        yield codec.encode(Estop(rng.choice((0, NODE, 5))))
    message, fd = rng.choice(_POOL)
    frame = codec.encode(message._replace(node=NODE) if message.node > 0 else message, fd)
    if isinstance(message, Estop):
        return
    if rng.random() < 0.5:
        data = bytearray(frame.data)
        if data:
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        frame = frame._replace(data=bytes(data))
    yield frame
    yield Frame(rng.randrange(0x20, 0x800), rng.randbytes(rng.randrange(9)), rng.random() < 0.2)


_POOL = draw_messages(random.Random(5), 10)


@pytest.mark.parametrize("seed", range(4))
def test_drive_under_fire(seed: int) -> None:
    """10**5 frames in all."""
    rng = random.Random(seed)
    drive = DriveMachine(
        DriveConfig(
            NODE,
            0x123,
            theta_min_raw=-10_000,
            theta_max_raw=10_000,
            max_step_raw=500,
            reference_tolerance_raw=100,
            arm_timeout_us=3_000,
            watchdog_timeout_us=6_000,
            host_heartbeat_timeout_us=8_000,
        )
    )
    now_us, theta, received, seen = 0, 0, 0, set()
    state, fault = drive.state, drive.fault

    def check() -> None:
        nonlocal state, fault
        assert (drive.reference_raw is not None) == (drive.state is DriveState.OPERATIONAL)
        assert (drive.fault is not FaultReason.NONE) == (drive.state is DriveState.FAULT)
        if drive.state is state is DriveState.FAULT:
            assert drive.fault is fault
        assert drive.state is state or (state, drive.state) in STEPS
        state, fault = drive.state, drive.fault
        seen.add(fault)

    sent = 0
    while received < 25_000:
        now_us += rng.choice((200, 1_000, 1_000, 3_000, 7_000 if rng.random() < 0.1 else 500))
        drive.poll(now_us)
        check()
        drive.sample(now_us, theta, rng.randrange(-40_000, 40_000))
        sent += 1
        for frame in hostile_frames(rng, drive, sent):
            before = drive.rejected() + drive.counters["not_for_us"]
            drive.receive(frame, now_us, theta)
            check()
            received += 1
            assert drive.rejected() + drive.counters["not_for_us"] - before in (0, 1)
    assert {int(reason) for reason in seen} == set(range(9))  # every fault of the protocol's own
    assert drive.counters["setpoints_accepted"] > 100


@pytest.mark.parametrize("seed", range(4))
def test_host_under_fire(seed: int) -> None:
    """10**5 frames in all, most of them of the drive's own kinds with random fields."""
    rng = random.Random(seed)
    host = HostMachine(HostConfig(NODE))
    now_ns, stamp, sequence, received = 0, 0, 0, 0
    last_stamp = -1
    phases = set()
    identity = codec.encode(Identity(NODE, 5, 1, 0))
    phase = host.phase
    while received < 25_000:
        now_ns += rng.choice((100_000, 1_000_000, 5_000_000))
        if phase in (HostPhase.DISCONNECTED, HostPhase.REFUSED):
            host.connect(now_ns)
            host.receive(identity, now_ns)
            last_stamp = -1
        host.poll(now_ns)
        host.setpoint(rng.randrange(-(1 << 40), 1 << 40))
        if host.phase is HostPhase.READY:
            host.enable()
        stamp, sequence = stamp + 1_000, sequence + 1
        state, fault = rng.choice(((2, 0), (2, 0), (1, 0), (0, 0), (3, 2)))
        frames = [
            codec.encode_feedback(NODE, rng.randrange(-(1 << 31), 1 << 31), 5, sequence & 0xFF),
            codec.encode_timing(NODE, stamp & 0xFFFF_FFFF, sequence & 0xFF, 0, state, fault),
        ]
        message, fd = rng.choice(_POOL)
        if not isinstance(message, Identity):
            frames.append(codec.encode(message._replace(node=NODE) if message.node else message, fd))
        frames.append(Frame(rng.randrange(0x800), rng.randbytes(rng.randrange(9)), rng.random() < 0.2))
        rng.shuffle(frames)
        for frame in frames[: rng.randrange(1, 5)]:
            host.receive(frame, now_ns)
            received += 1
        for sample in host.take_samples():
            assert sample.stamp_ns > last_stamp
            last_stamp = sample.stamp_ns
        host.take_bench()
        phase = host.phase
        assert phase not in (HostPhase.DISCONNECTED, HostPhase.REFUSED) or host.drive_state is None
        phases.add(phase)
    assert host.counters["samples"] > 500
    assert phases == set(HostPhase) - {HostPhase.IDENTIFYING}


@given(st.lists(st.tuples(st.sampled_from(list(Function)), st.binary(max_size=8)), max_size=50))
def test_random_payloads_never_give_torque(rows: list[tuple[Function, bytes]]) -> None:
    drive = DriveMachine(DriveConfig(NODE, 1))
    for function, payload in rows:
        drive.receive(Frame(arbitration_id(function, NODE), payload), 0, 0)
        assert drive.state is not DriveState.OPERATIONAL
