"""What the drive makes of heartbeats, resets, foreign frames, and what it sends."""

import pytest

from firmware_protocol import codec
from firmware_protocol.drive.machine import DriveConfig, DriveMachine
from firmware_protocol.frames import Frame, arbitration_id
from firmware_protocol.golden.scenarios import Script
from firmware_protocol.messages import (
    Discover,
    DriveHeartbeat,
    DriveState,
    Estop,
    FaultReason,
    Feedback,
    Function,
    HostHeartbeat,
    ParamOp,
    ParamRequest,
    Timing,
)

DISABLED, ARMED, OPERATIONAL, FAULT = DriveState
LOW, ENABLE, RESET, BOTH = 0, 1, 2, 3
NODE = 3


def heartbeats(frames: list[Frame]) -> list[DriveHeartbeat]:
    decoded = [codec.Decoder().decode(frame) for frame in frames]
    return [message for message in decoded if isinstance(message, DriveHeartbeat)]


def rejected(s: Script) -> int:
    return s.drive.rejected()


def test_hfp_085_093_levels_that_are_high_at_first_are_no_edges() -> None:
    s = Script("edges")
    s.heartbeat(BOTH)
    s.heartbeat(BOTH)
    assert s.drive.state is DISABLED
    s.heartbeat(LOW)
    s.heartbeat(ENABLE)
    assert s.drive.state is ARMED


@pytest.mark.parametrize("now_us", [0, 5, 1 << 31])
@pytest.mark.parametrize("sequence", [0, 1, 200, 255])
def test_hfp_085_any_sequence_is_new_at_power_up(now_us: int, sequence: int) -> None:
    drive = DriveMachine(DriveConfig(NODE, 1))
    for control in (LOW, ENABLE):
        drive.receive(codec.encode(HostHeartbeat(NODE, control, 1, 0, sequence)), now_us, 0)
        sequence = (sequence + 1) & 0xFF
    assert drive.state is ARMED
    assert drive.rejected() == 0


def test_hfp_085_a_silent_host_starts_over() -> None:
    s = Script("edges")
    s.heartbeat(LOW, advance=50)
    s.wait(100_000)
    assert s.drive.state is DISABLED  # silence is no fault while nothing is enabled
    s.heartbeat(ENABLE, advance=-30)  # any sequence is new, and high is no edge
    assert s.drive.state is DISABLED
    assert s.drive.counters["heartbeat_stale"] == 0
    s.heartbeat(LOW)
    s.heartbeat(ENABLE)
    assert s.drive.state is ARMED


@pytest.mark.parametrize(("advance", "stale"), [(0, True), (1, False), (127, False), (128, True), (255, True)])
@pytest.mark.parametrize("base", [0, 255])
def test_hfp_083_sequence_of_heartbeats(base: int, advance: int, stale: bool) -> None:
    s = Script("heartbeats")
    s.heartbeat(LOW, advance=base + 1)
    s.heartbeat(ENABLE, advance)
    assert s.drive.state is (DISABLED if stale else ARMED)
    assert s.drive.counters["heartbeat_stale"] == rejected(s) == stale


@pytest.mark.parametrize("major", [0, 2, 255])
def test_hfp_094_095_version(major: int) -> None:
    s = Script("version")
    s.heartbeat(LOW, major=major)
    assert s.drive.state is DISABLED
    s.heartbeat(ENABLE, major=major)
    assert (s.drive.state, s.drive.fault) == (FAULT, FaultReason.VERSION)
    s.heartbeat(LOW)
    s.heartbeat(RESET)
    s.run()
    assert s.drive.state is OPERATIONAL
    s.heartbeat(LOW, major=major)  # letting go needs no version
    assert s.drive.state is DISABLED


def test_a_misfit_that_only_stays_high_faults_nothing() -> None:
    s = Script("version")
    s.heartbeat(ENABLE, major=2)
    assert s.drive.state is DISABLED


@pytest.mark.parametrize("control", [ENABLE, 0xFD])
def test_reserved_control_bits_are_ignored(control: int) -> None:
    """HFP-024."""
    s = Script("reserved")
    s.heartbeat(0xFC)
    s.heartbeat(control)
    assert s.drive.state is ARMED
    s.heartbeat(0xFC)
    assert s.drive.state is DISABLED


def test_hfp_132_133_134_resets() -> None:
    s = Script("reset")
    s.run()
    s.trip(FaultReason.SUPPLY)
    s.heartbeat(BOTH)  # ENABLE stayed high
    assert (s.drive.state, s.drive.fault) == (DISABLED, FaultReason.NONE)
    s.heartbeat(BOTH)
    s.heartbeat(ENABLE)
    assert s.drive.state is DISABLED
    s.heartbeat(LOW)
    s.heartbeat(BOTH)  # both rise: enables a drive without a fault
    assert s.drive.state is ARMED
    s.trip(FaultReason.SUPPLY)
    s.heartbeat(BOTH)
    s.heartbeat(RESET)
    assert s.drive.state is FAULT  # FAULT_RESET stayed high
    s.heartbeat(LOW)
    s.heartbeat(BOTH)  # both rise in FAULT: resets, does not enable
    assert s.drive.state is DISABLED
    s.heartbeat(ENABLE)
    assert s.drive.state is DISABLED


