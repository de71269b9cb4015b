"""Data for the explanation of a run: its recording, damaged or not, and the last second before a fault."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from json import JSONDecodeError
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil_forceps.bench.assembly import settings_of
from hil_forceps.bench.fault_file import ended_of, fault_path
from hil_forceps.bridge.logs.flight_recorder import FAULT_FORMAT
from hil_forceps.bridge.pipeline import VERDICT_NAMES
from hil_forceps.bridge.results import AS_MEANT
from hil_forceps.control.gate.trip import WORDS as GATE_CHECKS
from hil_forceps.data.recording.format import REFERENCE, SAMPLE, Topic
from hil_forceps.data.recording.reader import Recording, Table, read_recording
from hil_forceps.data.strict_json import parse_json
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError

MAX_TIME_NS = 1 << 62
MAX_KEY_CHARACTERS = 40  # that a message shows
Stages = tuple[tuple[int, str], ...]


@dataclass(frozen=True, slots=True)
class Evidence:
    """Tables as in a recording. Strings are empty and `rig` is None if the source does not contain them."""

    name: str
    samples: Table
    references: Table
    reason: str  # the value of a `StopReason`, or "crashed"; empty if the end isn't recorded
    message: str
    began_ns: int  # host's clock
    ended_ns: int  # when the run began to end, or the last message
    stages: Stages  # start of each; may be empty
    zero_ns: int | None  # drive's clock
    profile: str  # of the drive
    rig: Rig | None
    fault: Mapping[str, Any] | None  # of `fault.json`
    verdicts: Mapping[int, str]
    lateness: NDArray[np.int64]  # rows of a tick's time and its lateness; none without `fault`
    notes: tuple[str, ...]
    is_damaged: bool = False  # the file has its end, so that what is missing was lost later

    @property
    def gate_trip_ns(self) -> int | None:
        """Time at which the check of the gate failed that ended the run; None if none did, or it is not known."""
        fault = self.fault or {}
        return int(fault["time_ns"]) if fault.get("check") in GATE_CHECKS else None

    @property
    def is_second(self) -> bool:
        """Whether only the last second is available."""
        return self.rig is None and self.fault is not None

    def time_s(self, time_ns: int) -> float:
        """Return a time of the host's clock in s since the start."""
        return (time_ns - self.began_ns) / 1e9


def read_evidence(path: Path) -> Evidence:
    """Read a recording, or a `fault.json`; UserError if it is neither."""
    if path.suffix == ".json":
        return _of_fault(path.name, _fault_of(path.read_bytes(), str(path)), ())
    beside = fault_path(path)
    try:
        recording = read_recording(path)
    except UserError as error:
        if not beside.is_file():
            raise
        return _of_fault(beside.name, _fault_of(beside.read_bytes(), str(beside)), (str(error),))
    return _of_recording(recording, path, beside)


def _of_recording(recording: Recording, path: Path, beside: Path) -> Evidence:
    notes = list(recording.notes)
    content = recording.fault or (beside.read_bytes() if beside.is_file() else None)
    fault: dict[str, Any] | None = None
    if content is not None:
        try:
            fault = _fault_of(content, str(beside))
        except UserError as error:
            notes.append(str(error))
    rig: Rig | None = None
    try:
        rig = settings_of(recording)[0]
    except UserError as error:
        notes.append(str(error))
    result = recording.result or ({} if fault is None else fault)
    stages = _stages(recording.result) if fault is None else tuple(map(tuple, fault["stages"]))
    times = [*recording.samples["received_ns"].tolist(), *recording.references["tick_ns"].tolist()]
    began_ns, ended_ns = (min(times), max(times)) if times else (0, 0)
    if stages:
        began_ns, ended_ns = stages[0][0], ended_of(stages, ended_ns if fault is None else fault["time_ns"])
    elif fault is not None:
        ended_ns = int(fault["time_ns"])
    elif len(recording.references) and result.get("reason") not in {None, *(reason.value for reason in AS_MEANT)}:
        ended_ns = int(recording.references["tick_ns"][-1])  # references stop when the run begins to end
    return Evidence(
        name=path.name,
        samples=recording.samples,
        references=recording.references,
        reason=str(result.get("reason", "")),
        message=str(result.get("message", "")),
        began_ns=began_ns,
        ended_ns=ended_ns,
        stages=stages,
        zero_ns=recording.zero_ns,
        profile="native" if rig is None else rig.drive_profile,
        rig=rig,
        fault=fault,
        verdicts=_verdicts(recording),
        lateness=_lateness(fault),
        notes=tuple(notes),
        is_damaged=recording.is_finished and bool(recording.gaps),
    )


