"""Stuff bits of a frame, counted: kernels, apart from what may be compiled otherwise (ISO 11898-1:2015, 10.5)."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from virtual_bus.kernel import kernel, subroutine

FD_HEAD_BITS: Final = 17
FD_EXTENSION_BITS: Final = 19  # more of an extended FD frame: 18 of the id, SRR


def _push_bits(word: int, count: int, last: int, run: int, stuffed: int, crc: int) -> tuple[int, int, int, int]:
    """Send `count` bits of `word`, first bit highest; a stuff bit that is due goes ahead of the next bit."""
    for shift in range(count - 1, -1, -1):
        bit = (word >> shift) & 1
        if run == 5:
            stuffed += 1
            last ^= 1
            run = 1
        if bit == last:
            run += 1
        else:
            last = bit
            run = 1
        crc = ((crc << 1) & 0x7FFF) ^ (0x4599 if bit ^ (crc >> 14) else 0)
    return last, run, stuffed, crc


_push = kernel(_push_bits)


def _byte_tables() -> tuple[NDArray[np.int16], NDArray[np.int16]]:
    """Return what a byte does: to stuffing, by last bit and run before it, and to the CRC, by its upper byte.

    Stuffing is packed: stuff bits (2 bits), run after (3 bits), last bit after.
    """
    stuffing = np.zeros((2, 6, 256), dtype=np.int16)
    for last in range(2):
        for run in range(1, 6):
            for byte in range(256):
                last_after, run_after, stuffed, _ = _push_bits(byte, 8, last, run, 0, 0)
                stuffing[last, run, byte] = stuffed | run_after << 2 | last_after << 5
    return stuffing, np.array([_push_bits(byte, 8, 0, 1, 0, 0)[3] for byte in range(256)], dtype=np.int16)


_STUFFING, _CRC15 = _byte_tables()


@subroutine
def _push_bytes(word: int, count: int, last: int, run: int, stuffed: int, crc: int) -> tuple[int, int, int, int]:
    """Do as `_push` for `count` bytes, not at the very beginning of a frame."""
    for shift in range(8 * count - 8, -1, -8):
        byte = (word >> shift) & 0xFF
        after = int(_STUFFING[last, run, byte])  # signed tables: numba makes floats of signed with unsigned
        stuffed += after & 3
        run = (after >> 2) & 7
        last = after >> 5
        crc = ((crc << 8) & 0x7FFF) ^ int(_CRC15[(crc >> 7) ^ byte])
    return last, run, stuffed, crc


@kernel
def extended_id(arbitration_id: int) -> int:
    """Write the bits from SOF to the end of an extended id: 11 of it, SRR 1, IDE 1, 18 of it."""
    return (arbitration_id >> 18) << 20 | 0b11 << 18 | arbitration_id & 0x3FFFF


@kernel
def fd_head(arbitration_id: int, is_extended: bool) -> tuple[int, int]:
    """Write the bits of an FD frame from SOF to BRS; return them and their number."""
    if is_extended:  # RRS 0, FDF 1, res 0, BRS 1 behind the id
        return extended_id(arbitration_id) << 4 | 0b0101, FD_HEAD_BITS + FD_EXTENSION_BITS
    return arbitration_id << 5 | 0b00101, FD_HEAD_BITS  # RRS 0, IDE 0, FDF 1, res 0, BRS 1


@subroutine
def _stuff_bits_behind_head(length: int, data: int, last: int, run: int, stuffed: int, crc: int) -> int:
    """Return the stuff bits of a classical frame, those of its head included, which left things as they are here."""
    last, run, stuffed, crc = _push_bytes(data, length, last, run, stuffed, crc)
    sent = crc
    last, run, stuffed, crc = _push(sent >> 8, 7, last, run, stuffed, crc)
    last, run, stuffed, crc = _push_bytes(sent, 1, last, run, stuffed, crc)
    return stuffed + (1 if run == 5 else 0)


@kernel
def classic_stuff_bits(arbitration_id: int, length: int, data: int) -> int:
    """Return the stuff bits of a classical base data frame, CRC-15 (polynomial 0x4599) included.

    `data`: the bytes as one signed big-endian integer, which crosses into compiled code faster than bytes do.
    """
    # SOF and the bits RTR, IDE, r0 are dominant: zeros around the id.
    head = arbitration_id << 7 | length
    last, run, stuffed, crc = _push(head >> 16, 3, -1, 0, 0, 0)
    last, run, stuffed, crc = _push_bytes(head, 2, last, run, stuffed, crc)
    return _stuff_bits_behind_head(length, data, last, run, stuffed, crc)


@kernel
def extended_stuff_bits(arbitration_id: int, length: int, data: int) -> int:
    """Do as `classic_stuff_bits` for an extended frame."""
    head = extended_id(arbitration_id) << 7 | length  # RTR, r1, r0 and four bits of DLC
    last, run, stuffed, crc = _push(head >> 32, 7, -1, 0, 0, 0)
    last, run, stuffed, crc = _push_bytes(head, 4, last, run, stuffed, crc)
    return _stuff_bits_behind_head(length, data, last, run, stuffed, crc)


@kernel
def fd_stuff_bits(arbitration_id: int, is_extended: bool, dlc: int, data: bytes) -> tuple[int, int]:
    """Return the dynamic stuff bits of an FD frame in (nominal, data) phase; the CRC field has fixed ones only.

    A run of five that ends with the last data bit gets none: the fixed stuff bit ahead of the stuff count breaks it.
    """
    head, head_bits = fd_head(arbitration_id, is_extended)
    last, run, nominal, crc = _push(head, head_bits, -1, 0, 0, 0)
    last, run, body, crc = _push(dlc, 5, last, run, 0, crc)  # ESI 0: an error-active sender
    for byte in data:
        last, run, body, crc = _push(byte, 8, last, run, body, crc)
    return nominal, body
