"""The lines of a text log, whatever bytes it has: bounded, numbered, and said of each whether it can be trusted."""

from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from hil_forceps.rig.errors import UserError

MAX_LINE_BYTES = 4096  # an FD frame of 64 bytes takes some 400 characters in ASC
_UTF8_MARK = b"\xef\xbb\xbf"
_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")


class Line(NamedTuple):
    """One line, counted from 1. `problem` says why its text is none, and is empty where it is."""

    number: int
    text: str
    problem: str = ""


def text_lines(path: Path, file: BinaryIO) -> Iterator[Line]:
    """Yield the lines without their ends; UserError for UTF-16.

    A last line without an end is a problem: nobody can tell whether it was cut. Bytes that are no UTF-8 are taken for
    Latin-1, which differs from Windows-1252 in no character of a frame.
    """
    number = 0
    while raw := file.readline(MAX_LINE_BYTES):
        number += 1
        if number == 1:
            if raw.startswith(_UTF16_MARKS):
                raise UserError(f"{path}: is UTF-16; save it as UTF-8 or plain ASCII")
            raw = raw.removeprefix(_UTF8_MARK)
        is_long = len(raw) >= MAX_LINE_BYTES - len(_UTF8_MARK) and not raw.endswith(b"\n")
        has_end = raw.endswith(b"\n") or (is_long and _skip_line(file))
        yield _line(number, raw.rstrip(b"\r\n"), has_end, is_long)


def _skip_line(file: BinaryIO) -> bool:
    """Read the rest of a long line; False when the file ends before it."""
    while rest := file.readline(MAX_LINE_BYTES):
        if rest.endswith(b"\n"):
            return True
    return False


def _line(number: int, raw: bytes, has_end: bool, is_long: bool) -> Line:
    if b"\0" in raw:
        return Line(number, "", "zero bytes, as after a power cut")
    text = _text(raw)
    if is_long:
        return Line(number, text, f"a line of more than {MAX_LINE_BYTES} characters")
    if not has_end and text.strip():
        return Line(number, text, "the end of the file, within a line")
    return Line(number, text)


def _text(raw: bytes) -> str:
    try:
        return raw.decode()
    except UnicodeDecodeError:
        return raw.decode("latin-1")
