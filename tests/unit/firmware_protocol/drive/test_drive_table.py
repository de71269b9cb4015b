"""Every state of the drive meets every event, by real frames and delays; what is expected is written out here again."""

from collections.abc import Callable

import pytest

from firmware_protocol import codec
from firmware_protocol.golden.scenarios import Script
from firmware_protocol.messages import DriveState, Estop, FaultReason
from firmware_protocol.states import DRIVE_REASONS, DRIVE_TRANSITIONS, DriveEvent

DISABLED, ARMED, OPERATIONAL, FAULT = DriveState
LOW, ENABLE, RESET = 0, 1, 2
NODE = 3
SETTINGS = {
    "theta_min_raw": -10_000,
    "theta_max_raw": 10_000,
    "max_step_raw": 5_000,
    "reference_tolerance_raw": 100,
    "watchdog_timeout_us": 20_000,
    "host_heartbeat_timeout_us": 50_000,
    "arm_timeout_us": 30_000,
}


def stay_disabled(s: Script) -> None:
    s.sample()
    s.heartbeat(LOW)


def fault(s: Script) -> None:
    s.run()
    s.trip(FaultReason.OVERCURRENT)


PREPARE: dict[DriveState, Callable[[Script], None]] = {
    DISABLED: stay_disabled,
    ARMED: Script.arm,
    OPERATIONAL: Script.run,
    FAULT: fault,
}


def level(s: Script) -> int:
    return LOW if s.drive.state is DISABLED else ENABLE


def enable(s: Script) -> None:
    """A rising edge where one is possible: from ARMED and OPERATIONAL, a fall would disable first."""
    if s.drive.state is FAULT:
        s.heartbeat(LOW)
    s.heartbeat(ENABLE)


def watchdog(s: Script) -> None:
    for _ in range(20):
        s.wait(1_000)
        s.heartbeat(level(s))


def arm_timeout(s: Script) -> None:
    for i in range(30):
        s.wait(1_000)
        s.heartbeat(level(s))
        if s.drive.state is OPERATIONAL:
            s.setpoint(i % 2)


def host_lost(s: Script) -> None:
    for _ in range(50):
        s.wait(1_000)
        if s.drive.state is OPERATIONAL:
            s.setpoint(0)


HAPPEN: dict[DriveEvent, Callable[[Script], None]] = {
    DriveEvent.ENABLE: enable,
    DriveEvent.VERSION_MISFIT: lambda s: s.heartbeat(ENABLE, major=2),
    DriveEvent.DISABLE: lambda s: s.heartbeat(LOW),
    DriveEvent.RESET: lambda s: s.heartbeat(level(s) | RESET),
    DriveEvent.REFERENCE: lambda s: s.setpoint(100),
    DriveEvent.REFERENCE_OFF: lambda s: s.setpoint(101),
    DriveEvent.REFERENCE_OUTSIDE: lambda s: s.setpoint(10_001),
    DriveEvent.REFERENCE_JUMP: lambda s: s.setpoint(5_001),
    DriveEvent.WATCHDOG_EXPIRED: watchdog,
    DriveEvent.HOST_LOST: host_lost,
    DriveEvent.ARM_EXPIRED: arm_timeout,
    DriveEvent.ESTOP: lambda s: s.receive(codec.encode(Estop(NODE))),
    DriveEvent.TRIP: lambda s: s.trip(FaultReason.ENCODER),
}

R = FaultReason
# Rows: state before, and per event the state after and the reason. None: nothing changes.
EXPECTED: dict[DriveEvent, tuple[object, object, object, object]] = {
    # event: from DISABLED, ARMED, OPERATIONAL, FAULT
    DriveEvent.ENABLE: (ARMED, None, None, None),
    DriveEvent.VERSION_MISFIT: (R.VERSION, R.VERSION, R.VERSION, None),
    DriveEvent.DISABLE: (None, DISABLED, DISABLED, None),
    DriveEvent.RESET: (None, None, None, DISABLED),
    DriveEvent.REFERENCE: (None, OPERATIONAL, None, None),
    DriveEvent.REFERENCE_OFF: (None, R.REFERENCE_MISMATCH, None, None),
    DriveEvent.REFERENCE_OUTSIDE: (None, R.REFERENCE_POSITION, R.REFERENCE_POSITION, None),
    # in ARMED a jump is first of all a reference away from the angle
    DriveEvent.REFERENCE_JUMP: (None, R.REFERENCE_MISMATCH, R.REFERENCE_RATE, None),
    DriveEvent.WATCHDOG_EXPIRED: (None, None, R.WATCHDOG, None),
    DriveEvent.HOST_LOST: (None, R.ENABLE_TIMEOUT, R.HOST_HEARTBEAT_LOST, None),
    DriveEvent.ARM_EXPIRED: (None, R.ENABLE_TIMEOUT, None, None),
    DriveEvent.ESTOP: (R.ESTOP, R.ESTOP, R.ESTOP, None),
    DriveEvent.TRIP: (R.ENCODER, R.ENCODER, R.ENCODER, None),
}


