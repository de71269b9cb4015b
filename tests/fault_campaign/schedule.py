"""A schedule: what goes wrong when, as plain data, drawn from a seed."""

import json
from collections.abc import Mapping
from enum import StrEnum
from random import Random
from typing import Any, Final, NamedTuple

from tests.fault_campaign.rigs import HORIZON_NS, PROFILES

FOREVER_NS: Final = 10_000_000_000


class Kind(StrEnum):
    """What goes wrong."""

    DROP = "drop"
    DUPLICATE = "duplicate"
    REORDER = "reorder"
    DELAY = "delay"
    CORRUPT_PAYLOAD = "corrupt_payload"  # behind a CRC that fits, as a faulty gateway does
    CORRUPT_WIRE = "corrupt_wire"
    FLOOD = "flood"
    SAME_ID = "same_id"
    BUS_OFF = "bus_off"
    BUS_GONE = "bus_gone"
    ERROR_PASSIVE = "error_passive"
    RESET = "reset"
    BROWN_OUT = "brown_out"
    ENCODER_JUMP = "encoder_jump"
    ENCODER_FREEZE = "encoder_freeze"
    CURRENT_STUCK = "current_stuck"
    FULL_QUEUE = "full_queue"
    FULL_DISK = "full_disk"
    LATE_TICK = "late_tick"
    STALLED_ESTIMATOR = "stalled_estimator"
    STOPPED = "stopped"  # the process, and continued
    KILLED = "killed"
    CLOCK_STEP = "clock_step"


class Fault(NamedTuple):
    """One fault. `size` and `where` mean what `DRAWS` says for its kind."""

    kind: Kind
    begin_ns: int
    duration_ns: int = 0
    size: float = 0.0
    where: str = ""

    @property
    def end_ns(self) -> int:
        """When it is over."""
        return self.begin_ns + self.duration_ns


class Schedule(NamedTuple):
    """One run: the protocol, the motion and noises of a seed, the faults."""

    seed: int
    profile: str
    faults: tuple[Fault, ...]

    def to_json(self) -> str:
        """Return it as one line."""
        return json.dumps({"seed": self.seed, "profile": self.profile, "faults": [f._asdict() for f in self.faults]})

    def of_kind(self, *kinds: Kind) -> list[Fault]:
        """Return the faults of some kinds."""
        return [fault for fault in self.faults if fault.kind in kinds]


def from_json(text: str) -> Schedule:
    """Return what `to_json` wrote; KeyError, TypeError or ValueError for anything else."""
    data: Mapping[str, Any] = json.loads(text)
    faults = tuple(Fault(**{**each, "kind": Kind(each["kind"])}) for each in data["faults"])
    if data["profile"] not in PROFILES:
        raise ValueError(f"no profile {data['profile']!r}; there are {', '.join(PROFILES)}")
    return Schedule(int(data["seed"]), data["profile"], faults)


class Draw(NamedTuple):
    """How a kind is drawn: `size` and `duration_ns` uniform in their logarithm, `where` one of those named."""

    duration_ns: tuple[float, float] = (0.0, 0.0)
    size: tuple[float, float] = (0.0, 0.0)
    where: tuple[str, ...] = ("",)
    signed: bool = False  # the size may be negative


