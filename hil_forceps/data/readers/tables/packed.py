"""The text of a file, packed or not, in pieces: gzip and zstd unpacked, UTF-16 as UTF-8, one kind of line end."""

import codecs
import importlib
import zlib
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from typing import IO, Any

from hil_forceps.rig.errors import UserError

GZIP, ZSTD = b"\x1f\x8b", b"\x28\xb5\x2f\xfd"
MAX_UNPACKED_BYTES = 4 << 30  # an hour at 10 kHz with eight columns
PIECE_BYTES = 1 << 22
_PACKED_BYTES = 1 << 16  # read at a time
_ZSTD_BYTES = 1 << 10
_MAX_WINDOW_BYTES = 1 << 27  # of zstd: what its --long gives
_CUT = "the packed file is cut off: what is before was read"
_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def is_packed(head: bytes) -> bool:
    """Tell whether bytes begin as gzip or zstd do."""
    return head.startswith((GZIP, ZSTD))


def path_stem(path: Path) -> str:
    """Return the name of a run: the file's without its suffixes of format and packing."""
    return Path(inner_name(path)).stem


def inner_name(path: Path) -> str:
    """Return the file's name without the suffix of its packing."""
    for packing in (".gz", ".zst"):
        if path.name.lower().endswith(packing):
            return path.name[: -len(packing)]
    return path.name


def unpacked_head(path: Path, count: int) -> bytes:
    """Return the first bytes, unpacked; UserError where the packing is damaged before them."""
    with path.open("rb") as raw:
        return _first(_unpacked(path, raw, []), count)


def read_unpacked(path: Path, limit: int, kind: str, notes: list[str]) -> bytes:
    """Return all bytes, unpacked; UserError where there are more than `limit`, a note where the packing is cut off."""
    with path.open("rb") as raw:
        data = _first(_unpacked(path, raw, notes), limit + 1)
    if len(data) > limit:
        raise UserError(f"{path}: larger than {limit >> 20} MiB; not {kind}")
    return data


def text_pieces(path: Path, notes: list[str], told: Callable[[int], object] = lambda _: None) -> Iterator[bytes]:
    """Yield the text in pieces, as UTF-8 where it was UTF-16, with a line feed at the end of each line.

    `told` is given the bytes of the file that were read. A packed file that is cut off gives what is before, and a
    note. UserError where the packing is damaged or holds more than `MAX_UNPACKED_BYTES`; OSError as the disk does.
    """
    with path.open("rb") as raw:
        total = 0
        for piece in _with_newlines(_as_utf8(path, _unpacked(path, raw, notes))):
            total += len(piece)
            if total > MAX_UNPACKED_BYTES:
                raise UserError(
                    f"{path}: more than {MAX_UNPACKED_BYTES >> 30} GiB of text; cut it, or record as .mcap or .parquet"
                )
            told(raw.tell())
            yield piece


def _unpacked(path: Path, raw: IO[bytes], notes: list[str]) -> Iterator[bytes]:
    head = raw.read(4)
    raw.seek(0)
    if not is_packed(head):
        return iter(lambda: raw.read(PIECE_BYTES), b"")
    inflate = _inflate if head.startswith(GZIP) else _expand
    return _gathered(inflate(path, raw, notes))


def _inflate(path: Path, raw: IO[bytes], notes: list[str]) -> Iterator[bytes]:
    """Unpack gzip, one member behind the other; zeros behind the last are padding."""
    member = zlib.decompressobj(zlib.MAX_WBITS | 16)
    waiting = b""
    try:
        while waiting or (waiting := raw.read(_PACKED_BYTES)):
            yield member.decompress(waiting, PIECE_BYTES)
            waiting = member.unconsumed_tail
            if member.eof:
                waiting = (member.unused_data or raw.read(_PACKED_BYTES)).lstrip(b"\0")
                if not waiting:
                    return
                member = zlib.decompressobj(zlib.MAX_WBITS | 16)
    except zlib.error as error:
        raise UserError(f"{path}: can't be decompressed: {error}; export it again") from error
    yield member.flush()
    if not member.eof:
        notes.append(_CUT)


def _expand(path: Path, raw: IO[bytes], notes: list[str]) -> Iterator[bytes]:
    """Unpack zstd, one frame behind the other; a little at a time, for four bytes may unpack to 128 KiB."""
    zstandard: Any = importlib.import_module("zstandard")  # comes with mcap
    unpacker = zstandard.ZstdDecompressor(max_window_size=_MAX_WINDOW_BYTES)
    frame = unpacker.decompressobj()
    waiting = b""
    try:
        while waiting or (waiting := raw.read(_ZSTD_BYTES)):
            yield frame.decompress(waiting)
            waiting = b""
            if frame.eof:
                waiting = frame.unused_data or raw.read(_ZSTD_BYTES)
                if not waiting:
                    return
                frame = unpacker.decompressobj()
    except zstandard.ZstdError as error:
        raise UserError(f"{path}: can't be decompressed: {str(error)[:100]}; export it again") from error
    notes.append(_CUT)


def _gathered(pieces: Iterator[bytes]) -> Iterator[bytes]:
    """Yield the same bytes in pieces of at least `PIECE_BYTES`."""
    waiting: list[bytes] = []
    size = 0
    for piece in pieces:
        waiting.append(piece)
        size += len(piece)
        if size >= PIECE_BYTES:
            yield b"".join(waiting)
            waiting, size = [], 0
    if size:
        yield b"".join(waiting)


def _first(pieces: Iterator[bytes], count: int) -> bytes:
    found = b""
    for piece in pieces:
        found += piece[: count - len(found)]
        if len(found) >= count:
            break
    return found


def _as_utf8(path: Path, pieces: Iterator[bytes]) -> Iterator[bytes]:
    first = next(pieces, b"")
    if not first.startswith(_UTF16):
        yield first.removeprefix(codecs.BOM_UTF8)
        yield from pieces
        return
    decoder = codecs.getincrementaldecoder("utf-16")()
    try:
        for piece in chain((first,), pieces):
            yield decoder.decode(piece).encode()
        decoder.decode(b"", final=True)
    except UnicodeError as error:
        raise UserError(
            f"{path}: begins as UTF-16 but is not valid UTF-16: {error}; save it as CSV in UTF-8"
        ) from error


def _with_newlines(pieces: Iterator[bytes]) -> Iterator[bytes]:
    r"""Make \n of \\r\\n and of \\r, also where a piece ends between the two."""
    held = b""
    for piece in pieces:
        text = held + piece
        held = b"\r" if text.endswith(b"\r") else b""
        if b"\r" in text:
            text = text[: len(text) - len(held)].replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        if text:
            yield text
    if held:
        yield b"\n"
