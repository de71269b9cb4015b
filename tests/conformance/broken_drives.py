"""Drives that break one requirement each: the Python drive with one thing changed, and what must then fail.

A mutation takes a device that is whole and breaks it in place. Where no drive can break one requirement alone, the
row names all that fall together, and why.
"""

from collections.abc import Callable
from types import MethodType
from typing import Any, NamedTuple

from cobs import cobs
from fastcrc.crc8 import autosar

from firmware_protocol import codec
from firmware_protocol.conformance import wire
from firmware_protocol.drive_machine import DriveMachine
from firmware_protocol.drive_parameters import ParameterStore
from firmware_protocol.frames import MAX_NODE, Frame, arbitration_id, split_id
from firmware_protocol.messages import (
    AssignNode,
    Control,
    DriveHeartbeat,
    DriveState,
    FaultReason,
    Function,
    HostHeartbeat,
    Identity,
    ParamOp,
    ParamRequest,
    Setpoint,
)
from firmware_protocol.parameters import BY_INDEX, Index
from firmware_protocol.serial_framing import SerialReader
from firmware_protocol.states import DriveEvent
from tests.conformance.devices import NODE, Device

Break = Callable[[Device], None]
Frames = list[Frame]
ENABLE, RESET = Control.ENABLE, Control.FAULT_RESET


class Broken(NamedTuple):
    """A broken drive: how it is broken, what must fail, and on which line it is found."""

    name: str
    fails: frozenset[int]
    line: str  # can, fd or serial
    mutate: Break


BROKEN: list[Broken] = []


def breaks(*fails: int, line: str = "can") -> Callable[[Break], Break]:
    """Enter a mutation into the table."""

    def enter(mutate: Break) -> Break:
        BROKEN.append(Broken(mutate.__name__, frozenset(fails), line, mutate))
        return mutate

    return enter


def wrap(owner: Any, name: str, around: Callable[..., Any]) -> None:
    """Replace a method by `around(old, ...)`; the drive's table of handlers is renewed."""
    old = getattr(owner, name)
    setattr(owner, name, lambda *arguments: around(old, *arguments))
    if isinstance(owner, DriveMachine):
        owner._take_node(owner.node)


def on_sent(d: Device, change: Callable[[Frame], Frames]) -> None:
    """Change what the drive sends, frame by frame."""
    for name in ("receive", "poll", "sample"):
        wrap(d, name, lambda old, *a: [new for frame in old(*a) for new in change(frame)])


def resend(function: Function, change: Callable[[Any], Any]) -> Callable[[Frame], Frames]:
    """Return a change of one message's fields, sealed anew."""
    decoder = codec.Decoder()

    def of(frame: Frame) -> Frames:
        if split_id(frame.arbitration_id)[0] != function:
            return [frame]
        return [codec.encode(change(decoder.decode(frame)))]

    return of


def host_frame(frame: Frame, function: Function) -> bool:
    return split_id(frame.arbitration_id) == (function, NODE)


def has_known_index(frame: Frame) -> bool:
    """Tell a request from garbage, which may be right by chance where half of the rules are missing."""
    return len(frame.data) == 8 and int.from_bytes(frame.data[1:3], "little") in BY_INDEX


# -- ids --------------------------------------------------------------------------------------------------------------


@breaks(2)
def takes_extended_ids(d: Device) -> None:
    d.receive_foreign = lambda frame, remote, now_ns: [] if remote else d.receive(frame, now_ns)  # type: ignore[method-assign]


@breaks(2)
def answers_remote_frames(d: Device) -> None:
    def foreign(frame: Frame, remote: bool, now_ns: int) -> Frames:
        return d.receive(frame, now_ns) if remote and split_id(frame.arbitration_id)[0] == Function.DISCOVER else []

    d.receive_foreign = foreign  # type: ignore[method-assign]


@breaks(10)
def ignores_a_bit_of_the_function(d: Device) -> None:
    def receive(old: Any, frame: Frame, now_ns: int) -> Frames:
        function, node = split_id(frame.arbitration_id)
        if function == Function.PARAM_REQUEST | 0x20:
            frame = wire.sealed8(Function.PARAM_REQUEST, node, frame.data[:-1])
        return old(frame, now_ns)  # type: ignore[no-any-return]

    wrap(d, "receive", receive)


@breaks(10)
def sends_what_no_drive_sends(d: Device) -> None:
    def double(frame: Frame) -> Frames:
        is_beat = host_frame(frame, Function.DRIVE_HEARTBEAT)
        return [frame, Frame(arbitration_id(0x3C, NODE), b"alive")] if is_beat else [frame]

    on_sent(d, double)


