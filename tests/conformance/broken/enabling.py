"""Drives broken in: heartbeats, enabling."""

from collections.abc import Callable
from typing import Any

from firmware_protocol.messages import (
    AssignNode,
    DriveHeartbeat,
    DriveState,
    FaultReason,
    Function,
    HostHeartbeat,
)
from firmware_protocol.states import DriveEvent
from tests.conformance.broken.table import (
    ENABLE,
    Frames,
    Handler,
    breaks,
    judges,
    on_sent,
    resend,
    wrap,
)
from tests.conformance.devices import Device

# -- heartbeats --------------------------------------------------------------------------------------------------------


@breaks(81)
def rare_heartbeats_in_fault(d: Device) -> None:
    def poll(old: Handler, now_us: int) -> Frames:
        machine = d.machine
        if machine.state is DriveState.FAULT and not machine._announce and now_us - machine._heartbeat_us < 130_000:
            machine._heartbeat_period_us, kept = 130_000, machine._heartbeat_period_us
            frames = old(now_us)
            machine._heartbeat_period_us = kept
            return frames
        return old(now_us)

    wrap(d, "poll", poll)


@breaks(82)
def does_not_announce(d: Device) -> None:
    def poll(old: Handler, now_us: int) -> Frames:
        d.machine._announce = False
        return old(now_us)

    wrap(d, "poll", poll)


def ignores(d: Device, event: DriveEvent, state: DriveState) -> None:
    """Leave an event without effect in one state."""

    def fire(old: Any, happened: DriveEvent, *reason: Any) -> None:
        if not (happened is event and d.machine.state is state):
            old(happened, *reason)

    wrap(d.machine, "_fire", fire)


@breaks(84)
def armed_without_a_host(d: Device) -> None:
    ignores(d, DriveEvent.HOST_LOST, DriveState.ARMED)


@breaks(84)
def operational_without_a_host(d: Device) -> None:
    ignores(d, DriveEvent.HOST_LOST, DriveState.OPERATIONAL)


@breaks(85)
def low_bits_after_a_change_of_node(d: Device) -> None:
    def assign(old: Handler, *a: Any) -> Frames:
        before = d.machine.node
        frames = old(*a)
        if d.machine.node != before:
            d.machine._levels = 0
        return frames

    wrap(d.machine, "_on_assign_node", assign)


@breaks(88)
def nothing_new_where_the_node_is_the_same(d: Device) -> None:
    def assign(old: Handler, message: AssignNode, *rest: Any) -> Frames:
        machine = d.machine
        if message.new_node != machine.node or message.serial_number != machine.config.serial_number:
            return old(message, *rest)
        return [machine._identity()] if machine.state is DriveState.DISABLED else old(message, *rest)

    wrap(d.machine, "_on_assign_node", assign)


@breaks(88)
def does_not_answer_where_the_node_is_the_same(d: Device) -> None:
    def assign(old: Handler, message: AssignNode, *rest: Any) -> Frames:
        same = message.new_node == d.machine.node and d.machine.state is DriveState.DISABLED
        frames = old(message, *rest)
        return [] if same else frames

    wrap(d.machine, "_on_assign_node", assign)


@breaks(85)
def remembers_the_sequence_of_a_lost_host(d: Device) -> None:
    def expire(old: Any, now_us: int) -> None:
        present = d.machine._host_present
        old(now_us)
        d.old = getattr(d, "old", False) or (present and not d.machine._host_present)  # type: ignore[attr-defined]

    def beat(old: Handler, message: HostHeartbeat, *rest: Any) -> Frames:
        behind = (d.machine._host_sequence - message.sequence) & 0xFF
        if getattr(d, "old", False) and 0 <= behind < 128:
            d.machine.counters["heartbeat_stale"] += 1
            return []
        d.old = False  # type: ignore[attr-defined]
        return old(message, *rest)

    wrap(d.machine, "_expire", expire)
    wrap(d.machine, "_on_host_heartbeat", beat)


@breaks(86)
def rejected_in_one_byte(d: Device) -> None:
    on_sent(d, resend(Function.DRIVE_HEARTBEAT, lambda m: m._replace(rejected=m.rejected & 0xFF)))


