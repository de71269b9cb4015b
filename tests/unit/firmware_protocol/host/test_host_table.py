"""The host's phases by table: every transition by frames and calls (HFP-070 to HFP-087)."""

from collections.abc import Callable

import pytest

from firmware_protocol.host.machine import HostPhase
from firmware_protocol.messages import (
    DriveState,
    FaultReason,
    Identity,
)
from firmware_protocol.states import HOST_COMMANDS, HOST_TRANSITIONS, HostEvent
from tests.unit.firmware_protocol.host.desk import NODE, SERIAL, Desk, P

PREPARE: dict[HostPhase, Callable[[Desk], None]] = {
    P.DISCONNECTED: lambda _: None,
    P.IDENTIFYING: lambda d: d.host.connect(d.now_ns),
    P.READY: Desk.ready,
    P.ENABLING: Desk.armed,
    P.RUNNING: Desk.running,
    P.FAULT: Desk.faulted,
    P.REFUSED: Desk.refused,
}
HAPPEN: dict[HostEvent, Callable[[Desk], object]] = {
    HostEvent.CONNECT: lambda d: d.host.connect(d.now_ns),
    HostEvent.ENABLE: lambda d: d.host.enable(),
    HostEvent.DISABLE: lambda d: d.host.disable(),
    HostEvent.RESET: lambda d: d.host.reset_fault(),
    HostEvent.IDENTIFIED: lambda d: d.hear(Identity(NODE, SERIAL, 1, 9)),
    HostEvent.MISFIT: lambda d: d.hear(Identity(NODE, SERIAL, 2, 0)),
    HostEvent.SAW_DISABLED: lambda d: d.sample(DriveState.DISABLED),
    HostEvent.SAW_ARMED: lambda d: d.sample(DriveState.ARMED),
    HostEvent.SAW_OPERATIONAL: lambda d: d.sample(DriveState.OPERATIONAL),
    HostEvent.SAW_FAULT: lambda d: d.sample(DriveState.FAULT, FaultReason.WATCHDOG),
    HostEvent.GONE: lambda d: d.wait(260),
    HostEvent.ENABLE_EXPIRED: lambda d: d.wait(1_001, int(d.host.drive_state or 0)),
}
EXPECTED: dict[HostPhase, dict[HostEvent, HostPhase]] = {
    P.DISCONNECTED: {HostEvent.CONNECT: P.IDENTIFYING},
    P.IDENTIFYING: {HostEvent.IDENTIFIED: P.READY, HostEvent.MISFIT: P.REFUSED},
    P.READY: {
        HostEvent.ENABLE: P.ENABLING,
        HostEvent.SAW_FAULT: P.FAULT,
        HostEvent.GONE: P.DISCONNECTED,
        HostEvent.MISFIT: P.REFUSED,
    },
    P.ENABLING: {
        HostEvent.DISABLE: P.READY,
        HostEvent.ENABLE_EXPIRED: P.READY,
        HostEvent.SAW_OPERATIONAL: P.RUNNING,
        HostEvent.SAW_FAULT: P.FAULT,
        HostEvent.GONE: P.DISCONNECTED,
        HostEvent.MISFIT: P.REFUSED,
    },
    P.RUNNING: {
        HostEvent.DISABLE: P.READY,
        HostEvent.SAW_DISABLED: P.READY,
        HostEvent.SAW_ARMED: P.READY,
        HostEvent.SAW_FAULT: P.FAULT,
        HostEvent.GONE: P.DISCONNECTED,
        HostEvent.MISFIT: P.REFUSED,
    },
    P.FAULT: {HostEvent.SAW_DISABLED: P.READY, HostEvent.GONE: P.DISCONNECTED, HostEvent.MISFIT: P.REFUSED},
    P.REFUSED: {HostEvent.CONNECT: P.IDENTIFYING},
}
ALLOWED = {
    HostEvent.CONNECT: {P.DISCONNECTED, P.IDENTIFYING, P.REFUSED},
    HostEvent.ENABLE: {P.READY, P.ENABLING, P.RUNNING},
    HostEvent.DISABLE: set(P),
    HostEvent.RESET: {P.FAULT},
}


def test_the_tables_are_these() -> None:
    assert HOST_TRANSITIONS == EXPECTED
    assert {event: set(phases) for event, phases in HOST_COMMANDS.items()} == ALLOWED


@pytest.mark.parametrize("phase", list(P))
@pytest.mark.parametrize("event", list(HostEvent))
def test_every_transition_by_frames_and_calls(phase: HostPhase, event: HostEvent) -> None:
    desk = Desk()
    PREPARE[phase](desk)
    assert desk.host.phase is phase
    if phase not in ALLOWED.get(event, set(P)):
        with pytest.raises(ValueError, match=event.name):
            HAPPEN[event](desk)
        assert desk.host.phase is phase
        return
    HAPPEN[event](desk)
    assert desk.host.phase is EXPECTED[phase].get(event, phase)