@breaks(11)
def has_no_node_30(d: Device) -> None:
    def assign(old: Any, message: AssignNode, *rest: Any) -> Frames:
        return [] if message.new_node == MAX_NODE else old(message, *rest)

    wrap(d.machine, "_on_assign_node", assign)


@breaks(12)
def stops_for_every_estop(d: Device) -> None:
    def receive(old: Any, frame: Frame, now_ns: int) -> Frames:
        if split_id(frame.arbitration_id)[0] == Function.ESTOP:
            frame = Frame(arbitration_id(Function.ESTOP, 0), b"")
        return old(frame, now_ns)  # type: ignore[no-any-return]

    wrap(d, "receive", receive)


@breaks(12)
def answers_requests_to_all(d: Device) -> None:
    def receive(old: Any, frame: Frame, now_ns: int) -> Frames:
        if frame.arbitration_id == arbitration_id(Function.PARAM_REQUEST, 0):
            frame = wire.sealed8(Function.PARAM_REQUEST, d.machine.node, frame.data[:-1])
        return old(frame, now_ns)  # type: ignore[no-any-return]

    wrap(d, "receive", receive)


@breaks(13)
def counts_damaged_frames_for_others(d: Device) -> None:
    def receive(old: Any, frame: Frame, now_ns: int) -> Frames:
        node = split_id(frame.arbitration_id)[1]
        if node not in (0, d.machine.node) and codec.Decoder().decode(frame) is None:
            d.machine.counters["unknown_id"] += 1
        return old(frame, now_ns)  # type: ignore[no-any-return]

    wrap(d, "receive", receive)


# -- frames -----------------------------------------------------------------------------------------------------------


@breaks(20)
def big_endian_serial_number(d: Device) -> None:
    def swap(m: Identity) -> Identity:
        return m._replace(serial_number=int.from_bytes(m.serial_number.to_bytes(6, "little"), "big"))

    on_sent(d, resend(Function.IDENTITY, swap))


@breaks(21)
def takes_discover_of_any_length(d: Device) -> None:
    def receive(old: Any, frame: Frame, now_ns: int) -> Frames:
        if split_id(frame.arbitration_id)[0] == Function.DISCOVER:
            frame = frame._replace(data=b"")
        return old(frame, now_ns)  # type: ignore[no-any-return]

    wrap(d, "receive", receive)


@breaks(22)
def takes_discover_of_any_format(d: Device) -> None:
    def receive(old: Any, frame: Frame, now_ns: int) -> Frames:
        if split_id(frame.arbitration_id)[0] == Function.DISCOVER:
            frame = frame._replace(is_fd=False)
        return old(frame, now_ns)  # type: ignore[no-any-return]

    wrap(d, "receive", receive)


@breaks(23, line="fd")
def sends_a_reserved_bit(d: Device) -> None:
    def set_bit(frame: Frame) -> Frames:
        function, node = split_id(frame.arbitration_id)
        if function != Function.FD_FEEDBACK:
            return [frame]
        return [wire.sealed16(function, node, frame.data[:13] + b"\x40")]

    on_sent(d, set_bit)


@breaks(24)
def minds_reserved_control_bits(d: Device) -> None:
    def beat(old: Any, message: HostHeartbeat, *rest: Any) -> Frames:
        return [] if message.control > 3 else old(message, *rest)

    wrap(d.machine, "_on_host_heartbeat", beat)


@breaks(24)
def minds_the_reserved_byte_of_setpoints(d: Device) -> None:
    def receive(old: Any, frame: Frame, now_ns: int) -> Frames:
        strange = host_frame(frame, Function.SETPOINT) and len(frame.data) == 8 and frame.data[6] != 0
        good = strange and codec.Decoder().decode(frame) is not None
        return [] if good else old(frame, now_ns)

    wrap(d, "receive", receive)


@breaks(25)
def counts_a_wrong_check_twice(d: Device) -> None:
    def receive(old: Any, frame: Frame, now_ns: int) -> Frames:
        before = d.machine.counters["bad_crc"]
        answers = old(frame, now_ns)
        d.machine.counters["bad_crc"] += d.machine.counters["bad_crc"] - before
        return answers  # type: ignore[no-any-return]

    wrap(d, "receive", receive)


@breaks(30)
def wrong_check_in_heartbeats(d: Device) -> None:
    on_sent(d, lambda f: [wire.damaged(f)] if host_frame(f, Function.DRIVE_HEARTBEAT) else [f])


@breaks(31, line="fd")
def check_of_measurements_big_endian(d: Device) -> None:
    def swap(f: Frame) -> Frames:
        is_it = host_frame(f, Function.FD_FEEDBACK)
        return [f._replace(data=f.data[:-2] + f.data[:-3:-1])] if is_it else [f]

    on_sent(d, swap)