@pytest.mark.parametrize("node", [0, NODE])
@pytest.mark.parametrize(("payload", "is_fd"), [(b"", False), (b"\x55" * 8, False), (bytes(64), True), (b"\x01", True)])
def test_hfp_140_and_142_estop(node: int, payload: bytes, is_fd: bool) -> None:
    for prepare in (None, Script.sample, Script.arm, Script.run):
        s = Script("estop")
        if prepare:
            prepare(s)
        s.receive(Frame(arbitration_id(Function.ESTOP, node), payload, is_fd))
        assert (s.drive.state, s.drive.fault) == (FAULT, FaultReason.ESTOP)
        assert s.drive.reference_raw is None


def test_hfp_002_the_same_frames_with_29_bits_are_nothing() -> None:
    s = Script("others")
    s.run()
    frames = [
        codec.encode(Estop(NODE)),
        codec.encode(Estop(0)),
        codec.encode_setpoint(NODE, 0, 1, 1),
        codec.encode(ParamRequest(NODE, ParamOp.READ, 1, 0)),
        codec.encode(Discover(0)),
    ]
    for frame in frames:
        s.receive(frame._replace(is_extended=True))
    assert s.drive.state is OPERATIONAL
    assert rejected(s) == 0
    assert s.drive.counters["not_for_us"] == len(frames)
    assert all(step["frames"] == [] for step in s.steps[-len(frames) :])


def test_hfp_012_013_frames_for_others_are_nothing() -> None:
    s = Script("others")
    s.run()
    frames = [codec.encode(Estop(NODE + 1)), codec.encode_feedback(NODE, 0, 0, 0), Frame(0x7FF, b""), Frame(5000, b"")]
    frames += [Frame(arbitration_id(function, other), bytes(8)) for function in Function for other in (2, 4, 31)]
    for frame in frames:
        s.receive(frame)
    assert s.drive.state is OPERATIONAL
    assert rejected(s) == 0
    assert s.drive.counters["not_for_us"] == len(frames)
    assert all(step["frames"] == [] for step in s.steps[-len(frames) :])


def test_hfp_025_086_dropped_frames_are_counted_and_saturate() -> None:
    s = Script("rejected")
    s.heartbeat(LOW)
    before = s.drive.state
    for count, length in enumerate((0, 7, 8), start=1):
        s.receive(Frame(arbitration_id(Function.SETPOINT, NODE), bytes(length)))
        assert rejected(s) == count
    assert s.drive.state is before
    s.drive.counters["bad_crc"] += 65_531
    for expected in (65_534, 65_535, 65_535):
        s.now_us += 100_000
        assert [h.rejected for h in heartbeats(s.drive.poll(s.now_us))] == [expected]
        s.receive(Frame(arbitration_id(Function.SETPOINT, NODE), b""))


def test_hfp_046_lost_setpoints_in_the_heartbeat_wrap() -> None:
    s = Script("lost")
    s.run()
    for _ in range(3):
        s.setpoint(0, advance=127)
    assert s.drive.counters["setpoints_lost"] == 378
    s.now_us += 1
    assert [h.setpoints_lost for h in heartbeats(s.drive.poll(s.now_us))] == [378 & 0xFF]


def test_hfp_081_082_heartbeats_of_the_drive() -> None:
    s = Script("heartbeats", heartbeat_period_us=10_000)
    assert [h.state for h in heartbeats(s.drive.poll(s.now_us))] == [DISABLED]
    assert s.drive.poll(s.now_us + 9_999) == []
    assert [h.sequence for h in heartbeats(s.drive.poll(s.now_us + 10_000))] == [1]
    s.now_us += 10_000
    s.run()
    assert [(h.state, h.sequence) for h in heartbeats(s.drive.poll(s.now_us + 1))] == [(OPERATIONAL, 2)]
    s.trip(FaultReason.BUS_OFF)
    told = heartbeats(s.drive.poll(s.now_us + 2))
    assert [(h.state, h.fault, h.sequence) for h in told] == [(FAULT, FaultReason.BUS_OFF, 3)]
    assert s.drive.poll(s.now_us + 3) == []
    for _ in range(300):
        s.now_us += 10_002
        assert len(heartbeats(s.drive.poll(s.now_us))) == 1


def test_hfp_040_041_043_050_051_053_054_055_measurements() -> None:
    s = Script("samples")
    decoder = codec.Decoder()
    for i in range(300):
        stamp, theta, current = (1 << 32) - 150 + i, (1 << 31) - 100 + i, (i - 150) * 500
        feedback, timing = (decoder.decode(frame) for frame in s.drive.sample(stamp, theta, current))
        wire = theta if theta < 1 << 31 else theta - (1 << 32)
        saturated = min(max(current, -32_768), 32_767)
        assert feedback == Feedback(NODE, wire, saturated, i & 0xFF)
        assert timing == Timing(NODE, stamp & 0xFFFF_FFFF, i & 0xFF, 0, DISABLED, FaultReason.NONE)


def test_hfp_043_121_echo_and_state_in_the_measurement() -> None:
    s = Script("echo")
    s.arm()
    s.setpoint(0, advance=78)
    s.setpoint(0, advance=0)
    s.trip(FaultReason.ENCODER)
    timing = codec.Decoder().decode(s.drive.sample(0, 0, 0)[1])
    assert timing == Timing(NODE, 0, 1, 77, FAULT, FaultReason.ENCODER)


def test_time_that_wraps_is_time_all_the_same() -> None:
    """The scripts start just before the clock wraps; here the wrapped clock itself goes in."""
    s = Script("wrap")
    s.run()
    now = (s.now_us + 19_999) & 0xFFFF_FFFF
    assert now < s.now_us
    s.drive.poll(now)
    assert s.drive.state is OPERATIONAL
    s.drive.poll(now + 1)
    assert s.drive.fault is FaultReason.WATCHDOG
