"""The channel from a loop to the process of the live page: shared memory that the loop writes without waiting.

A ring of slots contains the messages, a board the newest status as JSON, and two bytes the operator's requests. There
is one writer of each and no lock. A slot is filled before its number is set, and the count of all slots after that. But
the order in which another processor sees these writes is not guaranteed. Therefore each slot and each board has a CRC,
and data with a wrong CRC are not used. A reader that is too slow loses the oldest slots, and counts them.
"""

import json
import mmap
import os
import struct
import tempfile
from typing import Any, Final, NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

PAYLOAD_BYTES: Final = 80
SLOTS: Final = 1 << 16  # 15 s of four messages a tick at 1 kHz; 6 MiB
BOARD_BYTES: Final = 1 << 15
STATUS_PERIOD_NS: Final = 200_000_000  # between two statuses
_HEAD: Final = struct.Struct("<QIBBH")  # number (from 1 on), CRC, topic, axis, bytes of the message
_COUNT: Final = struct.Struct("<Q")
_BOARD: Final = struct.Struct("<III")  # serial number, length, CRC
_SLOT_BYTES: Final = _HEAD.size + PAYLOAD_BYTES
_ESTOP_AT: Final = 64  # each writer has its own cache line
_CLEAR_AT: Final = 65
_BOARDS_AT: Final = 128
_SLOTS_AT: Final = _BOARDS_AT + 2 * (_BOARD.size + BOARD_BYTES)

SLOT: Final = np.dtype(
    [("number", "<u8"), ("crc", "<u4"), ("topic", "u1"), ("axis", "u1"), ("size", "<u2"), ("data", f"V{PAYLOAD_BYTES}")]
)


def size_bytes(slots: int = SLOTS) -> int:
    """Return the size of a channel's memory."""
    return _SLOTS_AT + slots * _SLOT_BYTES


def create(slots: int = SLOTS) -> tuple[int, mmap.mmap]:
    """Return anonymous memory as a file descriptor that a child can inherit, and mapped."""
    if hasattr(os, "memfd_create"):
        descriptor = os.memfd_create("hil_forceps_live")
    else:
        with tempfile.TemporaryFile() as file:
            descriptor = os.dup(file.fileno())
    os.ftruncate(descriptor, size_bytes(slots))
    return descriptor, mmap.mmap(descriptor, size_bytes(slots))


class Writer:
    """The loop's end of the channel. Nothing waits; a message costs about a microsecond."""

    def __init__(self, memory: mmap.mmap) -> None:
        self._memory = memory
        self._slots = (len(memory) - _SLOTS_AT) // _SLOT_BYTES
        self._written = 0
        self._boards = 0

    def put(self, topic: int, axis: int, message: bytes) -> None:
        """Write one message; if the ring is full, it overwrites the oldest."""
        memory, number = self._memory, self._written
        at = _SLOTS_AT + number % self._slots * _SLOT_BYTES
        size = len(message)
        memory[at + 16 : at + 16 + size] = message
        self._written = number = number + 1
        _HEAD.pack_into(memory, at, number, crc32(message), topic, axis, size)
        _COUNT.pack_into(memory, 0, number)

    def post(self, status: object) -> None:
        """Write the status to the older of two places; a status that is too long is dropped."""
        text = json.dumps(status, separators=(",", ":")).encode()
        if len(text) > BOARD_BYTES:
            return
        self._boards += 1
        at = _BOARDS_AT + self._boards % 2 * (_BOARD.size + BOARD_BYTES)
        self._memory[at + _BOARD.size : at + _BOARD.size + len(text)] = text
        _BOARD.pack_into(self._memory, at, self._boards, len(text), crc32(text))

    def stop_asked(self) -> bool:
        """Return whether an operator has requested an emergency stop; never reset."""
        return self._memory[_ESTOP_AT] != 0

    def clears_asked(self) -> int:
        """Return the number of an operator's requests to clear the stop, modulo 256."""
        return self._memory[_CLEAR_AT]


class Operator:
    """Requests of an operator at the page; the loop reads them once a tick."""

    def __init__(self, memory: mmap.mmap) -> None:
        self._memory = memory

    def stop(self) -> None:
        """Request an emergency stop."""
        self._memory[_ESTOP_AT] = 1

    def clear(self) -> None:
        """Request to clear the emergency stop."""
        self._memory[_CLEAR_AT] = (self._memory[_CLEAR_AT] + 1) % 256


class Taken(NamedTuple):
    """Slots in order, and the number of lost ones."""

    slots: NDArray[np.void]
    lost: int


class Reader:
    """The reader's end. Invalid memory never raises: it is skipped, and counted if it was a message."""

    def __init__(self, memory: mmap.mmap) -> None:
        if len(memory) < size_bytes(1):
            raise ValueError(f"a channel takes {size_bytes(1)} bytes at least, not {len(memory)}")
        self._memory = memory
        self._slots = (len(memory) - _SLOTS_AT) // _SLOT_BYTES
        self._next = 0
        self._board = 0
        self._waited_for = -1

    def take(self, limit: int = 1 << 14) -> Taken:
        """Return the messages written since the last call, at most `limit`."""
        (written,) = _COUNT.unpack_from(self._memory, 0)
        behind = max(0, written - self._slots - self._next)
        self._next += behind
        wanted = min(written - self._next, limit)
        if wanted <= 0:
            return Taken(np.empty(0, SLOT), behind)
        first = self._next % self._slots
        head = min(wanted, self._slots - first)
        begin = _SLOTS_AT + first * _SLOT_BYTES
        copied = self._memory[begin : begin + head * _SLOT_BYTES]
        copied += self._memory[_SLOTS_AT : _SLOTS_AT + (wanted - head) * _SLOT_BYTES]
        slots = np.frombuffer(copied, SLOT)
        return self._checked(slots, behind)

    def _checked(self, slots: NDArray[np.void], lost: int) -> Taken:
        """Remove incomplete slots: overwritten ones are lost, unfinished ones are read later."""
        expected = np.arange(self._next + 1, self._next + 1 + len(slots), dtype=np.uint64)
        is_whole = slots["number"] == expected
        for place in np.flatnonzero(is_whole):
            slot = slots[place]
            size = int(slot["size"])
            is_whole[place] = size <= PAYLOAD_BYTES and crc32(slot["data"].tobytes()[:size]) == slot["crc"]
        early = np.flatnonzero(~is_whole & (slots["number"] <= expected))
        end = len(slots)
        # A slot that is still unfinished at the second look is lost.
        if early.size and self._waited_for != self._next + int(early[0]):
            end = int(early[0])
            self._waited_for = self._next + end
        self._next += end
        return Taken(slots[:end][is_whole[:end]], lost + end - int(np.count_nonzero(is_whole[:end])))

    def status(self) -> Any | None:
        """Return the newest status if there is one since the last call, None otherwise."""
        found: tuple[int, Any] | None = None
        for place in (0, 1):
            at = _BOARDS_AT + place * (_BOARD.size + BOARD_BYTES)
            serial, length, crc = _BOARD.unpack_from(self._memory, at)
            if serial <= max(self._board, 0 if found is None else found[0]) or length > BOARD_BYTES:
                continue
            text = self._memory[at + _BOARD.size : at + _BOARD.size + length]
            if crc32(text) == crc:
                found = serial, json.loads(text)
        if found is None:
            return None
        self._board = found[0]
        return found[1]