@breaks(32)
def leaves_the_id_out_of_the_check(d: Device) -> None:
    def receive(old: Any, frame: Frame, now_ns: int) -> Frames:
        function, node = split_id(frame.arbitration_id)
        known = function == Function.PARAM_REQUEST and node == d.machine.node and has_known_index(frame)
        if known and frame.data[-1] == autosar(frame.data[:-1]):
            frame = wire.sealed8(function, node, frame.data[:-1])
        return old(frame, now_ns)  # type: ignore[no-any-return]

    wrap(d, "receive", receive)


# -- sequences --------------------------------------------------------------------------------------------------------


@breaks(40)
def heartbeat_sequence_by_two(d: Device) -> None:
    def poll(old: Any, now_us: int) -> Frames:
        before = d.machine._heartbeat_sequence
        frames = old(now_us)
        if d.machine._heartbeat_sequence != before:
            d.machine._heartbeat_sequence = (before + 2) & 0xFF
        return frames  # type: ignore[no-any-return]

    wrap(d, "poll", poll)


@breaks(41)
def timing_counts_for_itself(d: Device) -> None:
    on_sent(d, resend(Function.TIMING, lambda m: m._replace(sequence=(m.sequence + 1) & 0xFF)))


def beats_taken(d: Device, allow: Callable[[int], bool]) -> None:
    """Take host heartbeats of other advances, too."""

    def beat(old: Any, message: HostHeartbeat, *rest: Any) -> Frames:
        machine = d.machine
        if machine._host_present and allow((message.sequence - machine._host_sequence) & 0xFF):
            machine._host_sequence = (message.sequence - 1) & 0xFF
        return old(message, *rest)  # type: ignore[no-any-return]

    wrap(d.machine, "_on_host_heartbeat", beat)


@breaks(42)
def takes_128_ahead(d: Device) -> None:
    beats_taken(d, lambda advance: advance == 128)


@breaks(83)
def takes_old_heartbeats(d: Device) -> None:
    beats_taken(d, lambda advance: advance >= 256 - 16)


@breaks(43)
def echoes_what_it_dropped(d: Device) -> None:
    def sample(old: Any, now_us: int) -> Frames:
        kept = d.machine._setpoint_sequence
        d.machine._setpoint_sequence = getattr(d, "heard", kept)
        frames = old(now_us)
        d.machine._setpoint_sequence = kept
        return frames  # type: ignore[no-any-return]

    def setpoint(old: Any, message: Setpoint, *rest: Any) -> Frames:
        d.heard = message.sequence  # type: ignore[attr-defined]
        return old(message, *rest)  # type: ignore[no-any-return]

    wrap(d, "sample", sample)
    wrap(d.machine, "_on_setpoint", setpoint)


@breaks(46)
def counts_lost_in_the_heartbeat_only_to_8(d: Device) -> None:
    def setpoint(old: Any, *a: Any) -> Frames:
        before = d.machine.counters["setpoints_lost"]
        frames = old(*a)
        d.machine.counters["setpoints_lost"] = min(d.machine.counters["setpoints_lost"], before + 8)
        return frames  # type: ignore[no-any-return]

    wrap(d.machine, "_on_setpoint", setpoint)


# -- measurements -----------------------------------------------------------------------------------------------------


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

    def sample(old: Any, now_us: int) -> Frames:
        held.extend(old(now_us))
        if now_us // 1000 % 50 < 3:
            return []
        frames, held[:] = list(held), []
        return frames

    wrap(d, "sample", sample)


# -- discovery --------------------------------------------------------------------------------------------------------


@breaks(60)
def hides_in_fault(d: Device) -> None:
    def discover(old: Any, *a: Any) -> Frames:
        return [] if d.machine.state is DriveState.FAULT and d.machine.node == NODE else old(*a)

    wrap(d.machine, "_on_discover", discover)


@breaks(61)
def always_waits_20_ms(d: Device) -> None:
    def discover(old: Any, message: Any, now_us: int, theta: int) -> Frames:
        if d.machine._identity_due_us is None:
            old(message, now_us, theta)
            d.machine._identity_due_us = now_us + 20_000
        return []

    wrap(d.machine, "_on_discover", discover)


