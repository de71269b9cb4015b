"""`fault.json`: the data of an axis whose run ended with a fault."""

import math
from pathlib import Path
from typing import Any, NamedTuple

from hil_forceps.bridge.axis import Axis
from hil_forceps.bridge.fault import CRASHED, FaultReason
from hil_forceps.bridge.logs.flight_recorder import Recent, Stages, last_second
from hil_forceps.bridge.results import Stage
from hil_forceps.bridge.service import Service
from hil_forceps.data.recording.format import FAULT_NAME
from hil_forceps.rig import Rig


class KeptFault(NamedTuple):
    """Reason of a fault, and the file with the last second before it."""

    reason: FaultReason
    began_ns: int  # start of the run, host's clock
    ended_ns: int  # end of the run, when torque was no longer requested
    drive_state: str  # last state that the drive reported
    path: Path
    problem: str  # why the file was not written; empty if it was


def fault_path(recording: Path) -> Path:
    """Return the path of `fault.json` for a recording."""
    return recording.with_name(FAULT_NAME if recording.stem == "run" else f"{recording.stem}.{FAULT_NAME}")


def fault_content(axis: Axis, rig: Rig, service: Service, recent: Recent, crash: str) -> bytes | None:
    """Return the file's content; None after a run that ended normally.

    `crash`: the error of this program, if there was one.
    """
    if crash and axis.fault is None:
        stage = axis.course.stage.value
        axis.fault = FaultReason(CRASHED, "this program", math.nan, math.nan, "", axis.now_ns, stage, crash)
    if axis.fault is None:
        return None
    drive, course = axis.drive, axis.course
    more: dict[str, Any] = {
        "axis": axis.name,
        "zero_ns": axis.pipeline.zero_ns,
        "drive": {
            "profile": rig.drive_profile,
            "state": _state_of(axis),
            "phase": drive.phase.name,
            "fault": drive.fault_words(),
            "disabled": course.drive_disabled,
        },
        "period_s": rig.bench.host_period_s,
        "limits": rig.limits.model_dump(),
        "counters": {
            "service": {**service.counters, "references_sent": axis.references_sent},
            "pipeline": dict(axis.pipeline.counters),
            "host": dict(drive.counters),
        },
    }
    said = axis.fault._replace(message=course.message or axis.fault.message)
    return last_second(said, axis.stages, recent, more)


def write_fault(axis: Axis, recording: Path, content: bytes | None) -> KeptFault | None:
    """Write the content to the folder of the recording; None if there is no content."""
    if content is None or axis.fault is None:
        return None
    path, problem = fault_path(recording), ""
    try:
        path.write_bytes(content)
    except OSError as error:
        problem = error.strerror or str(error)
    ended_ns = ended_of(axis.stages, axis.fault.time_ns)
    return KeptFault(axis.fault, axis.stages[0][0], ended_ns, _state_of(axis), path, problem)


def ended_of(stages: Stages, otherwise_ns: int) -> int:
    """Return when a run began to end; the failure may be earlier, for example a check of the gate."""
    ends = (time_ns for time_ns, stage in stages if stage in {Stage.STOPPING.value, Stage.ENDED.value})
    return min(ends, default=otherwise_ns)


def _state_of(axis: Axis) -> str:
    state = axis.drive.drive_state
    return "unknown" if state is None else state.name
