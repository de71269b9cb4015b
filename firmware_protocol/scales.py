"""What one unit on the wire means in SI: the only place where scale factors stand.

Angles count 2**-24 of a revolution, so every encoder with a power-of-two count is carried exactly; they wrap
modulo 2**32 (256 revolutions) and are unwrapped by `unwrap_angle_raw`.
"""

import math
from typing import Final

ANGLE_LSB_PER_REV: Final = 1 << 24
ANGLE_LSB_RAD: Final = 2.0 * math.pi / ANGLE_LSB_PER_REV
CURRENT_LSB_A: Final = 2.0e-4
STAMP_LSB_NS: Final = 1_000
BENCH_TORQUE_LSB_N_M: Final = 1.0e-7

ANGLE_MODULUS: Final = 1 << 32
STAMP_MODULUS: Final = 1 << 32
SEQUENCE_MODULUS: Final = 1 << 8


def unwrap(raw: int, previous: int, modulus: int) -> int:
    """Return the integer congruent to `raw` (mod `modulus`) that is nearest to `previous`."""
    half = modulus >> 1
    return previous + (raw - previous + half) % modulus - half


def angle_raw_from_rad(angle_rad: float) -> int:
    """Round an angle to the wire's unit, unwrapped; ValueError when it isn't finite."""
    return round(angle_rad / ANGLE_LSB_RAD)


def wrap_int32(raw: int) -> int:
    """Fold an unwrapped angle into the signed 32 bits that the wire carries."""
    return (raw + (1 << 31)) % (1 << 32) - (1 << 31)
