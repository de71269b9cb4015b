"""Frames as lines of `candump -L`, a batch at a time: (seconds) channel id#data direction.

    (0.000405) can0 141#0100000000000A5B R

A batch is a few arrays, and one kernel writes its text: line by line in Python a frame takes eight times as long.
Seconds are rounded as Python's `f` format does it: the float's exact value, half to even.
"""

import math
from collections.abc import Sequence
from itertools import chain
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.frames import Frame
from hil_forceps.kernels.compiler import kernel_compiler, subroutine

kernel = kernel_compiler(("hil_forceps/bridge/logs/candump_lines.py",))

Arrivals = Sequence[tuple[int, Frame]]
Batch = list[tuple[bool, Arrivals]]  # received or sent, and what; it must not change any more
Bytes = NDArray[np.uint8]

CHANNEL: Final = "can0"  # what candump's format wants to call the bus; there is only one
RECEIVED, FD, EXTENDED = 1, 2, 4  # bits of a frame's flags
_CHANNEL: Final = np.frombuffer(f") {CHANNEL} ".encode(), np.uint8)
_HEX: Final = np.frombuffer(b"0123456789ABCDEF", np.uint8)
_OPEN, _POINT, _ZERO, _HASH, _SPACE, _R, _T, _END = (ord(each) for each in "(.0# RT\n")
_MAX_LINE_BYTES: Final = 64  # without its data
_SPLITTER: Final = 134217729.0  # 2**27 + 1: halves the digits of a float (Dekker, 1971)


@subroutine
def microseconds(time_s: float) -> int:
    """Return a time that isn't negative in µs, the float's exact value rounded half to even."""
    product = time_s * 1e6
    # What the product lost by its own rounding, exactly; 1e6 has few enough digits to need no halving.
    upper = time_s * _SPLITTER - (time_s * _SPLITTER - time_s)
    lost = (upper * 1e6 - product) + (time_s - upper) * 1e6
    whole = math.floor(product)
    above_half = (product - whole) - 0.5
    is_up = above_half > 0.0 or (above_half == 0.0 and (lost > 0.0 or (lost == 0.0 and whole % 2.0 == 1.0)))
    return int(whole) + int(is_up)


@subroutine
def _put_decimal(text: Bytes, at: int, number: int, digits: int) -> int:
    """Write a number with `digits` digits at least; return where it ends."""
    while number >= 10**digits:
        digits += 1
    for place in range(at + digits - 1, at - 1, -1):
        text[place] = _ZERO + number % 10
        number //= 10
    return at + digits


@subroutine
def _put_hexadecimal(text: Bytes, at: int, number: int, digits: int) -> int:
    """Write a number with `digits` digits at least; return where it ends."""
    while number >> 4 * digits:
        digits += 1
    for place in range(at + digits - 1, at - 1, -1):
        text[place] = _HEX[number & 15]
        number >>= 4
    return at + digits


@kernel
def write_lines(
    text: Bytes, time_s: NDArray[np.float64], ids: NDArray[np.int64], flags: Bytes, ends: NDArray[np.int64], data: Bytes
) -> int:
    """Write the lines of frames to `text`; return where they end. `ends`: of each frame's bytes in `data`."""
    at = begin = 0
    for frame in range(time_s.shape[0]):
        text[at] = _OPEN
        time_us, flag = microseconds(time_s[frame]), flags[frame]
        at = _put_decimal(text, at + 1, time_us // 1_000_000, 1)
        text[at] = _POINT
        at = _put_decimal(text, at + 1, time_us % 1_000_000, 6)
        for letter in _CHANNEL:
            text[at] = letter
            at += 1
        at = _put_hexadecimal(text, at, ids[frame], 8 if flag & EXTENDED else 3)
        text[at] = _HASH
        at += 1
        if flag & FD:  # another hash, and the flag of the bit-rate switch
            text[at], text[at + 1] = _HASH, _ZERO + 1
            at += 2
        for place in range(begin, ends[frame]):
            text[at], text[at + 1] = _HEX[data[place] >> 4], _HEX[data[place] & 15]
            at += 2
        begin = ends[frame]
        text[at], text[at + 1], text[at + 2] = _SPACE, _R if flag & RECEIVED else _T, _END
        at += 3
    return at


class CandumpLines:
    """The lines of one log."""

    def __init__(self) -> None:
        self._last_s = 0.0
        self.of([(True, ((0, Frame(0, b"")),))], 0)  # compiled, or loaded, now: a thread writes while the loop runs

    def of(self, batch: Batch, begin_ns: int) -> str:
        """Return the lines; a time before the last becomes that, since the format knows no going back."""
        arrivals = [frames for _, frames in batch if frames]
        if not arrivals:
            return ""
        times_ns, frames = zip(*chain.from_iterable(arrivals), strict=True)
        ids, payloads, are_fd, are_extended = zip(*frames, strict=True)
        time_s = np.asarray((np.array(times_ns, np.int64) - begin_ns) * 1e-9, np.float64)
        np.maximum.accumulate(time_s, out=time_s)
        np.maximum(time_s, self._last_s, out=time_s)
        self._last_s = float(time_s[-1])
        are_received = np.repeat([bool(each) for each, _ in batch], [len(each) for _, each in batch])
        flags = RECEIVED * are_received + FD * np.array(are_fd, np.uint8) + EXTENDED * np.array(are_extended, np.uint8)
        ends = np.cumsum(list(map(len, payloads)), dtype=np.int64)
        data = np.frombuffer(b"".join(payloads), np.uint8)
        text = np.empty(_MAX_LINE_BYTES * len(frames) + 2 * data.size, np.uint8)
        size = write_lines(text, time_s, np.array(ids, np.int64), flags.astype(np.uint8), ends, data)
        return text[:size].tobytes().decode("ascii")