def after(before: DriveState, expected: object) -> tuple[DriveState, FaultReason]:
    if isinstance(expected, FaultReason):
        return FAULT, expected
    if isinstance(expected, DriveState):
        return expected, FaultReason.NONE
    return before, FaultReason.OVERCURRENT if before is FAULT else FaultReason.NONE


@pytest.mark.parametrize("before", list(DriveState))
@pytest.mark.parametrize("event", list(DriveEvent))
def test_every_transition_by_frames(before: DriveState, event: DriveEvent) -> None:
    """HFP-091 HFP-092 HFP-099 HFP-130 HFP-131 HFP-135 HFP-140 and the table of the specification."""
    s = Script("walk", **SETTINGS)
    PREPARE[before](s)
    assert s.drive.state is before
    HAPPEN[event](s)
    assert (s.drive.state, s.drive.fault) == after(before, EXPECTED[event][before])
    assert (s.drive.reference_raw is not None) == (s.drive.state is OPERATIONAL)


def test_host_lost_while_armed() -> None:
    """HFP-084 where the arm timeout does not come first."""
    s = Script("walk", **{**SETTINGS, "arm_timeout_us": 10_000_000})
    s.arm()
    host_lost(s)
    assert (s.drive.state, s.drive.fault) == (FAULT, FaultReason.HOST_HEARTBEAT_LOST)


def test_the_table_holds_these_transitions_and_no_others() -> None:
    same_by_table = {
        (DISABLED, DriveEvent.ENABLE): ARMED,
        (ARMED, DriveEvent.DISABLE): DISABLED,
        (ARMED, DriveEvent.REFERENCE): OPERATIONAL,
        (OPERATIONAL, DriveEvent.DISABLE): DISABLED,
        (FAULT, DriveEvent.RESET): DISABLED,
    }
    faulting = {
        DISABLED: {DriveEvent.VERSION_MISFIT, DriveEvent.ESTOP, DriveEvent.TRIP},
        ARMED: {
            DriveEvent.VERSION_MISFIT,
            DriveEvent.ESTOP,
            DriveEvent.TRIP,
            DriveEvent.REFERENCE_OFF,
            DriveEvent.REFERENCE_OUTSIDE,
            DriveEvent.ARM_EXPIRED,
            DriveEvent.HOST_LOST,
        },
        OPERATIONAL: {
            DriveEvent.VERSION_MISFIT,
            DriveEvent.ESTOP,
            DriveEvent.TRIP,
            DriveEvent.REFERENCE_OUTSIDE,
            DriveEvent.REFERENCE_JUMP,
            DriveEvent.WATCHDOG_EXPIRED,
            DriveEvent.HOST_LOST,
        },
    }
    expected = same_by_table | {(state, event): FAULT for state, events in faulting.items() for event in events}
    actual = {(state, event): target for state, row in DRIVE_TRANSITIONS.items() for event, target in row.items()}
    assert actual == expected


def test_every_faulting_event_has_a_reason() -> None:
    faulting = {event for row in DRIVE_TRANSITIONS.values() for event, target in row.items() if target is FAULT}
    assert set(DRIVE_REASONS) == faulting - {DriveEvent.TRIP}
    assert len(set(DRIVE_REASONS.values())) == len(DRIVE_REASONS)
    assert FaultReason.NONE not in DRIVE_REASONS.values()


def test_first_reason_wins_and_reset_clears_it() -> None:
    """HFP-131, HFP-132: every reason stays through every other."""
    for first in list(FaultReason)[1:]:
        s = Script("walk")
        s.heartbeat(LOW)
        s.trip(first)
        for other in list(FaultReason)[1:]:
            s.trip(other)
            s.receive(codec.encode(Estop(NODE)))  # HFP-141
        assert s.drive.fault is first
        s.heartbeat(RESET)
        assert (s.drive.state, s.drive.fault) == (DISABLED, FaultReason.NONE)


def test_hfp_090_a_drive_starts_disabled() -> None:
    s = Script("start")
    assert (s.drive.state, s.drive.fault, s.drive.reference_raw) == (DISABLED, FaultReason.NONE, None)


def test_a_trip_needs_a_reason() -> None:
    s = Script("walk")
    with pytest.raises(ValueError, match="reason"):
        s.drive.trip(FaultReason.NONE)
