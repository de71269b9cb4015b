"""How much of a CAN bus's time frames take, at most: stuffed at worst, with the gap behind each (ISO 11898-1:2015)."""

from typing import Final

INTERMISSION_BITS: Final = 3
_CLASSIC_BITS, _CLASSIC_STUFFED = 44, 34  # a base frame without data, and its part that is stuffed
_EXTENSION_BITS: Final = 20  # of an extended classic frame: SRR, 18 of the id, r1
_FD_HEAD_BITS, _FD_EXTENSION_BITS = 17, 19
_FD_HEAD_STUFF: Final = {False: 3, True: 7}  # at most, by whether the id has 29 bits
_FD_TAIL_BITS, _FD_DATA_BITS = 9, 10  # acknowledgement and end of frame; ESI, DLC, stuff count, CRC delimiter
_SHORT_CRC_BYTES: Final = 16


def most_bits(length: int, is_fd: bool, is_extended: bool) -> tuple[int, int]:
    """Return the most bits at the nominal and at the data rate that a frame with `length` bytes takes."""
    if not is_fd:
        extension = _EXTENSION_BITS if is_extended else 0
        stuff = (_CLASSIC_STUFFED + extension + 8 * length - 1) // 4
        return _CLASSIC_BITS + extension + 8 * length + stuff + INTERMISSION_BITS, 0
    head, head_stuff = _FD_HEAD_BITS + (_FD_EXTENSION_BITS if is_extended else 0), _FD_HEAD_STUFF[is_extended]
    crc = 17 + 6 if length <= _SHORT_CRC_BYTES else 21 + 7  # with its fixed stuff bits
    stuff = (head + 5 + 8 * length - 1) // 4
    nominal = head + head_stuff + _FD_TAIL_BITS + INTERMISSION_BITS
    return nominal, _FD_DATA_BITS + 8 * length + crc + stuff - head_stuff


class LineUse:
    """Adds up the frames of a run by their kind."""

    def __init__(self) -> None:
        self._counts: dict[tuple[int, bool, bool], int] = {}

    def add(self, length: int, is_fd: bool, is_extended: bool) -> None:
        """Count a frame."""
        kind = (length, is_fd, is_extended)
        self._counts[kind] = self._counts.get(kind, 0) + 1

    def time_s(self, bitrate_bit_per_s: int, data_bitrate_bit_per_s: int) -> float:
        """Return the time that all took on the bus, at most."""
        total = 0.0
        for kind, count in self._counts.items():
            nominal, data = most_bits(*kind)
            total += count * (nominal / bitrate_bit_per_s + data / data_bitrate_bit_per_s)
        return total
