"""Keeps UDP multicast on this machine: python-can's interface itself listens on, and sends to, every network.

What comes over UDP multicast is not signed: whoever reaches the port can send references. So the socket is bound to the
loopback interface, which takes what arrives there and nothing else, and its datagrams have no hop to go. IPv4 works
without a route for multicast. The drive's process does the same by itself (`virtual_bus/realtime/transports.py`).
"""

import os
import socket
import struct
from ipaddress import ip_address
from typing import Final

LOOPBACK: Final = "lo"


def keep_on_loopback(descriptor: int, group: str) -> None:
    """Bind an open multicast socket to the loopback interface and join the group there; OSError where that fails."""
    index, address = socket.if_nametoindex(LOOPBACK), ip_address(group)
    with socket.socket(fileno=os.dup(descriptor)) as same:
        same.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, LOOPBACK.encode() + b"\0")
        if address.version == 4:
            on_loopback = struct.pack("@4si", bytes(4), index)
            same.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, address.packed + on_loopback)
            same.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, bytes(4) + on_loopback)
            same.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        else:
            same.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP, address.packed + struct.pack("@I", index))
            same.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_IF, index)
            same.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_HOPS, 0)
            _require_route(group)


def _require_route(group: str) -> None:
    """OSError where IPv6 has no route for multicast on the loopback interface; IPv4 needs none there."""
    with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, LOOPBACK.encode() + b"\0")
        probe.connect((group, 9))  # sends nothing
