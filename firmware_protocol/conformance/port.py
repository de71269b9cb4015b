"""What the suite needs from outside: frames out, frames with times in, and a clock that can be waited for."""

from collections.abc import Sequence
from enum import Flag, auto
from typing import NamedTuple, Protocol

from firmware_protocol.frames import Frame

MS: int = 1_000_000


class Capability(Flag):
    """What a line can do beyond classic data frames with 11-bit ids."""

    NONE = 0
    FD = auto()  # carries CAN FD frames
    FOREIGN = auto()  # carries extended ids and remote frames
    SERIAL = auto()  # carries bytes, framed as `serial_framing` says
    STREAM = auto()  # carries them in any pieces: not datagrams of whole packets


class Port(Protocol):
    """The line to a drive. Nothing here raises for what the outside did.

    Where `virtual_time` holds, time passes in `wait_until` only, and nothing is ever late.
    """

    @property
    def virtual_time(self) -> bool:
        """Tell whether the clock is the line's own."""

    @property
    def capabilities(self) -> Capability:
        """Tell what the line can do."""

    def send(self, frame: Frame) -> bool:
        """Hand over one frame now; False when the line has no room for it."""

    def send_foreign(self, frame: Frame, remote: bool) -> bool:
        """Send with an extended id or, if `remote`, as a remote frame of that length; only with FOREIGN."""

    def send_bytes(self, data: bytes) -> bool:
        """Send bytes as they are; only with SERIAL."""

    def receive(self) -> Sequence[tuple[int, Frame]]:
        """Return what has arrived since the last call, each with its time in ns, oldest first."""

    def line_errors(self) -> int:
        """Count the packets that arrived damaged; always 0 on a CAN bus, which repeats them."""

    def now_ns(self) -> int:
        """Return the time now."""

    def wait_until(self, time_ns: int) -> None:
        """Wait until then."""


class Margins(NamedTuple):
    """What is granted to line, host and measurement; published with every verdict.

    `line_ns`: round trip over line and stacks, at worst. `jitter_ns`: change of a frame's way to the drive from one to
    the next. `granularity_ns`: how late a drive may notice that a time is over. `gap_ns`: wait between frames whose
    order matters. `stamp_ns`: how far a stamp may be off its grid. `clock_ppm`: granted to the drive's time-outs.
    `stall_ns`: a host that stood still for longer can't fail a drive; `void_stall_ns`: nor pass it. `attempts`: how
    often such a check is tried. `idle_current_raw`: current that counts as none. `move_raw`: amplitude of motions.
    `flood_ns`: longest flood.
    """

    line_ns: int
    jitter_ns: int
    gap_ns: int
    tick_ns: int
    stamp_ns: int
    stall_ns: int = 3 * MS
    void_stall_ns: int = 15 * MS
    attempts: int = 5
    granularity_ns: int = MS
    clock_ppm: int = 5_000
    idle_current_raw: int = 100
    move_raw: int = 1 << 18
    flood_ns: int = 60_000 * MS


VIRTUAL = Margins(line_ns=MS, jitter_ns=MS // 5, gap_ns=600_000, tick_ns=500_000, stamp_ns=20_000)
REAL = Margins(line_ns=5 * MS, jitter_ns=3 * MS, gap_ns=MS, tick_ns=500_000, stamp_ns=300_000)
