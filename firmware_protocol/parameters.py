"""The parameter dictionary: what PARAM_REQUEST may read, what it may write, and within which bounds.

Every value is a signed 32-bit integer in the unit given; names of writable ones are those of `DriveConfig`.
"""

from collections.abc import Mapping
from enum import Enum, IntEnum
from typing import Final, NamedTuple

from firmware_protocol.frames import MAX_NODE
from firmware_protocol.messages import PROTOCOL_MAJOR, PROTOCOL_MINOR, ParamOp

INT32_MIN: Final = -(1 << 31)
INT32_MAX: Final = (1 << 31) - 1
SERIAL_HALF_BITS: Final = 24


class Access(Enum):
    """Who may write: nobody, or the host while the drive is DISABLED."""

    READ_ONLY = "ro"
    WRITE_WHILE_DISABLED = "rw"


class Index(IntEnum):
    """Parameter indices: 0x00xx identity, 0x01xx limits, 0x02xx time, 0x03xx motor, 0x04xx counters."""

    PROTOCOL_MAJOR = 0x0001
    PROTOCOL_MINOR = 0x0002
    NODE = 0x0003
    SERIAL_LOW = 0x0004
    SERIAL_HIGH = 0x0005
    FD = 0x0006
    THETA_MIN = 0x0101
    THETA_MAX = 0x0102
    MAX_STEP = 0x0103
    REFERENCE_TOLERANCE = 0x0104
    WATCHDOG_TIMEOUT = 0x0201
    HOST_HEARTBEAT_TIMEOUT = 0x0202
    HEARTBEAT_PERIOD = 0x0203
    ARM_TIMEOUT = 0x0204
    MAX_SAMPLE_AGE = 0x0205
    SAMPLE_PERIOD = 0x0206
    COUNTS_PER_REV = 0x0301
    TORQUE_CONSTANT = 0x0302
    REJECTED = 0x0401
    SETPOINTS_ACCEPTED = 0x0402
    SETPOINTS_LOST = 0x0403


class Parameter(NamedTuple):
    """One row of the dictionary; `default` None where the value belongs to the device or is counted."""

    number: Index
    name: str
    unit: str
    access: Access
    minimum: int
    maximum: int
    default: int | None


_RO: Final = Access.READ_ONLY
_RW: Final = Access.WRITE_WHILE_DISABLED
_SERIAL_HALF_MAX: Final = (1 << SERIAL_HALF_BITS) - 1

DICTIONARY: Final = (
    Parameter(Index.PROTOCOL_MAJOR, "protocol_major", "1", _RO, 0, 255, PROTOCOL_MAJOR),
    Parameter(Index.PROTOCOL_MINOR, "protocol_minor", "1", _RO, 0, 255, PROTOCOL_MINOR),
    Parameter(Index.NODE, "node", "1", _RO, 1, MAX_NODE, None),
    Parameter(Index.SERIAL_LOW, "serial_low", "1", _RO, 0, _SERIAL_HALF_MAX, None),
    Parameter(Index.SERIAL_HIGH, "serial_high", "1", _RO, 0, _SERIAL_HALF_MAX, None),
    Parameter(Index.FD, "fd", "1", _RO, 0, 1, None),
    Parameter(Index.THETA_MIN, "theta_min_raw", "2^-24 rev", _RW, INT32_MIN, INT32_MAX, INT32_MIN),
    Parameter(Index.THETA_MAX, "theta_max_raw", "2^-24 rev", _RW, INT32_MIN, INT32_MAX, INT32_MAX),
    Parameter(Index.MAX_STEP, "max_step_raw", "2^-24 rev", _RW, 1, 1 << 24, 1 << 18),
    Parameter(Index.REFERENCE_TOLERANCE, "reference_tolerance_raw", "2^-24 rev", _RW, 0, 1 << 20, 1 << 14),
    Parameter(Index.WATCHDOG_TIMEOUT, "watchdog_timeout_us", "us", _RW, 1_000, 500_000, 20_000),
    Parameter(Index.HOST_HEARTBEAT_TIMEOUT, "host_heartbeat_timeout_us", "us", _RW, 5_000, 2_000_000, 100_000),
    Parameter(Index.HEARTBEAT_PERIOD, "heartbeat_period_us", "us", _RW, 5_000, 1_000_000, 100_000),
    Parameter(Index.ARM_TIMEOUT, "arm_timeout_us", "us", _RW, 1_000, 10_000_000, 1_000_000),
    Parameter(Index.MAX_SAMPLE_AGE, "max_sample_age", "samples", _RW, 0, 127, 20),
    Parameter(Index.SAMPLE_PERIOD, "sample_period_us", "us", _RO, 1, 1_000_000, None),
    Parameter(Index.COUNTS_PER_REV, "counts_per_rev", "1/rev", _RO, 1, 1 << 24, None),
    Parameter(Index.TORQUE_CONSTANT, "torque_constant_nN_m_per_A", "1e-9 N m/A", _RO, 1, INT32_MAX, None),
    Parameter(Index.REJECTED, "rejected", "frames", _RO, 0, INT32_MAX, None),
    Parameter(Index.SETPOINTS_ACCEPTED, "setpoints_accepted", "frames", _RO, 0, INT32_MAX, None),
    Parameter(Index.SETPOINTS_LOST, "setpoints_lost", "frames", _RO, 0, INT32_MAX, None),
)

BY_INDEX: Final[dict[int, Parameter]] = {row.number: row for row in DICTIONARY}
BY_NAME: Final[dict[str, Parameter]] = {row.name: row for row in DICTIONARY}


def judge_write(number: int, value: int, values: Mapping[int, int], disabled: bool) -> ParamOp:
    """Return OK when `value` may be written, else the refusal; `values` holds the present ones by index."""
    row = BY_INDEX.get(number)
    if row is None:
        return ParamOp.UNKNOWN_INDEX
    if row.access is Access.READ_ONLY:
        return ParamOp.READ_ONLY
    if not disabled:
        return ParamOp.WRONG_STATE
    if not row.minimum <= value <= row.maximum or _crosses_limits(number, value, values):
        return ParamOp.OUT_OF_RANGE
    return ParamOp.OK


def _crosses_limits(number: int, value: int, values: Mapping[int, int]) -> bool:
    """Tell whether the lower position limit would pass the upper one."""
    if number == Index.THETA_MIN:
        return value > values[Index.THETA_MAX]
    return number == Index.THETA_MAX and value < values[Index.THETA_MIN]
