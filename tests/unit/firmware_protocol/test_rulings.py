"""Where two rules meet, or a word could be read in two ways: the ruling, for the Python drive and the C drive alike."""

from collections.abc import Callable

import pytest

from firmware_protocol import codec
from firmware_protocol.drive.config import DriveConfig
from firmware_protocol.drive.discovery import identity_delay_us
from firmware_protocol.drive.machine import DriveMachine
from firmware_protocol.frames import BROADCAST_NODE, Frame, arbitration_id
from firmware_protocol.messages import AssignNode, Discover, DriveState, FaultReason, Function, HostHeartbeat
from tests.firmware_library import CDrive

NODE, SERIAL = 3, 0x0000_1234_5678
LIMIT, TOLERANCE, MAX_STEP = 1_000, 100, 500
Make = Callable[[DriveConfig], DriveMachine | CDrive]
both = pytest.mark.parametrize("make", [DriveMachine, CDrive], ids=["python", "c"])


def drive_of(make: Make, fd: bool = False) -> DriveMachine | CDrive:
    limits = {"theta_min_raw": -LIMIT, "theta_max_raw": LIMIT}
    steps = {"reference_tolerance_raw": TOLERANCE, "max_step_raw": MAX_STEP}
    return make(DriveConfig(NODE, SERIAL, fd, **limits, **steps))


def state_of(drive: DriveMachine | CDrive) -> tuple[int, int]:
    if isinstance(drive, CDrive):
        return drive.status()[1:3]
    return int(drive.state), int(drive.fault)


def beat(drive: DriveMachine | CDrive, control: int, sequence: int) -> None:
    drive.receive(codec.encode(HostHeartbeat(NODE, control, 1, 0, sequence & 0xFF)), 0, 0)


def arm(drive: DriveMachine | CDrive) -> None:
    drive.sample(0, 0, 0)
    beat(drive, 0, 0)
    beat(drive, 1, 1)
    assert state_of(drive)[0] == DriveState.ARMED


@both
@pytest.mark.parametrize("running", [False, True])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("distance", [LIMIT + 1, 5 * LIMIT, 1 << 30])
def test_hfp_118_limits_go_before_tolerance_and_step(make: Make, running: bool, sign: int, distance: int) -> None:
    drive = drive_of(make)
    arm(drive)
    if running:
        drive.receive(codec.encode_setpoint(NODE, 0, 0, 0), 0, 0)
        assert state_of(drive)[0] == DriveState.OPERATIONAL
    drive.receive(codec.encode_setpoint(NODE, sign * distance, 1, 0), 0, 0)
    assert state_of(drive) == (DriveState.FAULT, FaultReason.REFERENCE_POSITION)


@both
def test_hfp_068_identity_after_assign_node_is_no_answer(make: Make) -> None:
    drive, now_us = drive_of(make), 0
    for answers in range(5):
        for node in (NODE + 1, NODE):
            assert len(drive.receive(codec.encode(AssignNode(BROADCAST_NODE, SERIAL, node)), now_us, 0)) == 1
        drive.poll(now_us)
        drive.receive(codec.encode(Discover(BROADCAST_NODE)), now_us, 0)
        now_us += identity_delay_us(SERIAL, answers)
        identities = [arbitration_id(Function.IDENTITY, NODE)]
        assert [f.arbitration_id for f in drive.poll(now_us - 1) if f.arbitration_id in identities] == []
        assert [f.arbitration_id for f in drive.poll(now_us) if f.arbitration_id in identities] == identities
        now_us += 1


@both
def test_hfp_088_the_present_id_is_a_change_of_node(make: Make) -> None:
    drive = drive_of(make)
    beat(drive, 0, 100)
    assert len(drive.receive(codec.encode(AssignNode(BROADCAST_NODE, SERIAL, NODE)), 0, 0)) == 1
    beat(drive, 1, 90)
    assert drive.rejected() == 0
    assert state_of(drive)[0] == DriveState.DISABLED
    beat(drive, 0, 91)
    beat(drive, 1, 92)
    assert state_of(drive)[0] == DriveState.ARMED


@both
@pytest.mark.parametrize("fd", [False, True])
def test_hfp_173_the_other_kind_of_setpoint_is_not_for_it(make: Make, fd: bool) -> None:
    drive = drive_of(make, fd)
    arm(drive)
    other = codec.encode_setpoint(NODE, 0, 1, 0, not fd)
    for frame in (other, Frame(other.arbitration_id, b"", fd), Frame(other.arbitration_id, bytes(7), not fd)):
        assert drive.receive(frame, 0, 0) == []
    assert drive.rejected() == 0
    assert state_of(drive)[0] == DriveState.ARMED
