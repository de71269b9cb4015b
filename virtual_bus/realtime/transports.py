"""How a drive process reaches the outside: any python-can interface. Nothing from outside raises; it is counted."""

import errno
import os
import socket
import struct
import time
from collections.abc import Iterable, Mapping
from ipaddress import ip_address
from typing import Protocol

import can

from firmware_protocol.frames import Frame, make
from hil_forceps.rig.errors import UserError

MAX_FRAMES_AT_ONCE = 256  # a flood can't keep the loop from its samples
_NO_ROUTE = {errno.ENODEV, errno.ENETUNREACH, errno.EADDRNOTAVAIL, errno.EHOSTUNREACH}
_NO_CAN = {errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT}


class Transport(Protocol):
    """Frames in and out. `counters` names what went wrong."""

    counters: dict[str, int]

    def receive(self, timeout_s: float) -> list[Frame]:
        """Wait up to `timeout_s` for frames, return those that are there: at most MAX_FRAMES_AT_ONCE."""

    def send(self, frames: Iterable[Frame]) -> None:
        """Send now or not at all."""

    def close(self) -> None:
        """Release everything."""


class CanTransport:
    """A drive on any python-can bus."""

    def __init__(self, bus: can.BusABC) -> None:
        self.counters = {"send_failed": 0, "receive_failed": 0, "not_ours": 0}
        self._bus = bus

    def receive(self, timeout_s: float) -> list[Frame]:
        """See `Transport`; a bus that fails costs the time of a wait, so it can't spin."""
        frames: list[Frame] = []
        for _ in range(MAX_FRAMES_AT_ONCE):
            try:
                message = self._bus.recv(timeout_s)
            except (can.CanError, OSError, ValueError):
                self.counters["receive_failed"] += 1
                if timeout_s > 0.0 and not frames:
                    time.sleep(min(timeout_s, 1.0e-3))
                break
            if message is None:
                break
            timeout_s = 0.0
            if message.is_remote_frame or message.is_error_frame:
                self.counters["not_ours"] += 1
            else:
                frames.append(
                    make(
                        Frame,
                        (message.arbitration_id, bytes(message.data), message.is_fd, message.is_extended_id),
                    )
                )
        return frames

    def send(self, frames: Iterable[Frame]) -> None:
        """See `Transport`."""
        for identifier, data, is_fd, is_extended in frames:
            message = can.Message(
                arbitration_id=identifier, data=data, is_extended_id=is_extended, is_fd=is_fd, bitrate_switch=is_fd
            )
            try:
                self._bus.send(message, timeout=0.0)
            except (can.CanError, OSError):
                self.counters["send_failed"] += 1

    def close(self) -> None:
        """See `Transport`."""
        self._bus.shutdown()


def open_can(interface: str, channel: str, is_fd: bool, options: Mapping[str, str]) -> CanTransport:
    """Open a python-can interface; UserError in one line, with the remedy where it is known."""
    name = f"{interface} {channel}"
    try:
        bus = can.Bus(interface=interface, channel=channel, fd=is_fd, ignore_config=False, **options)
    except can.CanInterfaceNotImplementedError as error:
        text = str(error)
        if "msgpack" in text:
            text = "msgpack is missing; pip install 'python-can[multicast]'"
        raise UserError(f"{name}: {text}") from None
    except (can.CanError, OSError, ValueError, TypeError) as error:
        raise UserError(f"{name}: {_reason(interface, error)}") from None
    if interface == "udp_multicast" and options.get("hop_limit", "0") == "0":
        try:
            _keep_on_loopback(bus.fileno(), channel)
        except (OSError, ValueError) as error:
            bus.shutdown()
            raise UserError(
                f"{name}: can't be limited to this computer: {error}; use an IPv4 group, such as --channel "
                "239.74.163.2, or "
                "open it to the network with --option hop_limit=1"
            ) from None
    return CanTransport(bus)


def _keep_on_loopback(descriptor: int, group: str) -> None:
    """Bind python-can's multicast socket to `lo` and join the group there: by itself it listens to every network."""
    address, lo = ip_address(group), socket.if_nametoindex("lo")
    with socket.socket(fileno=os.dup(descriptor)) as same:
        same.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, b"lo\0")
        if address.version == 4:
            request = struct.pack("@4s4si", address.packed, bytes(4), lo)
            same.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, request)
            same.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, struct.pack("@4s4si", bytes(4), bytes(4), lo))
            same.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        else:
            same.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP, address.packed + struct.pack("@I", lo))
            same.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_IF, lo)
            same.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_HOPS, 0)
            with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as probe:  # without a route nothing could be sent
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, b"lo\0")
                probe.connect((group, 9))


def _reason(interface: str, error: Exception) -> str:
    code = error.errno if isinstance(error, OSError) else getattr(error, "error_code", None)
    if code is None and isinstance(error.__cause__, OSError):
        code = error.__cause__.errno
    if interface == "udp_multicast" and code in _NO_ROUTE:
        return "no route for multicast; ip link set lo multicast on; ip route add 239.0.0.0/8 dev lo"
    if interface == "socketcan" and code in _NO_CAN:
        return "this kernel has no CAN; modprobe can_raw vcan, or use udp_multicast or a serial port"
    if interface == "socketcan" and code == errno.ENODEV:
        return "no such device; ip link add dev vcan0 type vcan; ip link set vcan0 up"
    return str(error) or os.strerror(code or errno.EIO)