def _of_fault(name: str, fault: dict[str, Any], notes: tuple[str, ...]) -> Evidence:
    samples, references = _table(fault["samples"], SAMPLE), _table(fault["references"], REFERENCE)
    stages = tuple(map(tuple, fault["stages"]))
    return Evidence(
        name=name,
        samples=samples,
        references=references,
        reason=str(fault["reason"]),
        message=str(fault["message"]),
        began_ns=stages[0][0] if stages else int(fault["time_ns"]),
        ended_ns=ended_of(stages, int(fault["time_ns"])),
        stages=stages,
        zero_ns=fault.get("zero_ns"),
        profile=str(fault["drive"]["profile"]),
        rig=None,
        fault=fault,
        verdicts={int(code): str(words) for code, words in fault.get("verdicts", VERDICT_NAMES).items()},
        lateness=_lateness(fault),
        notes=(*notes, "only the last second is available"),
    )


def _fault_of(content: bytes, name: str) -> dict[str, Any]:
    """Return the content of `fault.json`; UserError if it is not valid."""
    try:
        fault: dict[str, Any] = parse_json(content.decode())
        if fault["format"] != FAULT_FORMAT:
            raise UserError(f"{name}: has the format {fault['format']!r}; use the version of hil-forceps that wrote it")
        _check(fault)
        _table(fault["samples"], SAMPLE)
        _table(fault["references"], REFERENCE)
        _lateness(fault)
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError) as error:
        told = "a value has the wrong type"
        if isinstance(error, KeyError):
            told = f"{str(error.args[0])[:MAX_KEY_CHARACTERS]!r} is missing"
        elif isinstance(error, UnicodeDecodeError | JSONDecodeError):
            told = "it is not JSON in UTF-8"
        raise UserError(f"{name}: is not a valid fault.json: {told}; use run.mcap instead") from error
    return fault


def _check(fault: dict[str, Any]) -> None:
    """TypeError or LookupError for content of the wrong type."""
    drive = fault["drive"]
    texts = [*(fault[key] for key in ("reason", "check", "message", "stage", "unit")), drive["profile"], drive["fault"]]
    texts += [*fault["verdicts"].values(), *(stage for _, stage in fault["stages"])]
    if not all(isinstance(text, str) for text in texts):
        raise TypeError("a text that is none")
    times = [fault["time_ns"], *(time_ns for time_ns, _ in fault["stages"])]
    times += [] if fault["zero_ns"] is None else [fault["zero_ns"]]
    if not all(type(time_ns) is int and abs(time_ns) <= MAX_TIME_NS for time_ns in times):
        raise TypeError("a time that is none")
    for number in (fault["value"], fault["limit"]):
        if number is not None and type(number) not in {int, float}:
            raise TypeError("a value that is no number")
    for code in fault["verdicts"]:
        int(code)


def _table(content: Mapping[str, Any], topic: Topic) -> Table:
    """Return columns and rows as in a recording; missing columns are NaN, or 0 for integers."""
    rows = content["rows"]
    table = np.zeros(len(rows), dtype=topic.dtype)
    for name in topic.dtype.names or ():
        is_float = topic.dtype[name].kind == "f"
        if name not in content["columns"]:
            table[name] = math.nan if is_float else 0
            continue
        place = content["columns"].index(name)
        table[name] = [math.nan if row[place] is None and is_float else row[place] for row in rows]
    return table


def _lateness(fault: Mapping[str, Any] | None) -> NDArray[np.int64]:
    rows = [] if fault is None else fault["lateness"]["rows"]
    return np.array(rows, dtype=np.int64).reshape(-1, 2)


def _stages(result: Mapping[str, str]) -> Stages:
    """Return the start of each stage; empty for recordings of older versions and for damaged content."""
    try:
        found = tuple((time_ns, stage) for time_ns, stage in parse_json(result["stages"]))
    except (LookupError, TypeError, ValueError):
        return ()
    is_sound = all(
        type(time_ns) is int and abs(time_ns) <= MAX_TIME_NS and type(stage) is str for time_ns, stage in found
    )
    return found if is_sound else ()


def _verdicts(recording: Recording) -> dict[int, str]:
    """Return the names of verdicts from the recording; the current names if it has none."""
    try:
        said = json.loads(recording.metadata["verdicts"])
        return {int(code): str(words) for code, words in said.items()}
    except (LookupError, TypeError, ValueError, AttributeError):
        return dict(VERDICT_NAMES)