@breaks(62)
def answers_every_discover(d: Device) -> None:
    waiting = []

    def discover(old: Any, message: Any, now_us: int, theta: int) -> Frames:
        if d.machine._identity_due_us is not None:
            waiting.append(now_us + 34_000)
        return old(message, now_us, theta)  # type: ignore[no-any-return]

    def poll(old: Any, now_us: int) -> Frames:
        frames = old(now_us)
        while waiting and waiting[0] <= now_us:
            waiting.pop(0)
            frames.append(d.machine._identity())
        return frames  # type: ignore[no-any-return]

    wrap(d.machine, "_on_discover", discover)
    wrap(d, "poll", poll)


@breaks(63)
def says_its_new_node_late(d: Device) -> None:
    due: list[tuple[int, Frame]] = []

    def assign(old: Any, message: AssignNode, now_us: int, theta: int) -> Frames:
        due.extend((now_us + 12_000, frame) for frame in old(message, now_us, theta))
        return []

    def poll(old: Any, now_us: int) -> Frames:
        frames = old(now_us)
        while due and due[0][0] <= now_us:
            frames.append(due.pop(0)[1])
        return frames  # type: ignore[no-any-return]

    wrap(d.machine, "_on_assign_node", assign)
    wrap(d, "poll", poll)


def uncounted(d: Device, name: str, when: Callable[[Any], bool]) -> None:
    """Refuse without counting."""

    def handle(old: Any, message: Any, *rest: Any) -> Frames:
        kept = dict(d.machine.counters) if when(message) else None
        frames = old(message, *rest)
        if kept is not None:
            d.machine.counters.update(kept)
        return frames  # type: ignore[no-any-return]

    wrap(d.machine, name, handle)


@breaks(64)
def does_not_count_assign_while_armed(d: Device) -> None:
    uncounted(d, "_on_assign_node", lambda _: d.machine.state is DriveState.ARMED)


@breaks(64)
def moves_while_in_fault(d: Device) -> None:
    def assign(old: Any, message: AssignNode, *rest: Any) -> Frames:
        state = d.machine.state
        if state is DriveState.FAULT:
            d.machine.state = DriveState.DISABLED
        frames = old(message, *rest)
        d.machine.state = state
        return frames  # type: ignore[no-any-return]

    wrap(d.machine, "_on_assign_node", assign)


@breaks(65)
def does_not_count_an_impossible_node(d: Device) -> None:
    uncounted(d, "_on_assign_node", lambda m: m.new_node > MAX_NODE)


@breaks(66)
def compares_half_a_serial_number(d: Device) -> None:
    def assign(old: Any, message: AssignNode, *rest: Any) -> Frames:
        own = d.machine.config.serial_number
        if (message.serial_number ^ own) & 0xFFFFFF == 0:
            message = message._replace(serial_number=own)
        return old(message, *rest)  # type: ignore[no-any-return]

    wrap(d.machine, "_on_assign_node", assign)


# -- heartbeats -------------------------------------------------------------------------------------------------------


@breaks(81)
def rare_heartbeats_in_fault(d: Device) -> None:
    def poll(old: Any, now_us: int) -> Frames:
        machine = d.machine
        if machine.state is DriveState.FAULT and not machine._announce and now_us - machine._heartbeat_us < 130_000:
            machine._heartbeat_period_us, kept = 130_000, machine._heartbeat_period_us
            frames = old(now_us)
            machine._heartbeat_period_us = kept
            return frames  # type: ignore[no-any-return]
        return old(now_us)  # type: ignore[no-any-return]

    wrap(d, "poll", poll)


@breaks(82)
def does_not_announce(d: Device) -> None:
    def poll(old: Any, now_us: int) -> Frames:
        d.machine._announce = False
        return old(now_us)  # type: ignore[no-any-return]

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
    def assign(old: Any, *a: Any) -> Frames:
        frames = old(*a)
        if frames:
            d.machine._levels = 0
        return frames  # type: ignore[no-any-return]

    wrap(d.machine, "_on_assign_node", assign)


@breaks(85)
def remembers_the_sequence_of_a_lost_host(d: Device) -> None:
    def expire(old: Any, now_us: int) -> None:
        present = d.machine._host_present
        old(now_us)
        d.old = getattr(d, "old", False) or (present and not d.machine._host_present)  # type: ignore[attr-defined]

    def beat(old: Any, message: HostHeartbeat, *rest: Any) -> Frames:
        behind = (d.machine._host_sequence - message.sequence) & 0xFF
        if getattr(d, "old", False) and 0 <= behind < 128:
            d.machine.counters["heartbeat_stale"] += 1
            return []
        d.old = False  # type: ignore[attr-defined]
        return old(message, *rest)  # type: ignore[no-any-return]

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


# -- enabling ---------------------------------------------------------------------------------------------------------


