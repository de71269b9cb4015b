"""Numeric matrices out of a MATLAB file of version 5 to 7 (MathWorks, "MAT-File Format", level 5).

scipy's reader ends the whole process on some damaged files; this one reads numbers only and refuses them in words.
"""

import struct
import zlib
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

MAGIC = b"MATLAB 5.0 MAT-file"
HEAD_BYTES = 128
MAX_UNPACKED_BYTES = 256 << 20

_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_MATRIX, _COMPRESSED = 14, 15
_NUMERIC_CLASSES = range(6, 16)  # double, single and the integers; no text, cell, struct or sparse
_COMPLEX = 0x0800


class _Element(NamedTuple):
    type: int
    data: bytes


def parse_mat(data: bytes, wanted: frozenset[str]) -> dict[str, NDArray[np.float64]]:
    """Return the wanted variables that are real numeric matrices, each flattened by columns.

    ValueError when the bytes are no such file, end early or contradict themselves.
    """
    if not data.startswith(MAGIC) or len(data) < HEAD_BYTES:
        raise ValueError("no MATLAB 5 head")
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None:
        raise ValueError("its head names no byte order")
    found = {}
    room = MAX_UNPACKED_BYTES
    for element in _elements(data[HEAD_BYTES:], order):
        body = element
        if element.type == _COMPRESSED:
            unpacked = _unpacked(element.data, room)
            room -= len(unpacked)
            body = next(_elements(unpacked, order), element)
        if body.type == _MATRIX:
            name, values = _matrix(body.data, order, wanted)
            if values is not None:
                found[name] = values
    return found


def _elements(data: bytes, order: str) -> Iterator[_Element]:
    offset = 0
    while offset + 8 <= len(data):
        kind, length = struct.unpack_from(f"{order}II", data, offset)
        if kind >> 16:  # up to four bytes stand in the tag itself
            length, kind, begin, after = kind >> 16, kind & 0xFFFF, offset + 4, offset + 8
            if length > 4:
                raise ValueError(f"a short element of {length} bytes")
        else:
            begin = offset + 8
            # What is compressed follows without padding to eight bytes.
            after = begin + (length if kind == _COMPRESSED else -(-length // 8) * 8)
        if begin + length > len(data):
            raise ValueError("it ends inside a variable")
        yield _Element(kind, data[begin : begin + length])
        offset = after


def _unpacked(data: bytes, room: int) -> bytes:
    try:
        unpacked = zlib.decompressobj().decompress(data, room + 1)
    except zlib.error as error:
        raise ValueError(f"a variable can't be unpacked: {error}") from error
    if len(unpacked) > room:
        raise ValueError(f"variables of more than {MAX_UNPACKED_BYTES >> 20} MiB in all")
    return unpacked


def _matrix(data: bytes, order: str, wanted: frozenset[str]) -> tuple[str, NDArray[np.float64] | None]:
    parts = _elements(data, order)
    head = [part.data for _, part in zip(range(3), parts, strict=False)]
    if len(head) < 3 or len(head[0]) < 4 or len(head[1]) % 4:
        raise ValueError("a variable without flags, size and name")
    (flags,) = struct.unpack_from(f"{order}I", head[0])
    name = head[2].decode("latin-1")
    if name not in wanted or flags & 0xFF not in _NUMERIC_CLASSES or flags & _COMPLEX:
        return name, None
    real = next(parts, None)
    if real is None or real.type not in _NUMBERS:
        raise ValueError(f"{name!r} has no numbers")
    # Small whole numbers stand in the file as integers, whatever their class.
    values = np.frombuffer(real.data, dtype=order + _NUMBERS[real.type]).astype(np.float64)
    size = 1
    for length in struct.unpack(f"{order}{len(head[1]) // 4}i", head[1]):
        size *= length
    if size != len(values):
        raise ValueError(f"{name!r} has {len(values)} numbers where its size says {size}")
    return name, values
