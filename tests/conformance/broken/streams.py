"""Drives broken in: sequences, measurements, discovery."""

from collections.abc import Callable
from typing import Any

from firmware_protocol.drive.discovery import identity_delay_us
from firmware_protocol.frames import MAX_NODE, Frame
from firmware_protocol.messages import (
    AssignNode,
    DriveState,
    Function,
    HostHeartbeat,
    Setpoint,
)
from tests.conformance.broken.table import (
    Frames,
    Handler,
    breaks,
    on_sent,
    resend,
    wrap,
)
from tests.conformance.devices import NODE, SERIAL_NUMBER, Device

# -- sequences ---------------------------------------------------------------------------------------------------------


@breaks(40)
def heartbeat_sequence_by_two(d: Device) -> None:
    def poll(old: Handler, now_us: int) -> Frames:
        before = d.machine._heartbeat_sequence
        frames = old(now_us)
        if d.machine._heartbeat_sequence != before:
            d.machine._heartbeat_sequence = (before + 2) & 0xFF
        return frames

    wrap(d, "poll", poll)


@breaks(41)
def timing_counts_for_itself(d: Device) -> None:
    on_sent(d, resend(Function.TIMING, lambda m: m._replace(sequence=(m.sequence + 1) & 0xFF)))


def beats_taken(d: Device, allow: Callable[[int], bool]) -> None:
    """Take host heartbeats of other advances, too."""

    def beat(old: Handler, message: HostHeartbeat, *rest: Any) -> Frames:
        machine = d.machine
        if machine._host_present and allow((message.sequence - machine._host_sequence) & 0xFF):
            machine._host_sequence = (message.sequence - 1) & 0xFF
        return old(message, *rest)

    wrap(d.machine, "_on_host_heartbeat", beat)


@breaks(42)
def takes_128_ahead(d: Device) -> None:
    beats_taken(d, lambda advance: advance == 128)


@breaks(83)
def takes_old_heartbeats(d: Device) -> None:
    beats_taken(d, lambda advance: advance >= 256 - 16)


@breaks(43)
def echoes_what_it_dropped(d: Device) -> None:
    def sample(old: Handler, now_us: int) -> Frames:
        kept = d.machine._setpoint_sequence
        d.machine._setpoint_sequence = getattr(d, "heard", kept)
        frames = old(now_us)
        d.machine._setpoint_sequence = kept
        return frames

    def setpoint(old: Handler, message: Setpoint, *rest: Any) -> Frames:
        d.heard = message.sequence  # type: ignore[attr-defined]
        return old(message, *rest)

    wrap(d, "sample", sample)
    wrap(d.machine, "_on_setpoint", setpoint)


@breaks(46)
def counts_lost_in_the_heartbeat_only_to_8(d: Device) -> None:
    def setpoint(old: Handler, *a: Any) -> Frames:
        before = d.machine.counters["setpoints_lost"]
        frames = old(*a)
        d.machine.counters["setpoints_lost"] = min(d.machine.counters["setpoints_lost"], before + 8)
        return frames

    wrap(d.machine, "_on_setpoint", setpoint)


# -- measurements ------------------------------------------------------------------------------------------------------


@breaks(50)
def stamps_when_it_sends(d: Device) -> None:
    def late(m: Any) -> Any:
        return m._replace(stamp_us=(m.stamp_us + m.sequence * 37 % 300) & 0xFFFF_FFFF)

    on_sent(d, resend(Function.TIMING, late))


@breaks(51)
def stamps_jump_at_a_fault(d: Device) -> None:
    def jump(m: Any) -> Any:
        return m._replace(stamp_us=(m.stamp_us + 50_000 * d.machine.counters["faults"]) & 0xFFFF_FFFF)

    on_sent(d, resend(Function.TIMING, jump))


@breaks(52)
def clock_300_ppm_fast(d: Device) -> None:
    on_sent(d, resend(Function.TIMING, lambda m: m._replace(stamp_us=round(m.stamp_us * 1.0003))))


