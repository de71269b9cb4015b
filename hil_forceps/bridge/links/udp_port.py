"""A drive behind a UDP socket, `udp://address:port`: whole serial packets, each in a datagram of its own.

What arrives counts as ended where its datagram ends, so a torn packet spoils none of the next datagram.
"""

import errno
import socket
from urllib.parse import urlsplit

CONGESTED = frozenset({errno.EAGAIN, errno.EWOULDBLOCK, errno.ENOBUFS, errno.EINTR})
SCHEME = "udp://"
MAX_DATAGRAM_BYTES = 1 << 11  # what is longer is cut, and dropped by its CRC
MAX_DATAGRAMS_PER_CALL = 128
DELIMITER = b"\x00"


class UdpPort:
    """A connected socket. OSError when the address can't be had, and later when nobody listens there."""

    def __init__(self, url: str) -> None:
        """`url`: udp://address:port; ValueError when it is anything else."""
        parts = urlsplit(url)
        if parts.scheme != "udp" or not parts.hostname or not parts.port or parts.path or parts.query:
            raise ValueError("wanted is udp://address:port")
        family, kind, protocol, _, address = socket.getaddrinfo(parts.hostname, parts.port, type=socket.SOCK_DGRAM)[0]
        self._socket = socket.socket(family, kind, protocol)
        try:
            self._socket.connect(address)
            self._socket.setblocking(False)
        except OSError:
            self._socket.close()
            raise

    def read(self) -> bytes:
        """Return what has arrived, each datagram closed by a delimiter."""
        data = bytearray()
        try:
            for _ in range(MAX_DATAGRAMS_PER_CALL):
                data += self._socket.recv(MAX_DATAGRAM_BYTES) + DELIMITER
        except OSError as error:
            if error.errno not in CONGESTED:
                raise
        return bytes(data)

    def write(self, data: bytes) -> int:
        """Send one datagram; 0 when there is no room for it."""
        try:
            return self._socket.send(data)
        except OSError as error:
            if error.errno in CONGESTED:
                return 0
            raise

    def close(self) -> None:
        """Release the socket; safe to call twice."""
        self._socket.close()
