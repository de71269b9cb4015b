"""What a host is told once: which drive, and how patient to be."""

from dataclasses import dataclass

from firmware_protocol.frames import BROADCAST_NODE, MAX_NODE


@dataclass(frozen=True)
class HostConfig:
    """Settings of the host for one drive. `node` BROADCAST_NODE takes whichever drive answers first."""

    node: int
    fd: bool = False
    serial_number: int | None = None  # refuse any other drive
    heartbeat_period_ns: int = 20_000_000
    drive_timeout_ns: int = 250_000_000
    discover_period_ns: int = 100_000_000
    enable_timeout_ns: int = 1_000_000_000

    def __post_init__(self) -> None:
        if not BROADCAST_NODE <= self.node <= MAX_NODE:
            raise ValueError(f"node {self.node}: must be {BROADCAST_NODE} to {MAX_NODE}")
        for name in ("heartbeat_period_ns", "drive_timeout_ns", "discover_period_ns", "enable_timeout_ns"):
            if getattr(self, name) <= 0:
                raise ValueError(f"{name} {getattr(self, name)}: must be positive")