@breaks(55)
def no_measurements_in_fault(d: Device) -> None:
    wrap(d, "sample", lambda old, t: [] if d.machine.state is DriveState.FAULT and t // 1000 % 2 else old(t))


@breaks(56)
def now_and_then_late(d: Device) -> None:
    held: Frames = []

    def sample(old: Handler, now_us: int) -> Frames:
        held.extend(old(now_us))
        if now_us // 1000 % 50 < 3:
            return []
        frames, held[:] = list(held), []
        return frames

    wrap(d, "sample", sample)


# -- discovery ---------------------------------------------------------------------------------------------------------


@breaks(60)
def hides_in_fault(d: Device) -> None:
    def discover(old: Handler, *a: Any) -> Frames:
        return [] if d.machine.state is DriveState.FAULT and d.machine.node == NODE else old(*a)

    wrap(d.machine, "_on_discover", discover)


@breaks(61)
def waits_longer_unless_it_has_just_moved(d: Device) -> None:
    moved = [False]

    def assign(old: Handler, *a: Any) -> Frames:
        moved[0] = True
        return old(*a)

    def discover(old: Handler, message: Any, now_us: int, theta: int) -> Frames:
        due = d.machine._identity_due_us
        old(message, now_us, theta)
        if due is None and not moved[0]:
            d.machine._identity_due_us = now_us + identity_delay_us(SERIAL_NUMBER, d.machine._discoveries - 1) + 3_000
        moved[0] = False
        return []

    wrap(d.machine, "_on_assign_node", assign)
    wrap(d.machine, "_on_discover", discover)


@breaks(68)
def counts_assignments_as_answers(d: Device) -> None:
    def assign(old: Handler, *a: Any) -> Frames:
        frames = old(*a)
        d.machine._discoveries += len(frames)
        return frames

    wrap(d.machine, "_on_assign_node", assign)


@breaks(62)
def answers_every_discover(d: Device) -> None:
    waiting = []

    def discover(old: Handler, message: Any, now_us: int, theta: int) -> Frames:
        if d.machine._identity_due_us is not None:
            waiting.append(now_us + 34_000)
        return old(message, now_us, theta)

    def poll(old: Handler, now_us: int) -> Frames:
        frames = old(now_us)
        while waiting and waiting[0] <= now_us:
            waiting.pop(0)
            frames.append(d.machine._identity())
        return frames

    wrap(d.machine, "_on_discover", discover)
    wrap(d, "poll", poll)


@breaks(63)
def says_its_new_node_late(d: Device) -> None:
    due: list[tuple[int, Frame]] = []

    def assign(old: Handler, message: AssignNode, now_us: int, theta: int) -> Frames:
        due.extend((now_us + 12_000, frame) for frame in old(message, now_us, theta))
        return []

    def poll(old: Handler, now_us: int) -> Frames:
        frames = old(now_us)
        while due and due[0][0] <= now_us:
            frames.append(due.pop(0)[1])
        return frames

    wrap(d.machine, "_on_assign_node", assign)
    wrap(d, "poll", poll)


def uncounted(d: Device, name: str, when: Callable[[Any], bool]) -> None:
    """Refuse without counting."""

    def handle(old: Handler, message: Any, *rest: Any) -> Frames:
        kept = dict(d.machine.counters) if when(message) else None
        frames = old(message, *rest)
        if kept is not None:
            d.machine.counters.update(kept)
        return frames

    wrap(d.machine, name, handle)


@breaks(64)
def does_not_count_assign_while_armed(d: Device) -> None:
    uncounted(d, "_on_assign_node", lambda _: d.machine.state is DriveState.ARMED)


@breaks(64)
def moves_while_in_fault(d: Device) -> None:
    def assign(old: Handler, message: AssignNode, *rest: Any) -> Frames:
        state = d.machine.state
        if state is DriveState.FAULT:
            d.machine.state = DriveState.DISABLED
        frames = old(message, *rest)
        d.machine.state = state
        return frames

    wrap(d.machine, "_on_assign_node", assign)


@breaks(65)
def does_not_count_an_impossible_node(d: Device) -> None:
    uncounted(d, "_on_assign_node", lambda m: m.new_node > MAX_NODE)


@breaks(66)
def compares_half_a_serial_number(d: Device) -> None:
    def assign(old: Handler, message: AssignNode, *rest: Any) -> Frames:
        own = d.machine.config.serial_number
        if (message.serial_number ^ own) & 0xFFFFFF == 0:
            message = message._replace(serial_number=own)
        return old(message, *rest)

    wrap(d.machine, "_on_assign_node", assign)