@breaks(86)
def rejected_wraps(d: Device) -> None:
    def wrapped(m: DriveHeartbeat) -> DriveHeartbeat:
        return m._replace(rejected=d.machine.rejected() & 0xFFFF)

    on_sent(d, resend(Function.DRIVE_HEARTBEAT, wrapped))


# -- enabling ----------------------------------------------------------------------------------------------------------


def keeps_torque(d: Device, while_true: Callable[[], bool]) -> None:
    """Obey the last reference longer than the protocol allows."""
    last: list[int] = []

    def goal(old: Callable[[], int | None]) -> int | None:
        reference = old()
        if reference is not None:
            last[:] = [reference]
        elif last and while_true():
            return last[0] + 200_000
        else:
            last.clear()
        return reference

    wrap(d, "goal", goal)


@breaks(91)
def torque_after_estop(d: Device) -> None:
    keeps_torque(d, lambda: d.machine.fault is FaultReason.ESTOP)


@breaks(123)
def torque_after_the_watchdog(d: Device) -> None:
    left = [0]

    def still() -> bool:
        left[0] = left[0] + 1 if d.machine.fault is FaultReason.WATCHDOG else 0
        return 0 < left[0] < 15

    keeps_torque(d, still)


@breaks(92)
def wants_its_own_minor_version(d: Device) -> None:
    def beat(old: Handler, message: HostHeartbeat, *rest: Any) -> Frames:
        if message.protocol_minor:
            message = message._replace(control=message.control & ~ENABLE)
        return old(message, *rest)

    wrap(d.machine, "_on_host_heartbeat", beat)


@breaks(93)
def enables_after_ten_high(d: Device) -> None:
    count = [0]

    def beat(old: Handler, message: HostHeartbeat, now_us: int, theta: int) -> Frames:
        frames = old(message, now_us, theta)
        idle = message.control & ENABLE and d.machine.state is DriveState.DISABLED
        count[0] = count[0] + 1 if idle else 0
        if count[0] > 10:
            d.machine._armed_us = now_us
            d.machine._fire(DriveEvent.ENABLE)
        return frames

    wrap(d.machine, "_on_host_heartbeat", beat)


@breaks(94)
def compares_seven_bits_of_the_version(d: Device) -> None:
    def beat(old: Handler, message: HostHeartbeat, *rest: Any) -> Frames:
        if message.protocol_major == 129:
            message = message._replace(protocol_major=1)
        return old(message, *rest)

    wrap(d.machine, "_on_host_heartbeat", beat)


@breaks(95)
def armed_whatever_the_version(d: Device) -> None:
    ignores(d, DriveEvent.VERSION_MISFIT, DriveState.ARMED)


@breaks(95)
def operational_whatever_the_version(d: Device) -> None:
    ignores(d, DriveEvent.VERSION_MISFIT, DriveState.OPERATIONAL)


@breaks(96)
def tolerance_not_included(d: Device) -> None:
    def change(event: DriveEvent, reference: int, _: int, theta: int) -> DriveEvent:
        edge = d.machine.state is DriveState.ARMED and abs(reference - theta) == d.machine._reference_tolerance_raw
        return DriveEvent.REFERENCE_OFF if edge and event is DriveEvent.REFERENCE else event

    judges(d, change)


@breaks(97)
def tolerant_by_whole_turns(d: Device) -> None:
    def change(event: DriveEvent, reference: int, _: int, theta: int) -> DriveEvent:
        turned = reference != theta and (reference - theta) % (1 << 24) == 0
        return DriveEvent.REFERENCE if event is DriveEvent.REFERENCE_OFF and turned else event

    judges(d, change)


@breaks(98)
def armed_for_ever(d: Device) -> None:
    ignores(d, DriveEvent.ARM_EXPIRED, DriveState.ARMED)


@breaks(99)
def armed_although_enable_is_low(d: Device) -> None:
    ignores(d, DriveEvent.DISABLE, DriveState.ARMED)


@breaks(99)
def operational_although_enable_is_low(d: Device) -> None:
    ignores(d, DriveEvent.DISABLE, DriveState.OPERATIONAL)
