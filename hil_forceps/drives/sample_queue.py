"""Samples of a maker's drive, on their way to the service."""

from typing import Final

from firmware_protocol.host.samples import RawSample
from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_PER_REV, CURRENT_LSB_A
from hil_forceps.drives.port import SEQUENCE_MASK

MAX_QUEUED_SAMPLES: Final = 4096
# What a recording holds; nothing real is beyond.
_ANGLE_END: Final = 1 << 62
_CURRENT_END: Final = 1 << 31

COUNTERS: Final = ("samples", "samples_overflow", "out_of_range")


class SampleQueue:
    """Numbers samples, brings them to raw integers, and keeps them until taken; at most `MAX_QUEUED_SAMPLES`."""

    def __init__(self, counters: dict[str, int]) -> None:
        """`counters`: those of the profile, with the names of `COUNTERS` among them."""
        self._counters = counters
        self._samples: list[RawSample] = []
        self._sequence = 0

    def append(
        self,
        *,
        stamp_ns: int,
        received_ns: int,
        pulley_rev: float,
        current_A: float,
        state: DriveState | None,
        setpoint_sequence: int,
    ) -> bool:
        """Take one sample; False, and counted, where the queue is full or a recording can't hold it."""
        if len(self._samples) >= MAX_QUEUED_SAMPLES:
            self._counters["samples_overflow"] += 1
            return False
        theta_m_raw, current_raw = round(pulley_rev * ANGLE_LSB_PER_REV), round(current_A / CURRENT_LSB_A)
        if abs(theta_m_raw) >= _ANGLE_END or abs(current_raw) >= _CURRENT_END:
            self._counters["out_of_range"] += 1
            return False
        self._counters["samples"] += 1
        self._sequence = self._sequence + 1 & SEQUENCE_MASK
        said = DriveState.DISABLED if state is None else state
        self._samples.append(
            RawSample(self._sequence, stamp_ns, theta_m_raw, current_raw, int(said), 0, setpoint_sequence, received_ns)
        )
        return True

    def take(self) -> list[RawSample]:
        """Hand over the samples since the last call, oldest first."""
        samples, self._samples = self._samples, []
        return samples
