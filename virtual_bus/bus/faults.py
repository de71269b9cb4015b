"""Faults by schedule: plain data in, validated; then asked frame by frame what becomes of it.

A fault file is a YAML list; times are seconds since the world began:

    - {fault: drop, function: SETPOINT, direction: to_drive, from_s: 2.0, to_s: 2.05}
    - {fault: delay, direction: to_host, probability: 0.01, delay_s: 2.0e-3}
    - {fault: bus_off, node: drive, from_s: 4.0, to_s: 4.1}
    - {fault: drop, id: 0x8001, extended: true, count: 1}

- drop: sent and acknowledged, but lost by the receiver. duplicate: received twice. delay: received `delay_s` later, and
  what follows in the same direction waits behind it. reorder: received after the next frame of its direction.
- corrupt_payload: `bits` of the payload arrive flipped with a CRC that fits, as behind a faulty gateway.
- corrupt_wire: a CRC error on the wire: error frame, error counters, retransmission.
- bus_off: a node is off the bus in the window, then recovers by 128 x 11 bits.
- bus_gone: the bus isn't there for anybody in the window.
"""

import math
import random
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Final

from firmware_protocol.frames import MAX_BASE_ID, MAX_EXTENDED_ID, NODE_BITS, Frame
from firmware_protocol.messages import Function
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.yaml_loader import load_document

FOREVER_NS: Final = 1 << 62
_NS_PER_S: Final = 1_000_000_000


class FaultKind(StrEnum):
    """What goes wrong."""

    DROP = "drop"
    DUPLICATE = "duplicate"
    DELAY = "delay"
    REORDER = "reorder"
    CORRUPT_PAYLOAD = "corrupt_payload"
    CORRUPT_WIRE = "corrupt_wire"
    BUS_OFF = "bus_off"
    BUS_GONE = "bus_gone"


class Side(StrEnum):
    """Who is on the bus: hosts, and the world's own nodes."""

    HOST = "host"
    DRIVE = "drive"


_STATES: Final = (FaultKind.BUS_OFF, FaultKind.BUS_GONE)


@dataclass(frozen=True, slots=True)
class Fault:
    """One line of the schedule; None matches everything."""

    kind: FaultKind
    from_ns: int = 0
    to_ns: int = FOREVER_NS
    function: int | None = None
    arbitration_id: int | None = None
    is_extended: bool = False  # whether that has 29 bits
    sender: Side | None = None  # of the frame; for bus_off the node concerned
    count: int | None = None  # at most so many frames
    probability: float = 1.0
    delay_ns: int = 0
    bits: int = 1


class _Reader:
    """Takes one mapping apart and collects what is wrong with it."""

    def __init__(self, entry: Mapping[str, object], where: str, problems: list[str]) -> None:
        self._entry = entry
        self._where = where
        self._problems = problems

    def problem(self, key: str, text: str) -> None:
        self._problems.append(f"{self._where}: {key}: {text}")

    def number(self, key: str, default: float, minimum: float, maximum: float) -> float:
        value = self._entry.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not minimum <= value <= maximum:
            self.problem(key, f"must be a number from {minimum:g} to {maximum:g}, not {value!r}")
            return default
        return float(value)

    def integer(self, key: str, minimum: int, maximum: int) -> int | None:
        value = self._entry.get(key)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int) or not minimum <= value <= maximum:
            self.problem(key, f"must be a whole number from {minimum} to {maximum}, not {value!r}")
            return None
        return value

    def flag(self, key: str) -> bool:
        value = self._entry.get(key, False)
        if not isinstance(value, bool):
            self.problem(key, f"must be true or false, not {value!r}")
            return False
        return value

    def choice(self, key: str, choices: Mapping[str, str]) -> str | None:
        value = self._entry.get(key)
        if value is None:
            return None
        if not isinstance(value, str) or value not in choices:
            self.problem(key, f"must be one of {', '.join(choices)}, not {value!r}")
            return None
        return choices[value]

    def function(self) -> int | None:
        value = self._entry.get("function")
        if isinstance(value, str):
            if value in Function.__members__:
                return int(Function[value])
            self.problem("function", f"must be one of {', '.join(Function.__members__)} or a number, not {value!r}")
            return None
        return self.integer("function", 0, (1 << 6) - 1)


