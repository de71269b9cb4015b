"""A link over a serial port, pseudo-terminal or TCP socket, by pyserial URL, or over UDP.

Frames are packed as `firmware_protocol.serial_framing` says, or as the drive's protocol has it (`Framing`).

Where the port has a file descriptor it is polled, read and written without pyserial's own loops: with a zero write
timeout pyserial spins for as long as the line is full. A frame that fits only in part is given up: the other end
drops the torn packet by its CRC; where the framing has a delimiter, the next write starts with it, so that it costs no
second one.
"""

import errno
import io
import os
import select
import socket
import stat
from contextlib import suppress
from typing import Protocol

import serial

from firmware_protocol.frames import Frame
from hil_forceps.bridge.links.udp_port import CONGESTED, UdpPort
from hil_forceps.bridge.ports import Clock, Received, SendResult
from hil_forceps.drives.framing import NATIVE, Framing

MAX_READ_BYTES = 1 << 13  # by one call, some 500 frames: more would hold up a tick
MAX_WAITING_BYTES = 1 << 11  # on their way out of a port that can't say when it is full


class _Stream(Protocol):
    """Bytes without waiting; both raise OSError when the other end is gone."""

    def read(self) -> bytes: ...

    def write(self, data: bytes) -> int: ...


class SerialLink:
    """Frames over a port. Arrival is the time of reading: a serial line has no stamps.

    `is_stream` is false where bytes stay in the pieces in which they were sent.
    """

    def __init__(self, port: serial.Serial | UdpPort, clock: Clock, framing: Framing = NATIVE) -> None:
        self.counters = dict.fromkeys(("queue_full", "torn"), 0)
        self.is_stream = not isinstance(port, UdpPort)
        self._port = port
        self._clock = clock
        self._encode, self._resume = framing.encode, framing.resume
        self._reader = framing.reader()
        self._stream = _stream_of(port)
        self._up = True
        self._torn = False

    def send(self, frame: Frame) -> SendResult:
        """Hand over one frame now or not at all."""
        if not self._up:
            return SendResult.BUS_DOWN
        packet = self._encode(frame)
        if self._torn:
            packet = self._resume + packet
        try:
            written = self._stream.write(packet)
        except OSError:
            self._up = False
            return SendResult.BUS_DOWN
        if written == len(packet):
            self._torn = False
            return SendResult.SENT
        self.counters["queue_full"] += 1
        if written:
            self.counters["torn"] += 1
            self._torn = True
        return SendResult.QUEUE_FULL

    def send_bytes(self, data: bytes) -> SendResult:
        """Hand over bytes that may be no packet, now and whole or not: what is torn here is the caller's to mend."""
        if not self._up:
            return SendResult.BUS_DOWN
        try:
            written = self._stream.write(data)
        except OSError:
            self._up = False
            return SendResult.BUS_DOWN
        return SendResult.SENT if written == len(data) else SendResult.QUEUE_FULL

    def receive(self) -> list[Received]:
        """Return what has arrived since the last call, oldest first."""
        if not self._up:
            return []
        try:
            data = self._stream.read()
        except OSError:
            self._up = False
            return []
        if not data:
            return []
        now_ns = self._clock.now_ns()
        frames = [Received(now_ns, frame) for frame in self._reader.feed(data)]
        self.counters.update(self._reader.counters)
        return frames

    def is_up(self) -> bool:
        """Tell whether the port is there."""
        return self._up

    def close(self) -> None:
        """Release the port; safe to call twice."""
        self._up = False
        self._port.close()


class _Descriptor:
    """A port with a file descriptor."""

    def __init__(self, descriptor: int) -> None:
        os.set_blocking(descriptor, False)
        if stat.S_ISSOCK(os.fstat(descriptor).st_mode):
            _send_at_once(descriptor)
        self._descriptor = descriptor
        self._poll = select.poll()
        self._poll.register(descriptor, select.POLLIN)

    def read(self) -> bytes:
        events = self._poll.poll(0)
        if not events:
            return b""
        if not events[0][1] & select.POLLIN:
            raise OSError(errno.EIO, "the other end hung up")
        try:
            data = os.read(self._descriptor, MAX_READ_BYTES)
        except OSError as error:
            if error.errno in CONGESTED:
                return b""
            raise
        if not data:  # ready to read and nothing there: unplugged, or the socket was closed
            raise OSError(errno.EIO, "the other end is gone")
        return data

    def write(self, data: bytes) -> int:
        try:
            return os.write(self._descriptor, data)
        except OSError as error:
            if error.errno in CONGESTED:
                return 0
            raise


def _send_at_once(descriptor: int) -> None:
    """Have a TCP socket send each packet by itself; it would wait for the answer to the one before, up to 40 ms."""
    with socket.socket(fileno=os.dup(descriptor)) as same, suppress(OSError):  # not every socket is TCP
        same.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


class _Buffered:
    """A port without one, as `loop://`: pyserial's own calls, as long as little waits to be sent."""

    def __init__(self, port: serial.Serial) -> None:
        self._port = port

    def read(self) -> bytes:
        return bytes(self._port.read(min(self._port.in_waiting, MAX_READ_BYTES)))

    def write(self, data: bytes) -> int:
        if self._port.out_waiting > MAX_WAITING_BYTES:
            return 0
        written = self._port.write(data)
        return len(data) if written is None else int(written)


def _stream_of(port: serial.Serial | UdpPort) -> _Stream:
    if isinstance(port, UdpPort):
        return port
    try:
        descriptor = port.fileno()
    except (AttributeError, io.UnsupportedOperation):
        return _Buffered(port)
    return _Descriptor(descriptor)
