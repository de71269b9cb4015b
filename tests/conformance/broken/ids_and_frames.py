"""Drives broken in: ids, frames."""

from typing import Any

from fastcrc.crc8 import autosar

from firmware_protocol import codec
from firmware_protocol.conformance import wire
from firmware_protocol.frames import MAX_NODE, Frame, arbitration_id, split_id
from firmware_protocol.messages import (
    AssignNode,
    Function,
    HostHeartbeat,
    Identity,
)
from tests.conformance.broken.table import (
    Frames,
    Handler,
    breaks,
    has_known_index,
    host_frame,
    on_sent,
    resend,
    wrap,
)
from tests.conformance.devices import NODE, Device

# -- ids ---------------------------------------------------------------------------------------------------------------


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
    def receive(old: Handler, frame: Frame, now_ns: int) -> Frames:
        function, node = split_id(frame.arbitration_id)
        if function == Function.PARAM_REQUEST | 0x20:
            frame = wire.sealed8(Function.PARAM_REQUEST, node, frame.data[:-1])
        return old(frame, now_ns)

    wrap(d, "receive", receive)


@breaks(10)
def sends_what_no_drive_sends(d: Device) -> None:
    def double(frame: Frame) -> Frames:
        is_beat = host_frame(frame, Function.DRIVE_HEARTBEAT)
        return [frame, Frame(arbitration_id(0x3C, NODE), b"alive")] if is_beat else [frame]

    on_sent(d, double)


@breaks(11)
def has_no_node_30(d: Device) -> None:
    def assign(old: Handler, message: AssignNode, *rest: Any) -> Frames:
        return [] if message.new_node == MAX_NODE else old(message, *rest)

    wrap(d.machine, "_on_assign_node", assign)


@breaks(12)
def stops_for_every_estop(d: Device) -> None:
    def receive(old: Handler, frame: Frame, now_ns: int) -> Frames:
        if split_id(frame.arbitration_id)[0] == Function.ESTOP:
            frame = Frame(arbitration_id(Function.ESTOP, 0), b"")
        return old(frame, now_ns)

    wrap(d, "receive", receive)


@breaks(12)
def answers_requests_to_all(d: Device) -> None:
    def receive(old: Handler, frame: Frame, now_ns: int) -> Frames:
        if frame.arbitration_id == arbitration_id(Function.PARAM_REQUEST, 0):
            frame = wire.sealed8(Function.PARAM_REQUEST, d.machine.node, frame.data[:-1])
        return old(frame, now_ns)

    wrap(d, "receive", receive)


@breaks(13)
def counts_damaged_frames_for_others(d: Device) -> None:
    def receive(old: Handler, frame: Frame, now_ns: int) -> Frames:
        node = split_id(frame.arbitration_id)[1]
        if node not in (0, d.machine.node) and codec.Decoder().decode(frame) is None:
            d.machine.counters["unknown_id"] += 1
        return old(frame, now_ns)

    wrap(d, "receive", receive)


# -- frames ------------------------------------------------------------------------------------------------------------


@breaks(20)
def big_endian_serial_number(d: Device) -> None:
    def swap(m: Identity) -> Identity:
        return m._replace(serial_number=int.from_bytes(m.serial_number.to_bytes(6, "little"), "big"))

    on_sent(d, resend(Function.IDENTITY, swap))


@breaks(21)
def takes_discover_of_any_length(d: Device) -> None:
    def receive(old: Handler, frame: Frame, now_ns: int) -> Frames:
        if split_id(frame.arbitration_id)[0] == Function.DISCOVER:
            frame = frame._replace(data=b"")
        return old(frame, now_ns)

    wrap(d, "receive", receive)


@breaks(22)
def takes_discover_of_any_format(d: Device) -> None:
    def receive(old: Handler, frame: Frame, now_ns: int) -> Frames:
        if split_id(frame.arbitration_id)[0] == Function.DISCOVER:
            frame = frame._replace(is_fd=False)
        return old(frame, now_ns)

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
    def beat(old: Handler, message: HostHeartbeat, *rest: Any) -> Frames:
        return [] if message.control > 3 else old(message, *rest)

    wrap(d.machine, "_on_host_heartbeat", beat)


@breaks(24)
def minds_the_reserved_byte_of_setpoints(d: Device) -> None:
    def receive(old: Handler, frame: Frame, now_ns: int) -> Frames:
        strange = host_frame(frame, Function.SETPOINT) and len(frame.data) == 8 and frame.data[6] != 0
        good = strange and codec.Decoder().decode(frame) is not None
        return [] if good else old(frame, now_ns)

    wrap(d, "receive", receive)


@breaks(25)
def counts_a_wrong_check_twice(d: Device) -> None:
    def receive(old: Handler, frame: Frame, now_ns: int) -> Frames:
        before = d.machine.counters["bad_crc"]
        answers = old(frame, now_ns)
        d.machine.counters["bad_crc"] += d.machine.counters["bad_crc"] - before
        return answers

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
    def receive(old: Handler, frame: Frame, now_ns: int) -> Frames:
        function, node = split_id(frame.arbitration_id)
        known = function == Function.PARAM_REQUEST and node == d.machine.node and has_known_index(frame)
        if known and frame.data[-1] == autosar(frame.data[:-1]):
            frame = wire.sealed8(function, node, frame.data[:-1])
        return old(frame, now_ns)

    wrap(d, "receive", receive)