_COMMON: Final = {"fault", "from_s", "to_s"}
_MATCH: Final = {"function", "id", "extended", "direction", "count", "probability"}
_KEYS: Final = {
    FaultKind.DELAY: _COMMON | _MATCH | {"delay_s"},
    FaultKind.CORRUPT_PAYLOAD: _COMMON | _MATCH | {"bits"},
    FaultKind.BUS_OFF: _COMMON | {"node"},
    FaultKind.BUS_GONE: _COMMON,
}
_DIRECTIONS: Final = {"to_drive": Side.HOST.value, "to_host": Side.DRIVE.value}
_NODES: Final = {side.value: side.value for side in Side}


def _parse_entry(entry: object, where: str, problems: list[str]) -> Fault | None:
    if not isinstance(entry, Mapping):
        problems.append(f"{where}: must be a mapping like {{fault: drop, from_s: 1.0}}")
        return None
    reader = _Reader(entry, where, problems)
    name = entry.get("fault")
    if not isinstance(name, str) or name not in set(FaultKind):
        reader.problem("fault", f"must be one of {', '.join(FaultKind)}, not {name!r}")
        return None
    kind = FaultKind(name)
    allowed = _KEYS.get(kind, _COMMON | _MATCH)
    for key in entry:
        if key not in allowed:
            reader.problem(str(key), f"unknown for {kind}; known are {', '.join(sorted(allowed))}")
    from_s = reader.number("from_s", 0.0, 0.0, 1e9)
    to_s = reader.number("to_s", math.inf, 0.0, math.inf)
    if to_s <= from_s:
        reader.problem("to_s", f"must be later than from_s ({from_s:g}), not {to_s:g}")
    delay_s = reader.number("delay_s", 0.0, 1e-9, 1e3) if kind is FaultKind.DELAY else 0.0
    bits = reader.integer("bits", 1, 512)
    is_extended = reader.flag("extended")
    if is_extended and "id" not in entry:
        reader.problem("extended", "goes with an id; give that")
    if kind is FaultKind.BUS_OFF and "node" not in entry:
        reader.problem("node", "is needed: host or drive")
    sender = reader.choice("node", _NODES) if kind is FaultKind.BUS_OFF else reader.choice("direction", _DIRECTIONS)
    return Fault(
        kind=kind,
        from_ns=round(from_s * _NS_PER_S),
        to_ns=FOREVER_NS if math.isinf(to_s) else round(to_s * _NS_PER_S),
        function=reader.function(),
        arbitration_id=reader.integer("id", 0, MAX_EXTENDED_ID if is_extended else MAX_BASE_ID),
        is_extended=is_extended,
        sender=None if sender is None else Side(sender),
        count=reader.integer("count", 1, 1 << 31),
        probability=reader.number("probability", 1.0, 0.0, 1.0),
        delay_ns=round(delay_s * _NS_PER_S),
        bits=1 if bits is None else bits,
    )


def parse_faults(entries: object, name: str = "<faults>") -> tuple[Fault, ...]:
    """Validate a schedule given as a list of mappings; UserError with every problem at once."""
    if entries is None:
        return ()
    if isinstance(entries, str | bytes | Mapping) or not isinstance(entries, Iterable):
        raise UserError(f"{name}: must be a list of faults")
    problems: list[str] = []
    parsed = [
        entry if isinstance(entry, Fault) else _parse_entry(entry, f"{name}: [{index}]", problems)
        for index, entry in enumerate(entries)
    ]
    if problems:
        raise UserError(problems)
    return tuple(fault for fault in parsed if fault is not None)


