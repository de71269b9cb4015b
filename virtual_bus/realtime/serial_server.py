"""A drive behind a serial port: a pseudo terminal with a link to it at a path of choice.

It speaks serial_framing, or what its maker's drives speak on their line. The host may come, go and come back.
Nothing blocks: where nobody reads, what has not been read is thrown away as a whole and counted, so that a host that
comes back finds at most one buffer of old frames.
"""

import os
import pty
import select
import termios
import tty
from collections.abc import Iterable
from pathlib import Path

from firmware_protocol.frames import Frame
from firmware_protocol.serial_framing import SerialReader, encode_serial
from hil_forceps.rig.errors import UserError
from virtual_bus.bus.wire import LineCodec
from virtual_bus.realtime.transports import MAX_FRAMES_AT_ONCE

_READ_BYTES = 4096
NATIVE = LineCodec(encode_serial, SerialReader)


class SerialServer:
    """The drive's end of a pseudo terminal; a `transports.Transport`. UserError when the link can't be made.

    `counters`: those of the reader; `unread`: times the host's end was full and was emptied.
    """

    def __init__(self, link: str | Path, codec: LineCodec = NATIVE) -> None:
        self._link = Path(link)
        self._encode = codec.encode
        self._reader = codec.reader()
        self.counters = self._reader.counters
        self.counters["unread"] = 0
        self._waiting: list[Frame] = []
        # The host's end stays open here too: its settings survive a host that closes it, and reading never fails.
        self._ours, self._theirs = pty.openpty()
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self.device = os.ttyname(self._theirs)
        try:
            self._make_link()
        except OSError as error:
            self._close_ends()
            raise UserError(f"{self._link}: can't be made: {error.strerror or error}") from None
        except UserError:
            self._close_ends()
            raise

    def receive(self, timeout_s: float) -> list[Frame]:
        """See `Transport`."""
        if not self._waiting:
            select.select([self._ours], [], [], max(timeout_s, 0.0))
            try:
                self._waiting = self._reader.feed(os.read(self._ours, _READ_BYTES))
            except BlockingIOError:
                return []
        frames, self._waiting = self._waiting[:MAX_FRAMES_AT_ONCE], self._waiting[MAX_FRAMES_AT_ONCE:]
        return frames

    def send(self, frames: Iterable[Frame]) -> None:
        """See `Transport`."""
        data = b"".join(map(self._encode, frames))
        try:
            if os.write(self._ours, data) == len(data):
                return
        except BlockingIOError:
            pass
        self.counters["unread"] += 1
        termios.tcflush(self._theirs, termios.TCIFLUSH)

    def close(self) -> None:
        """See `Transport`; the link goes too, if it is still ours."""
        if self._link.is_symlink() and self._link.readlink() == Path(self.device):
            self._link.unlink()
        self._close_ends()

    def _make_link(self) -> None:
        """Put the link in place; one left over from before goes, anything else stays."""
        if self._link.is_symlink():
            if Path("/dev/pts") not in self._link.readlink().parents:
                raise UserError(f"{self._link}: is a link to something else; give another path")
            self._link.unlink()
        elif self._link.exists():
            raise UserError(f"{self._link}: exists and is no link; give another path")
        self._link.symlink_to(self.device)

    def _close_ends(self) -> None:
        os.close(self._ours)
        os.close(self._theirs)