def keeps_torque(d: Device, while_true: Callable[[], bool]) -> None:
    """Obey the last reference longer than the protocol allows."""
    last: list[int] = []

    def goal(old: Any) -> int | None:
        reference = old()
        if reference is not None:
            last[:] = [reference]
        elif last and while_true():
            return last[0] + 200_000
        else:
            last.clear()
        return reference  # type: ignore[no-any-return]

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
    def beat(old: Any, message: HostHeartbeat, *rest: Any) -> Frames:
        if message.protocol_minor:
            message = message._replace(control=message.control & ~ENABLE)
        return old(message, *rest)  # type: ignore[no-any-return]

    wrap(d.machine, "_on_host_heartbeat", beat)


@breaks(93)
def enables_after_ten_high(d: Device) -> None:
    count = [0]

    def beat(old: Any, message: HostHeartbeat, now_us: int, theta: int) -> Frames:
        frames = old(message, now_us, theta)
        idle = message.control & ENABLE and d.machine.state is DriveState.DISABLED
        count[0] = count[0] + 1 if idle else 0
        if count[0] > 10:
            d.machine._armed_us = now_us
            d.machine._fire(DriveEvent.ENABLE)
        return frames  # type: ignore[no-any-return]

    wrap(d.machine, "_on_host_heartbeat", beat)


@breaks(94)
def compares_seven_bits_of_the_version(d: Device) -> None:
    def beat(old: Any, message: HostHeartbeat, *rest: Any) -> Frames:
        if message.protocol_major == 129:
            message = message._replace(protocol_major=1)
        return old(message, *rest)  # type: ignore[no-any-return]

    wrap(d.machine, "_on_host_heartbeat", beat)


@breaks(95)
def armed_whatever_the_version(d: Device) -> None:
    ignores(d, DriveEvent.VERSION_MISFIT, DriveState.ARMED)


@breaks(95)
def operational_whatever_the_version(d: Device) -> None:
    ignores(d, DriveEvent.VERSION_MISFIT, DriveState.OPERATIONAL)


def judges(d: Device, change: Callable[[DriveEvent, int, int, int], DriveEvent]) -> None:
    """Judge references otherwise: `change` gets the right event, reference, advance, angle."""

    def judge(old: Any, reference: int, advance: int, theta: int) -> DriveEvent:
        return change(old(reference, advance, theta), reference, advance, theta)

    wrap(d.machine, "_judge_reference", judge)


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


# -- references -------------------------------------------------------------------------------------------------------


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
    def fresh(old: Any, message: Setpoint) -> int:
        stale = d.machine.state is DriveState.ARMED and not 1 <= advance_of(d, message) <= 127
        return 0 if stale else old(message)

    wrap(d.machine, "_freshness", fresh)


@breaks(112)
def takes_samples_one_too_old(d: Device) -> None:
    wrap(
        d.machine,
        "_adopt_parameters",
        lambda old: (old(), setattr(d.machine, "_max_sample_age", 1 + d.machine._max_sample_age)),
    )


@breaks(113)
def takes_samples_to_come(d: Device) -> None:
    def ahead(message: Setpoint) -> int:
        running = d.machine.state is DriveState.OPERATIONAL
        return int(running and age_of(d, message) > 256 - 9 and advance_of(d, message) == 1)

    fresh_also(d, ahead)


@breaks(114)
def accepts_references_in_fault(d: Device) -> None:
    def fresh(old: Any, message: Setpoint) -> int:
        if d.machine.state is DriveState.FAULT:
            d.machine.counters["setpoints_accepted"] += 1
            return 0
        return old(message)  # type: ignore[no-any-return]

    wrap(d.machine, "_freshness", fresh)


@breaks(115)
def limit_not_included(d: Device) -> None:
    def change(event: DriveEvent, reference: int, *_: int) -> DriveEvent:
        return DriveEvent.REFERENCE_OUTSIDE if reference == d.machine._theta_max_raw else event

    judges(d, change)


@breaks(115)
def no_lower_limit(d: Device) -> None:
    def change(event: DriveEvent, reference: int, *_: int) -> DriveEvent:
        return DriveEvent.REFERENCE if reference < d.machine._theta_min_raw else event

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

    def goal(old: Any) -> int | None:
        reference = old()
        if reference is None:
            start.clear()
            return None
        start.extend([reference] * (not start))
        return round(2 * start[0] - reference)

    wrap(d, "goal", goal)


# -- watchdog ---------------------------------------------------------------------------------------------------------


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
    def setpoint(old: Any, frame: Frame, *rest: Any) -> Frames:
        machine = d.machine
        if not host_frame(frame, Function.SETPOINT) or codec.Decoder().decode(frame) is None:
            return old(frame, *rest)  # type: ignore[no-any-return]
        machine._watchdog_timeout_us, kept = machine._watchdog_timeout_us + 5000, machine._watchdog_timeout_us
        frames = old(frame, *rest)
        machine._watchdog_timeout_us = kept
        return frames  # type: ignore[no-any-return]

    wrap(d.machine, "receive", setpoint)