def load_faults(path: str | Path) -> tuple[Fault, ...]:
    """Read a fault file; UserError when it can't be read or isn't valid."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: can't be read: {error}") from None
    document = load_document(text, str(path))
    if document.problems:
        raise UserError([f"{path}:{mark.line}: {problem.text}" for mark, problem in document.problems])
    return parse_faults(document.data, str(path))


@dataclass(slots=True)
class _Armed:
    """A fault with what is left of its count and its own random numbers, so that faults don't disturb each other."""

    fault: Fault
    left: int
    random: random.Random

    def hits(self, frame: Frame, sender: Side, now_ns: int) -> bool:
        """Tell whether this frame is to suffer, and use up one of the count if so."""
        fault = self.fault
        if not (self.left and fault.from_ns <= now_ns < fault.to_ns) or fault.sender not in (None, sender):
            return False
        if fault.function is not None and (frame.is_extended or frame.arbitration_id >> NODE_BITS != fault.function):
            return False
        if fault.arbitration_id is not None and (
            frame.arbitration_id != fault.arbitration_id or frame.is_extended != fault.is_extended
        ):
            return False
        if fault.probability < 1.0 and self.random.random() >= fault.probability:
            return False
        self.left -= 1
        return True


class StateChange:
    """What happens to the bus or a node at one time: the edges of bus_off and bus_gone windows."""

    __slots__ = ("begins", "kind", "node", "time_ns")

    def __init__(self, time_ns: int, kind: FaultKind, node: Side | None, begins: bool) -> None:
        self.time_ns = time_ns
        self.kind = kind
        self.node = node
        self.begins = begins


class FaultInjector:
    """Decides for every frame what a schedule does to it; the same seed and the same frames give the same faults."""

    def __init__(self, faults: Sequence[Fault], seed: int) -> None:
        armed = [
            _Armed(fault, -1 if fault.count is None else fault.count, random.Random(f"fault {seed} {index}"))
            for index, fault in enumerate(faults)
        ]
        self._wire = [a for a in armed if a.fault.kind is FaultKind.CORRUPT_WIRE]
        self._delivery = [a for a in armed if a.fault.kind not in (*_STATES, FaultKind.CORRUPT_WIRE)]
        self._waits_until_ns = dict.fromkeys(Side, 0)
        self._overtaken: dict[Side, list[Frame]] = {side: [] for side in Side}
        self.counters: dict[str, int] = dict.fromkeys(FaultKind, 0)
        changes = [
            StateChange(time_ns, fault.kind, fault.sender, begins)
            for fault in faults
            if fault.kind in _STATES
            for time_ns, begins in ((fault.from_ns, True), (fault.to_ns, False))
            if time_ns < FOREVER_NS
        ]
        self.state_changes = tuple(sorted(changes, key=lambda change: change.time_ns))

    def corrupts_wire(self, frame: Frame, sender: Side, now_ns: int) -> bool:
        """Tell whether this transmission fails its CRC."""
        for armed in self._wire:
            if armed.hits(frame, sender, now_ns):
                self.counters[FaultKind.CORRUPT_WIRE] += 1
                return True
        return False

    def route(self, frame: Frame, sender: Side, now_ns: int) -> list[tuple[int, Frame]]:
        """Return what receivers get instead of this frame and when, in order; empty when it is lost or held back."""
        due_ns = max(now_ns, self._waits_until_ns[sender])
        copies = 1
        for armed in self._delivery:
            if not armed.hits(frame, sender, now_ns):
                continue
            kind = armed.fault.kind
            self.counters[kind] += 1
            if kind is FaultKind.DROP:
                return []
            if kind is FaultKind.DUPLICATE:
                copies += 1
            elif kind is FaultKind.DELAY:
                due_ns += armed.fault.delay_ns
            elif kind is FaultKind.REORDER:
                self._overtaken[sender].extend([frame] * copies)
                return []
            else:
                frame = _flip_bits(frame, armed.fault.bits, armed.random)
        self._waits_until_ns[sender] = due_ns
        late, self._overtaken[sender] = self._overtaken[sender], []
        return [(due_ns, each) for each in [frame] * copies + late]


def _flip_bits(frame: Frame, bits: int, source: random.Random) -> Frame:
    size = 8 * len(frame.data)
    mask = sum(1 << position for position in source.sample(range(size), min(bits, size)))
    flipped = int.from_bytes(frame.data, "little") ^ mask
    return frame._replace(data=flipped.to_bytes(len(frame.data), "little"))
