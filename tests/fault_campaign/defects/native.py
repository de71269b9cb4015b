"""Defects of both ends of the project's own protocol."""

from typing import Any

import pytest

from firmware_protocol import codec
from firmware_protocol.drive.machine import DriveMachine
from firmware_protocol.host.machine import HostMachine
from firmware_protocol.host.samples import SampleAssembler
from firmware_protocol.messages import DriveState
from firmware_protocol.states import DRIVE_TRANSITIONS, DriveEvent
from tests.fault_campaign.defects.table import around, defect
from tests.fault_campaign.schedule import Kind

NATIVE = ("native", "native_fd")


@defect("torque", profiles=NATIVE)
def drive_without_watchdog(patch: pytest.MonkeyPatch) -> None:
    """The drive's table has no watchdog."""
    patch.delitem(DRIVE_TRANSITIONS[DriveState.OPERATIONAL], DriveEvent.WATCHDOG_EXPIRED)


@defect("torque", profiles=NATIVE, among=(Kind.DROP, Kind.FULL_QUEUE, Kind.STALLED_ESTIMATOR))
def heartbeats_feed_the_watchdog(patch: pytest.MonkeyPatch) -> None:
    """Any frame to the drive feeds its watchdog."""

    def receive(old: Any, machine: Any, frame: Any, now_us: int, theta: int) -> Any:
        machine._fed_us = now_us
        return old(machine, frame, now_us, theta)

    around(patch, DriveMachine, "receive", receive)


@defect("torque", "end", profiles=NATIVE)
def fault_keeps_the_reference(patch: pytest.MonkeyPatch) -> None:
    """A drive that faults goes on following its last reference."""

    def fire(old: Any, machine: Any, *event: Any) -> None:
        reference = machine.reference_raw
        old(machine, *event)
        if machine.state is DriveState.FAULT:
            machine.reference_raw = reference

    around(patch, DriveMachine, "_fire", fire)


@defect("limits", "kick", profiles=("native",), among=(Kind.CORRUPT_PAYLOAD,))
def nobody_looks_at_a_check(patch: pytest.MonkeyPatch) -> None:
    """Frames with a wrong CRC are taken, and the drive judges no reference."""
    for identifier, route in list(codec._ROUTES.items()):
        patch.setitem(codec._ROUTES, identifier, (*route[:3], 0, *route[4:]))
    around(patch, DriveMachine, "_judge_reference", lambda *_: DriveEvent.REFERENCE)


@defect("lost", profiles=NATIVE)
def lost_samples_are_not_counted(patch: pytest.MonkeyPatch) -> None:
    """The host doesn't count numbers that are missing."""

    def complete(old: Any, assembler: Any, *values: Any) -> Any:
        lost = assembler._counters["lost_feedback"]
        made = old(assembler, *values)
        assembler._counters["lost_feedback"] = lost
        return made

    around(patch, SampleAssembler, "_complete", complete)


@defect("end", profiles=NATIVE, among=(Kind.DROP, Kind.FULL_QUEUE, Kind.DELAY))
def host_takes_armed_for_disabled(patch: pytest.MonkeyPatch) -> None:
    """The host says DISABLED as soon as it has asked for it."""

    def disable(old: Any, machine: Any) -> None:
        old(machine)
        machine.drive_state, machine._see = DriveState.DISABLED, lambda *_: None

    around(patch, HostMachine, "disable", disable)


@defect("kick", profiles=NATIVE)
def drive_follows_from_anywhere(patch: pytest.MonkeyPatch) -> None:
    """The host enables with a reference of its own, and the drive looks at no tolerance."""

    def setpoint(old: Any, machine: Any, raw: int) -> Any:
        taken = machine._samples.taken
        if machine.phase.name != "RUNNING" and taken is not None:
            machine._samples.taken = taken._replace(theta_m=taken.theta_m + (1 << 17))
        frame = old(machine, raw)
        machine._samples.taken = taken
        return frame

    around(patch, HostMachine, "setpoint", setpoint)
    around(patch, DriveMachine, "_judge_reference", lambda *_: DriveEvent.REFERENCE)