@breaks(122)
def heartbeats_feed_the_watchdog(d: Device) -> None:
    def beat(old: Any, message: HostHeartbeat, now_us: int, theta: int) -> Frames:
        d.machine._fed_us = now_us
        return old(message, now_us, theta)  # type: ignore[no-any-return]

    wrap(d.machine, "_on_host_heartbeat", beat)


@breaks(122)
def repeated_references_feed_the_watchdog(d: Device) -> None:
    def setpoint(old: Any, message: Setpoint, now_us: int, theta: int) -> Frames:
        if advance_of(d, message) == 0:
            d.machine._fed_us = now_us
        return old(message, now_us, theta)  # type: ignore[no-any-return]

    wrap(d.machine, "_on_setpoint", setpoint)


def executes(d: Device, change: Callable[..., Any]) -> None:
    """Execute requests otherwise: `change(old, store, op, index, value, disabled)`."""
    store = d.machine._values
    old = store.execute
    new = MethodType(lambda _self, *a: change(old, store, *a), store)
    store.execute = new  # type: ignore[method-assign]


@breaks(124)
def watchdog_can_be_switched_off(d: Device) -> None:
    def execute(old: Any, store: ParameterStore, op: int, index: int, value: int, disabled: bool) -> Any:
        if op == ParamOp.WRITE and index == Index.WATCHDOG_TIMEOUT and value == 0 and disabled:
            store.put(index, 0)
            return ParamOp.OK, 0
        return old(op, index, value, disabled)

    executes(d, execute)


# -- faults -----------------------------------------------------------------------------------------------------------


@breaks(130)
def enable_resets(d: Device) -> None:
    def beat(old: Any, message: HostHeartbeat, *rest: Any) -> Frames:
        rises = message.control & ENABLE and not d.machine._levels & ENABLE
        resets = rises and d.machine.state is DriveState.FAULT and message.protocol_major == 1
        frames = old(message, *rest)
        if resets and not message.control & RESET and d.machine.fault is FaultReason.ESTOP:
            d.machine._fire(DriveEvent.RESET)
        return frames  # type: ignore[no-any-return]

    wrap(d.machine, "_on_host_heartbeat", beat)


@breaks(131)
def a_later_reason_wins(d: Device) -> None:
    def fire(old: Any, event: DriveEvent, *reason: Any) -> None:
        old(event, *reason)
        if event is DriveEvent.HOST_LOST and d.machine.state is DriveState.FAULT:
            d.machine.fault = FaultReason.HOST_HEARTBEAT_LOST

    wrap(d.machine, "_fire", fire)


@breaks(132)
def reset_and_enable_at_once(d: Device) -> None:
    def beat(old: Any, message: HostHeartbeat, now_us: int, theta: int) -> Frames:
        both = message.control & ~d.machine._levels & 3 == 3 and d.machine.state is DriveState.FAULT
        frames = old(message, now_us, theta)
        if both:
            d.machine._armed_us = now_us
            d.machine._fire(DriveEvent.ENABLE)
        return frames  # type: ignore[no-any-return]

    wrap(d.machine, "_on_host_heartbeat", beat)


@breaks(133)
def a_reset_forgets_enable(d: Device) -> None:
    def beat(old: Any, message: HostHeartbeat, *rest: Any) -> Frames:
        fault = d.machine.state is DriveState.FAULT
        frames = old(message, *rest)
        if fault and d.machine.state is DriveState.DISABLED:
            d.machine._levels &= ~ENABLE
        return frames  # type: ignore[no-any-return]

    wrap(d.machine, "_on_host_heartbeat", beat)


@breaks(134)
def reset_by_level(d: Device) -> None:
    def beat(old: Any, *a: Any) -> Frames:
        if d.machine._host_present:
            d.machine._levels &= ~RESET
        return old(*a)  # type: ignore[no-any-return]

    wrap(d.machine, "_on_host_heartbeat", beat)


@breaks(140)
def estop_without_payload_only(d: Device) -> None:
    def receive(old: Any, frame: Frame, now_ns: int) -> Frames:
        full = split_id(frame.arbitration_id)[0] == Function.ESTOP and len(frame.data) > 7
        return [] if full else old(frame, now_ns)

    wrap(d, "receive", receive)


