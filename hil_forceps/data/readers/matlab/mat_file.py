"""Numeric arrays out of a MATLAB file of version 5 to 7 (MathWorks, "MAT-File Format", level 5), also in structures.

scipy's reader ends the whole process on some damaged files; this one reads numbers only and refuses them in words.
"""

import math
import struct
import zlib
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

MAGIC = b"MATLAB 5.0 MAT-file"
HEAD_BYTES = 128
MAX_UNPACKED_BYTES = 256 << 20
MAX_VARIABLES = 10_000
MAX_DEPTH = 8  # of structures in structures

_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_MATRIX, _COMPRESSED = 14, 15
_STRUCTURE = 2
_NUMERIC_CLASSES = range(6, 16)  # double, single and the integers; no text, cell, struct or sparse
_COMPLEX = 0x0800


class _Element(NamedTuple):
    type: int
    data: bytes


def parse_mat(data: bytes) -> dict[str, NDArray[np.float64]]:
    """Return the variables that are real numeric arrays, by name; a field of a structure is `log/pos`.

    ValueError when the bytes are no such file, end early or contradict themselves.
    """
    if not data.startswith(MAGIC) or len(data) < HEAD_BYTES:
        raise ValueError("no MATLAB 5 head")
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None:
        raise ValueError("its head names no byte order")
    found: dict[str, NDArray[np.float64]] = {}
    room = MAX_UNPACKED_BYTES
    for element in _elements(data[HEAD_BYTES:], order):
        body = element
        if element.type == _COMPRESSED:
            unpacked = _unpacked(element.data, room)
            room -= len(unpacked)
            body = next(_elements(unpacked, order), element)
        if body.type == _MATRIX:
            _take(body.data, order, "", found, 0)
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


def _take(data: bytes, order: str, path: str, found: dict[str, NDArray[np.float64]], depth: int) -> None:
    """Take a variable, or what is in a structure; anything else is passed over."""
    parts = _elements(data, order)
    head = [part.data for _, part in zip(range(3), parts, strict=False)]
    if len(head) < 3 or len(head[0]) < 4 or len(head[1]) % 4:
        raise ValueError("a variable without flags, size and name")
    (flags,) = struct.unpack_from(f"{order}I", head[0])
    name = path or head[2].decode("latin-1")
    shape = struct.unpack(f"{order}{len(head[1]) // 4}i", head[1])
    if len(found) >= MAX_VARIABLES:
        raise ValueError(f"more than {MAX_VARIABLES} variables")
    if flags & 0xFF == _STRUCTURE and math.prod(shape) == 1 and depth < MAX_DEPTH:
        for field, body in _fields(parts, order):
            _take(body, order, f"{name}/{field}", found, depth + 1)
    elif flags & 0xFF in _NUMERIC_CLASSES and not flags & _COMPLEX and math.prod(shape):
        found[name] = _numbers(name, next(parts, None), order, shape)


def _fields(parts: Iterator[_Element], order: str) -> Iterator[tuple[str, bytes]]:
    """Yield the name and the bytes of each field of a structure."""
    length, names = next(parts, None), next(parts, None)
    if length is None or names is None or len(length.data) != 4:
        raise ValueError("a structure without names")
    (size,) = struct.unpack(f"{order}i", length.data)
    if size <= 0 or len(names.data) % size:
        raise ValueError(f"names of {size} characters in {len(names.data)}")
    for begin in range(0, len(names.data), size):
        field = next(parts, None)
        if field is None:
            raise ValueError("it ends inside a structure")
        if field.type == _MATRIX and field.data:
            yield names.data[begin : begin + size].split(b"\0")[0].decode("latin-1"), field.data


def _numbers(name: str, real: _Element | None, order: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
    if real is None or real.type not in _NUMBERS:
        raise ValueError(f"{name!r} has no numbers")
    width = np.dtype(_NUMBERS[real.type]).itemsize
    # Small whole numbers stand in the file as integers, whatever their class.
    values = np.frombuffer(real.data[: len(real.data) // width * width], dtype=order + _NUMBERS[real.type])
    if min(shape, default=0) < 0 or math.prod(shape) != len(values):
        raise ValueError(f"{name!r} has {len(values)} numbers where its size says {math.prod(shape)}")
    return values.astype(np.float64).reshape(shape, order="F")
