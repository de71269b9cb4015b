"""Drives broken in: serial line, CAN FD."""

from binascii import crc_hqx
from collections.abc import Callable
from typing import Any

from cobs import cobs

from firmware_protocol import codec
from firmware_protocol.conformance import wire
from firmware_protocol.frames import Frame, arbitration_id, split_id
from firmware_protocol.messages import (
    DriveState,
    Function,
    Setpoint,
)
from firmware_protocol.serial_framing import SerialReader
from tests.conformance.broken.table import (
    Frames,
    Handler,
    breaks,
    has_known_index,
    host_frame,
    on_sent,
    wrap,
)
from tests.conformance.devices import NODE, Device

# -- serial line -------------------------------------------------------------------------------------------------------


@breaks(160, line="serial")
def talks_between_packets(d: Device) -> None:
    def encode(old: Any, frame: Frame) -> bytes:
        packet: bytes = old(frame)
        return packet + b"heartbeat\r\n\x00" if host_frame(frame, Function.DRIVE_HEARTBEAT) else packet

    wrap(d, "encode", encode)


@breaks(161, 32, line="serial")
def trusts_the_packet(d: Device) -> None:
    """The payload's own check is the check of HFP-032: on a serial line there is no other place for it."""

    def receive(old: Handler, frame: Frame, now_ns: int) -> Frames:
        function, node = split_id(frame.arbitration_id)
        known = function == Function.PARAM_REQUEST and has_known_index(frame) and not frame.is_fd
        if known and frame.data[-1] == wire.sealed8(function, node, frame.data[:-1]).data[-1] ^ 0x55:
            frame = wire.sealed8(function, node, frame.data[:-1])
        return old(frame, now_ns)

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
    def take(old: Callable[[bytes], Frame | None], packet: bytes) -> Frame | None:
        try:
            body = bytearray(cobs.decode(packet))
        except cobs.DecodeError:
            return old(packet)
        right = crc_hqx(bytes(body[:-2]), 0xFFFF) == int.from_bytes(body[-2:], "little")
        if len(body) == 4 + 8 and right and body[1] & 0x78:
            body[1] &= 0x87
            return Frame(int.from_bytes(body[:2], "little"), bytes(body[2:-2]))
        return old(packet)

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
    def feed(old: Handler, data: bytes) -> Frames:
        d.machine.counters["bad_length"] += data.count(b"\0\0")
        return old(data)

    wrap(d.reader, "feed", feed)


# -- UDP ---------------------------------------------------------------------------------------------------------------


@breaks(160, 180, line="udp")
def sends_a_torn_packet_besides(d: Device) -> None:
    """What is no packet in a datagram of its own is a packet that is damaged."""

    def datagrams(old: Callable[[Frame], list[bytes]], frame: Frame) -> list[bytes]:
        whole = old(frame)
        return [whole[0][:5], *whole] if host_frame(frame, Function.DRIVE_HEARTBEAT) else whole

    wrap(d, "datagrams", datagrams)


@breaks(181, line="udp")
def goes_on_with_the_packet_in_the_next_datagram(d: Device) -> None:
    d.receive_datagram = d.receive_bytes  # type: ignore[method-assign]


# -- CAN FD ------------------------------------------------------------------------------------------------------------


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

    def receive(old: Handler, frame: Frame, now_ns: int) -> Frames:
        running = d.machine.state is DriveState.OPERATIONAL
        if running and frame.arbitration_id == arbitration_id(other, d.machine.node):
            message = codec.Decoder().decode(frame)
            if isinstance(message, Setpoint):
                return d.machine._on_setpoint(message, now_ns // 1000, round(d.angle))
        return old(frame, now_ns)

    wrap(d, "receive", receive)


def counts_the_other_kind(d: Device) -> None:
    other = Function.SETPOINT if d.machine.config.fd else Function.FD_SETPOINT

    def receive(old: Handler, frame: Frame, now_ns: int) -> Frames:
        d.machine.counters["bad_format"] += frame.arbitration_id == arbitration_id(other, d.machine.node)
        return old(frame, now_ns)

    wrap(d, "receive", receive)


@breaks(173)
def classic_drive_counts_fd_setpoints(d: Device) -> None:
    counts_the_other_kind(d)


@breaks(173, line="fd")
def fd_drive_counts_setpoints(d: Device) -> None:
    counts_the_other_kind(d)


@breaks(171)
def classic_drive_follows_fd_setpoints(d: Device) -> None:
    follows_both(d)


@breaks(171, line="fd")
def fd_drive_follows_setpoints(d: Device) -> None:
    follows_both(d)