@breaks(140)
def no_estop_to_all_while_operational(d: Device) -> None:
    def receive(old: Any, frame: Frame, now_ns: int) -> Frames:
        to_all = frame.arbitration_id == arbitration_id(Function.ESTOP, 0)
        return [] if to_all and d.machine.state is DriveState.OPERATIONAL else old(frame, now_ns)

    wrap(d, "receive", receive)


@breaks(141)
def estop_overwrites_the_reason(d: Device) -> None:
    def estop(old: Any, *a: Any) -> Frames:
        frames = old(*a)
        d.machine.fault = FaultReason.ESTOP
        return frames  # type: ignore[no-any-return]

    wrap(d.machine, "_on_estop", estop)


@breaks(142)
def estop_from_a_host_that_is_there_only(d: Device) -> None:
    wrap(d.machine, "_on_estop", lambda old, *a: old(*a) if d.machine._host_present else [])


# -- parameters -------------------------------------------------------------------------------------------------------


@breaks(150)
def answers_twice(d: Device) -> None:
    def request(old: Any, message: ParamRequest, *rest: Any) -> Frames:
        return old(message, *rest) * (2 if message.parameter == Index.COUNTS_PER_REV else 1)  # type: ignore[no-any-return]

    wrap(d.machine, "_on_param_request", request)


def result_for(op: int, index: int, result: int, when: Callable[[Device], bool] = lambda _: True) -> Break:
    """Return a mutation that answers one request otherwise, and changes nothing else."""

    def mutate(d: Device) -> None:
        def execute(old: Any, store: ParameterStore, asked: int, number: int, value: int, disabled: bool) -> Any:
            if (asked, number) == (op, index) and when(d):
                return ParamOp(result), store._values.get(number, 0)
            return old(asked, number, value, disabled)

        executes(d, execute)

    return mutate


@breaks(151)
def one_parameter_not_read_in_fault(d: Device) -> None:
    fault = DriveState.FAULT
    mutate = result_for(ParamOp.READ, Index.TORQUE_CONSTANT, ParamOp.WRONG_STATE, lambda d: d.machine.state is fault)
    mutate(d)


@breaks(151)
def reads_a_default(d: Device) -> None:
    def execute(old: Any, _: ParameterStore, op: int, index: int, value: int, disabled: bool) -> Any:
        result, held = old(op, index, value, disabled)
        return result, 1 << 18 if op == ParamOp.READ and index == Index.MAX_STEP and held == (1 << 18) - 1 else held

    executes(d, execute)


@breaks(152)
def has_a_parameter_too_many(d: Device) -> None:
    result_for(ParamOp.READ, 0x0207, ParamOp.OK)(d)


@breaks(153)
def lets_counts_per_rev_be_written(d: Device) -> None:
    result_for(ParamOp.WRITE, Index.COUNTS_PER_REV, ParamOp.OK)(d)


@breaks(154)
def lets_a_limit_be_written_in_fault(d: Device) -> None:
    fault = DriveState.FAULT
    result_for(ParamOp.WRITE, Index.MAX_STEP, ParamOp.OK, lambda d: d.machine.state is fault)(d)


@breaks(155)
def lets_the_limits_cross(d: Device) -> None:
    def execute(old: Any, store: ParameterStore, op: int, index: int, value: int, disabled: bool) -> Any:
        if op == ParamOp.WRITE and index == Index.THETA_MIN and disabled:
            store.put(index, value)
            return ParamOp.OK, value
        return old(op, index, value, disabled)

    executes(d, execute)


@breaks(155)
def upper_bound_not_included(d: Device) -> None:
    def execute(old: Any, store: ParameterStore, op: int, index: int, value: int, disabled: bool) -> Any:
        if op == ParamOp.WRITE and index == Index.MAX_STEP and value == 1 << 24 and disabled:
            return ParamOp.OUT_OF_RANGE, store[index]
        return old(op, index, value, disabled)

    executes(d, execute)


@breaks(156)
def reads_for_any_even_op(d: Device) -> None:
    def execute(old: Any, _: ParameterStore, op: int, *rest: Any) -> Any:
        return old(ParamOp.READ if op in (0x10, 0x80) else op, *rest)

    executes(d, execute)


@breaks(157)
def state_before_access(d: Device) -> None:
    def execute(old: Any, _: ParameterStore, op: int, index: int, value: int, disabled: bool) -> Any:
        result, held = old(op, index, value, disabled)
        return (ParamOp.WRONG_STATE if result is ParamOp.READ_ONLY and not disabled else result), held

    executes(d, execute)


@breaks(158)
def refuses_with_the_value_asked_for(d: Device) -> None:
    def execute(old: Any, _: ParameterStore, op: int, index: int, value: int, disabled: bool) -> Any:
        result, held = old(op, index, value, disabled)
        return result, value if result is ParamOp.OUT_OF_RANGE else held

    executes(d, execute)


