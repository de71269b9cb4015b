"""Drives broken in: references, watchdog."""

from collections.abc import Callable
from typing import Any

from firmware_protocol import codec
from firmware_protocol.drive.parameter_values import ParameterStore
from firmware_protocol.frames import Frame
from firmware_protocol.messages import (
    DriveState,
    Function,
    HostHeartbeat,
    ParamOp,
    Setpoint,
)
from firmware_protocol.parameters import Index
from firmware_protocol.states import DriveEvent
from tests.conformance.broken.table import (
    Frames,
    Handler,
    breaks,
    executes,
    host_frame,
    judges,
    wrap,
)
from tests.conformance.devices import Device

# -- references --------------------------------------------------------------------------------------------------------


def fresh_also(d: Device, when: Callable[[Setpoint], int]) -> None:
    """Take references that are not fresh: `when` returns the advance to take, 0 to go by the rules."""
    wrap(d.machine, "_freshness", lambda old, message: when(message) or old(message))


def advance_of(d: Device, message: Setpoint) -> int:
    return (message.sequence - d.machine._setpoint_sequence) & 0xFF


def age_of(d: Device, message: Setpoint) -> int:
    return (d.machine._sequence - message.sample_sequence) & 0xFF


@breaks(110)
def takes_references_far_ahead(d: Device) -> None:
    operational = DriveState.OPERATIONAL
    fresh_also(d, lambda m: int(d.machine.state is operational and 128 <= advance_of(d, m) < 200))


@breaks(111)
def wants_a_new_sequence_in_armed(d: Device) -> None:
    def fresh(old: Callable[[Setpoint], int], message: Setpoint) -> int:
        stale = d.machine.state is DriveState.ARMED and not 1 <= advance_of(d, message) <= 127
        return 0 if stale else old(message)

    wrap(d.machine, "_freshness", fresh)


@breaks(112)
def takes_samples_one_too_old(d: Device) -> None:
    def adopt(old: Callable[[], None]) -> None:
        old()
        d.machine._max_sample_age += 1

    wrap(d.machine, "_adopt_parameters", adopt)


@breaks(113)
def takes_samples_to_come(d: Device) -> None:
    def ahead(message: Setpoint) -> int:
        running = d.machine.state is DriveState.OPERATIONAL
        return int(running and age_of(d, message) > 256 - 9 and advance_of(d, message) == 1)

    fresh_also(d, ahead)


@breaks(114)
def accepts_references_in_fault(d: Device) -> None:
    def fresh(old: Callable[[Setpoint], int], message: Setpoint) -> int:
        if d.machine.state is DriveState.FAULT:
            d.machine.counters["setpoints_accepted"] += 1
            return 0
        return old(message)

    wrap(d.machine, "_freshness", fresh)


@breaks(115)
def limit_not_included(d: Device) -> None:
    def change(event: DriveEvent, reference: int, *_: int) -> DriveEvent:
        return DriveEvent.REFERENCE_OUTSIDE if reference == d.machine._theta_max_raw else event

    judges(d, change)


@breaks(115)
def lower_limit_too_low(d: Device) -> None:
    def change(event: DriveEvent, reference: int, *_: int) -> DriveEvent:
        low = d.machine._theta_min_raw
        return DriveEvent.REFERENCE if low - 1000 < reference < low else event

    judges(d, change)


@breaks(118)
def tolerance_before_limits(d: Device) -> None:
    def change(event: DriveEvent, reference: int, _: int, theta: int) -> DriveEvent:
        off = abs(reference - theta) > d.machine._reference_tolerance_raw
        outside = event is DriveEvent.REFERENCE_OUTSIDE and d.machine.state is DriveState.ARMED
        return DriveEvent.REFERENCE_OFF if outside and off else event

    judges(d, change)


@breaks(118)
def step_before_limits(d: Device) -> None:
    def change(event: DriveEvent, reference: int, *_: int) -> DriveEvent:
        far = abs(reference - d.machine._reference_wire) > d.machine._max_step_raw
        outside = event is DriveEvent.REFERENCE_OUTSIDE and d.machine.state is DriveState.OPERATIONAL
        return DriveEvent.REFERENCE_JUMP if outside and far else event

    judges(d, change)


@breaks(116)
def step_limit_without_end(d: Device) -> None:
    def change(event: DriveEvent, reference: int, advance: int, _: int) -> DriveEvent:
        step = abs(reference - d.machine._reference_wire)
        lenient = event is DriveEvent.REFERENCE_JUMP and step <= advance * d.machine._max_step_raw
        return DriveEvent.REFERENCE if lenient else event

    judges(d, change)


@breaks(117)
def turns_the_wrong_way(d: Device) -> None:
    start: list[float] = []

    def goal(old: Callable[[], int | None]) -> int | None:
        reference = old()
        if reference is None:
            start.clear()
            return None
        start.extend([reference] * (not start))
        return round(2 * start[0] - reference)

    wrap(d, "goal", goal)


# -- watchdog ----------------------------------------------------------------------------------------------------------


@breaks(120)
def watchdog_with_another_reason(d: Device) -> None:
    def fire(old: Any, event: DriveEvent, *reason: Any) -> None:
        old(DriveEvent.HOST_LOST if event is DriveEvent.WATCHDOG_EXPIRED else event, *reason)

    wrap(d.machine, "_fire", fire)


@breaks(120)
def watchdog_too_early(d: Device) -> None:
    def adopt(old: Any) -> None:
        old()
        d.machine._watchdog_timeout_us = d.machine._watchdog_timeout_us * 4 // 5

    wrap(d.machine, "_adopt_parameters", adopt)


@breaks(121)
def watchdog_by_poll_only(d: Device) -> None:
    def setpoint(old: Handler, frame: Frame, *rest: Any) -> Frames:
        machine = d.machine
        if not host_frame(frame, Function.SETPOINT) or codec.Decoder().decode(frame) is None:
            return old(frame, *rest)
        machine._watchdog_timeout_us, kept = machine._watchdog_timeout_us + 5000, machine._watchdog_timeout_us
        frames = old(frame, *rest)
        machine._watchdog_timeout_us = kept
        return frames

    wrap(d.machine, "receive", setpoint)


@breaks(122)
def heartbeats_feed_the_watchdog(d: Device) -> None:
    def beat(old: Handler, message: HostHeartbeat, now_us: int, theta: int) -> Frames:
        d.machine._fed_us = now_us
        return old(message, now_us, theta)

    wrap(d.machine, "_on_host_heartbeat", beat)


@breaks(122)
def repeated_references_feed_the_watchdog(d: Device) -> None:
    def setpoint(old: Handler, message: Setpoint, now_us: int, theta: int) -> Frames:
        if advance_of(d, message) == 0:
            d.machine._fed_us = now_us
        return old(message, now_us, theta)

    wrap(d.machine, "_on_setpoint", setpoint)


@breaks(124)
def watchdog_can_be_switched_off(d: Device) -> None:
    def execute(old: Any, store: ParameterStore, op: int, index: int, value: int, disabled: bool) -> Any:
        if op == ParamOp.WRITE and index == Index.WATCHDOG_TIMEOUT and value == 0 and disabled:
            store.put(index, 0)
            return ParamOp.OK, 0
        return old(op, index, value, disabled)

    executes(d, execute)