_MS = 1_000_000
_WAYS = ("to_drive", "to_host", "both")
_SIDES = ("host", "drive")
DRAWS: Final[dict[Kind, Draw]] = {
    Kind.DROP: Draw((1 * _MS, 150 * _MS), (0.05, 1.0), _WAYS),  # size: probability
    Kind.DUPLICATE: Draw((1 * _MS, 150 * _MS), (0.05, 1.0), _WAYS),
    Kind.REORDER: Draw((1 * _MS, 150 * _MS), (0.05, 0.5), _WAYS),
    Kind.DELAY: Draw((1 * _MS, 100 * _MS), (1e-4, 0.04), _WAYS),  # s
    Kind.CORRUPT_PAYLOAD: Draw((1 * _MS, 150 * _MS), (0.01, 0.5), _WAYS),  # probability
    Kind.CORRUPT_WIRE: Draw((1 * _MS, 150 * _MS), (0.01, 0.5), _WAYS),
    Kind.FLOOD: Draw((1 * _MS, 60 * _MS), (5e-5, 5e-4), ("high", "low")),  # s between frames; their priority
    Kind.SAME_ID: Draw((FOREVER_NS, FOREVER_NS)),
    Kind.BUS_OFF: Draw((0.1 * _MS, 150 * _MS), where=_SIDES),
    Kind.BUS_GONE: Draw((0.1 * _MS, 150 * _MS)),
    Kind.ERROR_PASSIVE: Draw((20 * _MS, 40 * _MS), (10, 33), _SIDES),  # failed transmissions in a row; 32: bus-off
    Kind.RESET: Draw(),
    Kind.BROWN_OUT: Draw((0.2 * _MS, 300 * _MS)),
    Kind.ENCODER_JUMP: Draw((0.5 * _MS, 300 * _MS), (1e-3, 3.0), signed=True),  # rad
    Kind.ENCODER_FREEZE: Draw((1 * _MS, 300 * _MS)),
    Kind.CURRENT_STUCK: Draw((1 * _MS, 300 * _MS), (1e-3, 1.0), signed=True),  # A
    Kind.FULL_QUEUE: Draw((0.2 * _MS, 150 * _MS)),
    Kind.FULL_DISK: Draw((FOREVER_NS, FOREVER_NS), (1.0, 20_000.0)),  # bytes behind the head
    Kind.LATE_TICK: Draw((0, 0), (1e-4, 0.015)),  # s
    Kind.STALLED_ESTIMATOR: Draw((0.1 * _MS, 30 * _MS), (2e-4, 0.05)),  # s a step
    Kind.STOPPED: Draw((0, 0), (0.005, 0.4), ("sleep", "tick")),  # s; where it was stopped
    Kind.KILLED: Draw(),
    Kind.CLOCK_STEP: Draw((0, 0), (1e-4, 0.3), signed=True),  # s
}
# A servo's packets have a CRC from end to end, and its line no error counters.
_NOT_ON_SERIAL = frozenset({Kind.CORRUPT_PAYLOAD, Kind.ERROR_PASSIVE})


def draw(seed: int, profile: str | None = None, among: tuple[Kind, ...] = tuple(Kind)) -> Schedule:
    """Return the schedule of a seed; profiles take turns, `among` others only where one is given."""
    profile = PROFILES[seed % len(PROFILES)] if profile is None else profile
    source = Random(f"schedule {seed} {profile}")
    count = source.choices((0, 1, 2, 3, 4, 5), (2, 40, 28, 15, 10, 5))[0]
    kinds = [kind for kind in among if not (profile == "dynamixel" and kind in _NOT_ON_SERIAL)]
    faults = [_fault(source, source.choice(kinds), profile) for _ in range(count)]
    return Schedule(seed, profile, tuple(sorted(faults, key=lambda fault: fault.begin_ns)))


def _fault(source: Random, kind: Kind, profile: str) -> Fault:
    drawn, horizon_ns = DRAWS[kind], HORIZON_NS[profile]
    is_late = source.random() < 0.7  # most of them while the motor moves
    begin_ns = round(source.uniform(0.45 * horizon_ns if is_late else 0.0, horizon_ns))
    duration_ns = round(_logarithmic(source, *drawn.duration_ns))
    size = float(f"{_logarithmic(source, *drawn.size):.4g}")
    where = source.choice(drawn.where)
    if drawn.signed and source.random() < 0.5:
        size = -size
    # A reference with flipped bits and a CRC that fits is one for every drive whose protocol has no check of its own.
    if kind is Kind.CORRUPT_PAYLOAD and not profile.startswith("native"):
        where = "to_host"
    return Fault(kind, begin_ns, duration_ns, size, where)


def _logarithmic(source: Random, low: float, high: float) -> float:
    return float(low * (high / low) ** source.random()) if low > 0.0 else float(high)