@breaks(159)
def heartbeat_period_after_a_restart(d: Device) -> None:
    def adopt(old: Any) -> None:
        old()
        d.machine._heartbeat_period_us = d.machine.config.heartbeat_period_us

    wrap(d.machine, "_adopt_parameters", adopt)


# -- serial line ------------------------------------------------------------------------------------------------------


@breaks(160, line="serial")
def talks_between_packets(d: Device) -> None:
    def encode(old: Any, frame: Frame) -> bytes:
        packet: bytes = old(frame)
        return packet + b"heartbeat\r\n\x00" if host_frame(frame, Function.DRIVE_HEARTBEAT) else packet

    wrap(d, "encode", encode)


@breaks(161, 32, line="serial")
def trusts_the_packet(d: Device) -> None:
    """The payload's own check is the check of HFP-032: on a serial line there is no other place for it."""

    def receive(old: Any, frame: Frame, now_ns: int) -> Frames:
        function, node = split_id(frame.arbitration_id)
        known = function == Function.PARAM_REQUEST and has_known_index(frame) and not frame.is_fd
        if known and frame.data[-1] == wire.sealed8(function, node, frame.data[:-1]).data[-1] ^ 0x55:
            frame = wire.sealed8(function, node, frame.data[:-1])
        return old(frame, now_ns)  # type: ignore[no-any-return]

    wrap(d, "receive", receive)


@breaks(162, line="serial")
def wants_a_packet_in_one_piece(d: Device) -> None:
    def feed(data: bytes) -> Frames:
        return SerialReader().feed(data)

    d.reader.feed = feed  # type: ignore[method-assign]


class StuckReader(SerialReader):
    """Needs a second delimiter after a packet that it could not decode."""

    def _take(self, packet: bytes) -> Frame | None:
        if getattr(self, "confused", False):
            self.confused = False
            return None
        frame = super()._take(packet)
        self.confused = frame is None and len(packet) < 60
        return frame


@breaks(163, line="serial")
def swallows_the_packet_after_garbage(d: Device) -> None:
    d.reader = StuckReader()


@breaks(164, line="serial")
def drops_upper_bits_of_the_id(d: Device) -> None:
    def take(old: Any, packet: bytes) -> Frame | None:
        try:
            body = bytearray(cobs.decode(packet))
        except cobs.DecodeError:
            return old(packet)  # type: ignore[no-any-return]
        right = codec.crc_hqx(bytes(body[:-2]), 0xFFFF) == int.from_bytes(body[-2:], "little")
        if len(body) == 4 + 8 and right and body[1] & 0x78:
            body[1] &= 0x87
            return Frame(int.from_bytes(body[:2], "little"), bytes(body[2:-2]))
        return old(packet)  # type: ignore[no-any-return]

    wrap(d.reader, "_take", take)


@breaks(165, line="serial")
def begins_anew_when_full(d: Device) -> None:
    reader = SerialReader()

    def feed(data: bytes) -> Frames:
        frames: Frames = []
        for byte in data:
            frames += reader.feed(bytes((byte,)))
            if reader._skipping:
                reader._skipping = False
        return frames

    d.reader.feed = feed  # type: ignore[method-assign]


@breaks(166, line="serial")
def empty_packets_count(d: Device) -> None:
    def feed(old: Any, data: bytes) -> Frames:
        d.machine.counters["bad_length"] += data.count(b"\0\0")
        return old(data)  # type: ignore[no-any-return]

    wrap(d.reader, "feed", feed)


# -- CAN FD -----------------------------------------------------------------------------------------------------------


@breaks(170, line="fd")
def sends_both_kinds(d: Device) -> None:
    def double(frame: Frame) -> Frames:
        if split_id(frame.arbitration_id)[0] != Function.FD_FEEDBACK:
            return [frame]
        return [frame, codec.encode_feedback(NODE, 0, 0, frame.data[10])]

    on_sent(d, double)


def follows_both(d: Device) -> None:
    """Take the other kind of setpoint, too."""
    other = Function.SETPOINT if d.machine.config.fd else Function.FD_SETPOINT

    def take_node(old: Any, node: int) -> None:
        old(node)
        d.machine._handlers[arbitration_id(other, node)] = d.machine._on_setpoint

    wrap(d.machine, "_take_node", take_node)


@breaks(171)
def classic_drive_follows_fd_setpoints(d: Device) -> None:
    follows_both(d)


@breaks(171, line="fd")
def fd_drive_follows_setpoints(d: Device) -> None:
    follows_both(d)
