"""What a drive is told once: who it is, its limits and its timeouts."""

from dataclasses import dataclass

from firmware_protocol.messages import PROTOCOL_MAJOR, PROTOCOL_MINOR
from firmware_protocol.parameters import (
    BY_NAME,
    INT32_MAX,
    INT32_MIN,
    SERIAL_HALF_BITS,
    Index,
)

_COUNTED = (Index.REJECTED, Index.SETPOINTS_ACCEPTED, Index.SETPOINTS_LOST)


@dataclass(frozen=True)
class DriveConfig:
    """Settings of one drive; angles in 2**-24 rev, times in µs. ValueError names every field out of its range."""

    node: int
    serial_number: int
    fd: bool = False
    theta_min_raw: int = INT32_MIN
    theta_max_raw: int = INT32_MAX
    max_step_raw: int = 1 << 18
    reference_tolerance_raw: int = 1 << 14
    watchdog_timeout_us: int = 20_000
    host_heartbeat_timeout_us: int = 100_000
    heartbeat_period_us: int = 100_000
    arm_timeout_us: int = 1_000_000
    max_sample_age: int = 20
    sample_period_us: int = 1_000
    counts_per_rev: int = 1 << 24
    torque_constant_nN_m_per_A: int = 13_500_000

    def __post_init__(self) -> None:
        problems = []
        if not 0 <= self.serial_number < 1 << (2 * SERIAL_HALF_BITS):
            problems.append(f"serial_number {self.serial_number}: must fit 48 bits")
        for name, row in BY_NAME.items():
            value = getattr(self, name, None)
            if value is not None and not row.minimum <= value <= row.maximum:
                problems.append(f"{name} {value}: must be {row.minimum} to {row.maximum}")
        if self.theta_min_raw > self.theta_max_raw:
            problems.append(f"theta_min_raw {self.theta_min_raw} is above theta_max_raw {self.theta_max_raw}")
        if problems:
            raise ValueError("; ".join(problems))

    def parameter_values(self) -> dict[int, int]:
        """Return the value of every parameter by its index, counters at zero."""
        values = {int(row.number): int(getattr(self, name)) for name, row in BY_NAME.items() if hasattr(self, name)}
        values[Index.PROTOCOL_MAJOR] = PROTOCOL_MAJOR
        values[Index.PROTOCOL_MINOR] = PROTOCOL_MINOR
        values[Index.SERIAL_LOW] = self.serial_number & ((1 << SERIAL_HALF_BITS) - 1)
        values[Index.SERIAL_HIGH] = self.serial_number >> SERIAL_HALF_BITS
        return {**values, **dict.fromkeys(_COUNTED, 0)}
