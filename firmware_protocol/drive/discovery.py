"""When a drive answers DISCOVER: not all at once."""

from binascii import crc_hqx
from typing import Final

from firmware_protocol.codec import CRC16_INIT

SLOTS: Final = 64
SLOT_US: Final = 500  # longer than one IDENTITY frame at 500 kbit/s with all its stuffing
MAX_DELAY_US: Final = (SLOTS - 1) * SLOT_US


def identity_delay_us(serial_number: int, discoveries: int) -> int:
    """Return the delay of the answer to the DISCOVER number `discoveries` since power-up, counted from 0.

    Two drives that share a node id send IDENTITY under the same arbitration id, so they must not send together. Mixing
    the count in makes a pair that met in one round part in the next.
    """
    seed = serial_number.to_bytes(6, "little") + (discoveries & 0xFF).to_bytes(1, "little")
    return crc_hqx(seed, CRC16_INIT) % SLOTS * SLOT_US
