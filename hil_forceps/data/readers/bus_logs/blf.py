"""Vector's BLF: objects in containers, packed by zlib.

There is no public specification; layouts are those of Vector's `binlog_objects.h` as python-can's reader and T. Lorenz'
`vector_blf` have them. An object begins with its size, so damage to a size ends the reading: what is before it stays.
"""

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from firmware_protocol.frames import Frame
from hil_forceps.data.readers.bus_logs.account import Account, LoggedFrame, fits, is_id
from hil_forceps.rig.errors import UserError

MAGIC = b"LOGG"
MAX_OBJECT_BYTES = 1 << 26  # writers pack 128 kB a container
MAX_CONTAINER_BYTES = 1 << 26
MAX_FRAME_OBJECT_BYTES = 1 << 12  # an FD frame with all that goes with it has some 200
_MARK = b"LOBJ"
_MAX_PADDING_BYTES = 8  # between objects

_BASE = struct.Struct("<4sHHLL")  # mark, header's size and version, object's size and type
_STAMPS = {1: struct.Struct("<LHHQ"), 2: struct.Struct("<LBxHQ8x")}  # flags first, time last
_UNITS_NS = {1: 10_000, 2: 1}  # by flags: ten microseconds, one nanosecond
_CONTAINER = struct.Struct("<H6xL4x")
_CLASSIC = struct.Struct("<HBBL8s")  # channel, flags, length code, id, data
_FD = struct.Struct("<HBBLLBBB5x64s")  # ..., frame length, bit count, FD flags, valid bytes, data
_FD64 = struct.Struct("<BBBBLLLLLLLHBBL")  # channel, code, valid bytes, tx count, id, ..., end of the data, CRC

_CONTAINER_TYPE = 10
_CLASSIC_TYPES = frozenset((1, 86))
_ERROR_TYPES = frozenset((2, 73, 104))
_FD_TYPE, _FD64_TYPE = 100, 101
_FRAME_TYPES = frozenset((*_CLASSIC_TYPES, *_ERROR_TYPES, _FD_TYPE, _FD64_TYPE))
_EXTENDED = 0x8000_0000
_REMOTE = 0x80


class _Piece(NamedTuple):
    place: str  # of it in the file
    data: bytes


class _DamageError(Exception):
    """Nothing behind this place can be read."""


def blf_frames(path: Path, file: BinaryIO, account: Account) -> Iterator[LoggedFrame]:
    """Yield the frames of a log as far as its objects hang together; UserError when it is none."""
    _skip_head(path, file)
    walker = _Walker(account)
    try:
        for piece in _pieces(file):
            yield from walker.feed(piece)
        if walker.awaited:
            raise _DamageError("its end, within an object")
    except _DamageError as damage:
        account.damage = str(damage)


def _skip_head(path: Path, file: BinaryIO) -> None:
    head = file.read(8)
    size = int.from_bytes(head[4:8], "little")
    if len(head) < 8 or head[:4] != MAGIC:
        raise UserError(f"{path}: not a BLF file (it does not begin with LOGG); correct its suffix")
    if not 72 <= size <= 1 << 16 or len(file.read(size - 8)) < size - 8:
        raise UserError(f"{path}: its header is damaged or cut off; export the log again")


def _pieces(file: BinaryIO) -> Iterator[_Piece]:
    """Yield what containers hold, unpacked, and objects that stand outside of one."""
    offset = file.tell()
    while head := file.read(_BASE.size + _MAX_PADDING_BYTES):
        at = head.find(_MARK, 0, _MAX_PADDING_BYTES + len(_MARK))
        if at < 0:
            if not head.strip(b"\0") and not _has_more(file):
                return  # padding of the last object
            raise _DamageError(f"byte {offset}, where no object begins")
        offset += at
        file.seek(offset)
        head = file.read(_BASE.size)
        if len(head) < _BASE.size:
            raise _DamageError(f"byte {offset}: the end of the file, within an object")
        _, _, _, size, kind = _BASE.unpack(head)
        if not _BASE.size <= size <= MAX_OBJECT_BYTES:
            raise _DamageError(f"byte {offset}, where an object has the length {size} bytes")
        body = file.read(size - _BASE.size)
        yield from _unpacked(offset, body) if kind == _CONTAINER_TYPE else [_Piece(f"byte {offset}", head + body)]
        if len(body) < size - _BASE.size:
            raise _DamageError(f"byte {offset}: the end of the file, within an object")
        offset += size


def _has_more(file: BinaryIO) -> bool:
    return bool(file.read(1))


def _unpacked(offset: int, body: bytes) -> Iterator[_Piece]:
    place = f"the container at byte {offset}"
    if len(body) < _CONTAINER.size:
        raise _DamageError(f"{place}, which is cut off")
    method = _CONTAINER.unpack_from(body)[0]
    packed = body[_CONTAINER.size :]
    if method == 0:
        yield _Piece(place, packed)
        return
    if method != 2:
        raise _DamageError(f"{place}, which is packed by method {method}; only zlib (2) and none (0) are read")
    inflater = zlib.decompressobj()
    try:
        data = inflater.decompress(packed, MAX_CONTAINER_BYTES)
    except zlib.error as error:
        raise _DamageError(f"{place}, which can't be unpacked ({error})") from None
    yield _Piece(place, data)
    if not inflater.eof:
        raise _DamageError(f"{place}, which is cut off or larger than {MAX_CONTAINER_BYTES >> 20} MiB")


