"""What a bus log gives: frames with their time and bus, and an account of everything else that stood in it."""

from collections import Counter
from dataclasses import dataclass, field
from typing import NamedTuple

from firmware_protocol.frames import MAX_BASE_ID, MAX_EXTENDED_ID, Frame

CLASSIC_MAX_BYTES = 8
FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)  # by data length code, ISO 11898-1
_SHOWN_CHARACTERS = 60


class LoggedFrame(NamedTuple):
    """A data frame; `time_ns` is None where the log says no time, `bus` is empty where no bus."""

    time_ns: int | None
    bus: str
    frame: Frame

    @property
    def time_s(self) -> float | None:
        """The time in seconds, with what a float can hold of it."""
        return None if self.time_ns is None else self.time_ns * 1e-9


@dataclass(slots=True)
class Account:
    """What else stood in a log. `damage` says where reading ended before the log did, and is empty where it didn't."""

    others: Counter[str] = field(default_factory=Counter)  # remote and error frames, other events
    unreadable: int = 0
    first_unreadable: str = ""
    damage: str = ""
    remarks: list[str] = field(default_factory=list)

    def leave_out(self, place: str, text: str, problem: str = "") -> None:
        """Count a piece that can't be read; of the first one it is kept where it is, and why or what stood there."""
        self.unreadable += 1
        if not self.first_unreadable:
            self.first_unreadable = f"{place} ({problem or show(text)})"

    def remark(self, text: str) -> None:
        """Keep a remark once."""
        if text not in self.remarks:
            self.remarks.append(text)

    def told(self) -> tuple[str, ...]:
        """Return what a reader of the log should know, a sentence each; nothing of a sound log."""
        told = list(self.remarks)
        if self.unreadable:
            pieces = "1 piece of the log" if self.unreadable == 1 else f"{self.unreadable} pieces of the log"
            verb = "was" if self.unreadable == 1 else "were"
            told.append(f"{pieces} can't be read and {verb} left out, the first at {self.first_unreadable}")
        if self.damage:
            told.append(f"the log was read up to {self.damage}")
        return tuple(told)


def show(text: str) -> str:
    """Quote what stood there, printable and cut."""
    return repr(text if len(text) <= _SHOWN_CHARACTERS else f"{text[:_SHOWN_CHARACTERS]}...")


def payload(tokens: list[str], base: int = 16) -> bytes | None:
    """Return the bytes that tokens say, None when one of them is no byte."""
    digits = "0123456789abcdefABCDEF"[: 22 if base == 16 else 10]
    longest = 2 if base == 16 else 3
    if not all(0 < len(token) <= longest and token.strip(digits) == "" for token in tokens):
        return None
    values = [int(token, base) for token in tokens]
    return bytes(values) if all(value < 256 for value in values) else None


def fits(length: int, is_fd: bool) -> bool:
    """Tell whether a frame may have so many bytes; an FD one up to 64: packets of a serial line are logged as such."""
    return 0 <= length <= (FD_LENGTHS[-1] if is_fd else CLASSIC_MAX_BYTES)


def is_id(identifier: int, is_extended: bool) -> bool:
    """Tell whether an arbitration id has its 11 or 29 bits."""
    return 0 <= identifier <= (MAX_EXTENDED_ID if is_extended else MAX_BASE_ID)


def seconds_ns(whole: str, fraction: str) -> int:
    """Return digits before and after the decimal point as ns, exactly."""
    return int(whole) * 1_000_000_000 + int(fraction.ljust(9, "0")[:9])
