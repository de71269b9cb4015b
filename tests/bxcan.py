"""A model of the bxCAN of an STM32F4 as its registers show it (RM0090, chapter 32): what the reference firmware uses.

One filter bank of two 16-bit masks, receive FIFO 0, three transmit mailboxes that go in order of request (TXFP).
Not modelled: error states, time-triggered mode, the second FIFO, the other banks.
"""

from collections import deque
from typing import Final

from firmware_protocol.frames import Frame

MCR, MSR, TSR, RF0R, TI0R, TDT0R, TDL0R, TDH0R, RI0R, RDT0R, RDL0R, RDH0R, FA1R, F0R1, F0R2 = (
    *(0x000, 0x004, 0x008, 0x00C, 0x180, 0x184, 0x188, 0x18C, 0x1B0, 0x1B4, 0x1B8, 0x1BC, 0x21C, 0x240, 0x244),
)
MAILBOXES: Final = 3
MAILBOX_STEP: Final = 0x10
FIFO_DEPTH: Final = 3
UNBOUNDED: Final = 1 << 30
_INRQ, _RFOM0, _TXRQ = 1, 1 << 5, 1
_NO_BOX: Final = -1


class BxCan:
    """The controller between firmware (`read`, `write`) and bus (`deliver`, `offer`, `transmitted`).

    `fifo_depth`: 3 is the chip's. `instant`: a frame has left as soon as it is requested, and is found in `sent`; else
    `offer` names the next for the bus, and its mailbox is taken until `transmitted`.
    """

    def __init__(self, fifo_depth: int = FIFO_DEPTH, instant: bool = False) -> None:
        self.fifo: deque[tuple[Frame, int]] = deque()  # with the flags IDE and RTR as in RI0R
        self.sent: list[Frame] = []
        self.overruns = self.filtered = 0
        self._depth, self._instant = fifo_depth, instant
        self._registers: dict[int, int] = {}
        self._boxes: list[Frame | None] = [None] * MAILBOXES
        self._requested: deque[int] = deque()
        self._on_bus = _NO_BOX

    def passes(self, identifier: int, extended: bool = False, remote: bool = False) -> bool:
        """Tell what the filter that is set does with a frame: STID, RTR, IDE, and the top of EXID."""
        standard = identifier >> 18 if extended else identifier
        word = standard << 5 | remote << 4 | extended << 3 | (identifier >> 15 & 7 if extended else 0)
        if not self._registers.get(FA1R, 0) & 1:
            return False
        rows = (self._registers[F0R1], self._registers[F0R2])
        return any(word & (row >> 16) == row & 0xFFFF & (row >> 16) for row in rows)

    def deliver(self, frame: Frame, extended: bool = False, remote: bool = False) -> None:
        """Take a frame from the bus: filtered, into the FIFO, or lost where that is full."""
        if not self.passes(frame.arbitration_id, extended, remote):
            self.filtered += 1
        elif len(self.fifo) >= self._depth:
            self.overruns += 1
        else:
            self.fifo.append((frame, extended << 2 | remote << 1))

    def offer(self) -> Frame | None:
        """Return the frame that takes part in the next arbitration; None while one is on its way, or none waits."""
        if self._on_bus != _NO_BOX or not self._requested:
            return None
        self._on_bus = self._requested.popleft()
        return self._boxes[self._on_bus]

    def transmitted(self) -> bool:
        """Free the mailbox of the frame that `offer` gave; True when it was the only free one."""
        was_full = None not in self._boxes
        self._boxes[self._on_bus] = None
        self._on_bus = _NO_BOX
        return was_full

    def read(self, register: int) -> int:
        """Return what the firmware reads."""
        if register == MSR:  # initialisation is acknowledged as it is asked for
            return self._registers.get(MCR, 0) & _INRQ
        if register == TSR:
            free = [i for i, frame in enumerate(self._boxes) if frame is None]
            return sum(1 << 26 + i for i in free) | (free[0] if free else 0) << 24
        if register == RF0R:
            return min(len(self.fifo), FIFO_DEPTH)
        if RI0R <= register <= RDH0R and self.fifo:
            frame, flags = self.fifo[0]
            low, high = (int.from_bytes(frame.data[i : i + 4], "little") for i in (0, 4))
            return (frame.arbitration_id << 21 | flags, len(frame.data), low, high)[(register - RI0R) // 4]
        return self._registers.get(register, 0)

    def write(self, register: int, value: int) -> None:
        """Take what the firmware writes."""
        if register == RF0R:
            if value & _RFOM0 and self.fifo:
                self.fifo.popleft()
            return
        self._registers[register] = value
        box, place = divmod(register - TI0R, MAILBOX_STEP)
        if 0 <= box < MAILBOXES and place == 0 and value & _TXRQ:
            self._request(box, value >> 21)

    def _request(self, box: int, identifier: int) -> None:
        assert self._boxes[box] is None, f"mailbox {box} is written while its frame waits"
        at = MAILBOX_STEP * box
        data = b"".join(self._registers[at + word].to_bytes(4, "little") for word in (TDL0R, TDH0R))
        frame = Frame(identifier, data[: self._registers[at + TDT0R] & 15])
        if self._instant:
            self.sent.append(frame)
            return
        self._boxes[box] = frame
        self._requested.append(box)