class _Walker:
    """Takes pieces, gives frames; keeps no more than one object that goes on in the next piece."""

    def __init__(self, account: Account) -> None:
        self._account = account
        self._kept = b""
        self._to_skip = 0  # bytes of an object that is of no use

    @property
    def awaited(self) -> bool:
        """Tell whether an object has begun that did not end."""
        return self._to_skip > 0 or bool(self._kept.strip(b"\0"))

    def feed(self, piece: _Piece) -> Iterator[LoggedFrame]:
        """Yield the frames that are whole with this piece."""
        skipped = min(self._to_skip, len(piece.data))
        self._to_skip -= skipped
        data = self._kept + piece.data[skipped:]
        position = 0
        while True:
            at = data.find(_MARK, position, position + _MAX_PADDING_BYTES + len(_MARK))
            if at < 0:
                if len(data) - position >= _MAX_PADDING_BYTES + len(_MARK):
                    raise _DamageError(f"{piece.place}, where no object begins {position} bytes into it")
                break
            position = at
            if len(data) - position < _BASE.size:
                break
            _, head_bytes, version, size, kind = _BASE.unpack_from(data, position)
            if size < _BASE.size or (kind in _FRAME_TYPES and size > MAX_FRAME_OBJECT_BYTES):
                raise _DamageError(f"{piece.place}, where an object has the length {size} bytes")
            after = position + size
            if kind not in _FRAME_TYPES:
                self._account.others["event"] += 1
                self._to_skip = max(after - len(data), 0)
                position = min(after, len(data))
                continue
            if after > len(data):
                break
            yield from self._object(piece.place, kind, head_bytes, version, data[position:after])
            position = after
        self._kept = data[position:]

    def _object(self, place: str, kind: int, head_bytes: int, version: int, data: bytes) -> Iterator[LoggedFrame]:
        if kind in _ERROR_TYPES:
            self._account.others["error"] += 1
            return
        stamp = _STAMPS.get(version)
        if stamp is None or head_bytes < _BASE.size + stamp.size or len(data) < head_bytes:
            self._account.leave_out(place, "", f"a frame with a head of {head_bytes} bytes, version {version}")
            return
        fields = stamp.unpack_from(data, _BASE.size)
        unit_ns = _UNITS_NS.get(fields[0])
        if unit_ns is None:
            self._account.leave_out(place, "", f"a frame whose time is in no known unit (flags {fields[0]})")
            return
        found = _frame(kind, head_bytes, data)
        if found is None:
            self._account.leave_out(place, "", "a frame that contradicts itself")
        elif isinstance(found, str):
            self._account.others[found] += 1
        else:
            bus, frame = found
            yield LoggedFrame(fields[-1] * unit_ns, bus, frame)


def _frame(kind: int, head_bytes: int, whole: bytes) -> tuple[str, Frame] | str | None:
    """Return bus and frame; a word for what is none; None for what contradicts itself."""
    body = whole[head_bytes:]
    if kind in _CLASSIC_TYPES:
        return _classic(body)
    return _fd(body) if kind == _FD_TYPE else _fd64(body, head_bytes)


def _classic(body: bytes) -> tuple[str, Frame] | str | None:
    if len(body) < _CLASSIC.size:
        return None
    channel, flags, code, identifier, data = _CLASSIC.unpack_from(body)
    if code > 15:
        return None
    return _checked(channel, identifier, bool(flags & _REMOTE), data[: min(code, 8)], is_fd=False)


def _fd(body: bytes) -> tuple[str, Frame] | str | None:
    if len(body) < _FD.size:
        return None
    channel, flags, _, identifier, _, _, fd_flags, valid, data = _FD.unpack_from(body)
    if valid > len(data):
        return None
    return _checked(channel, identifier, bool(flags & _REMOTE), data[:valid], is_fd=bool(fd_flags & 1))


def _fd64(body: bytes, head_bytes: int) -> tuple[str, Frame] | str | None:
    if len(body) < _FD64.size:
        return None
    channel, _, valid, _, identifier, _, flags, *_, behind, _ = _FD64.unpack_from(body)
    end = behind - head_bytes if behind else len(body)  # of the data; what is behind them is no frame's
    data = body[_FD64.size : min(_FD64.size + valid, end)].ljust(valid, b"\0")  # CANoe leaves zeros at the end away
    return _checked(channel, identifier, bool(flags & 0x10), data, is_fd=bool(flags & 0x1000))


def _checked(
    channel: int, identifier: int, is_remote: bool, data: bytes, *, is_fd: bool
) -> tuple[str, Frame] | str | None:
    if is_remote:
        return "remote"
    is_extended, identifier = bool(identifier & _EXTENDED), identifier & ~_EXTENDED
    if not is_id(identifier, is_extended) or not fits(len(data), is_fd):
        return None
    return str(channel), Frame(identifier, data, is_fd, is_extended)
