"""What is kept apart when a run ends in a fault: the second before it and what came until the end, all of it.

While a run goes well the tick does nothing for it but note its lateness: the recorder keeps the chunks that it handed
over last, the bus log's thread the lines that it wrote last, bounded by time and by number. At the end they are cut to
the window and written as JSON, `fault.json`: beside the recording, and in it as an attachment.
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hil_forceps.bridge.fault import FaultReason
from hil_forceps.bridge.pipeline import VERDICT_NAMES
from hil_forceps.data.recording.reader import Table, tables_of
from hil_forceps.data.recording.writer import Outcome

FAULT_FORMAT = 1
RECORDED_BEFORE_FAULT_NS = 1_000_000_000

Stages = Sequence[tuple[int, str]]  # when each stage began


class Recent(NamedTuple):
    """What was kept at hand while the run lasted."""

    messages: Iterable[bytes]  # of the recorder, chunk by chunk
    lines: Iterable[str]  # of the bus log, as candump has them
    log_begin_ns: int  # what their times count from
    lateness: Iterable[tuple[int, int]]  # time of a tick, and how much later than due it began


def last_second(reason: FaultReason, stages: Stages, recent: Recent, more: Mapping[str, Any]) -> bytes:
    """Return the content of `fault.json`; `more`: further keys.

    Times are in ns of the host's clock but for `stamp_ns`, of the drive's, and those of frames: s since
    `log_begin_ns`. What isn't finite is null.
    """
    tables = tables_of(recent.messages, first_counts=False)
    begin_ns = reason.time_ns - RECORDED_BEFORE_FAULT_NS
    content: dict[str, Any] = {
        "format": FAULT_FORMAT,
        **reason._asdict(),
        **more,
        "stages": stages,
        "verdicts": VERDICT_NAMES,
        "outcomes": {int(outcome): outcome.name for outcome in Outcome},
        "samples": _table(tables.samples, "received_ns", begin_ns),
        "references": _table(tables.references, "tick_ns", begin_ns),
        "bench": _table(tables.bench, "received_ns", begin_ns),
        "log_begin_ns": recent.log_begin_ns,
        "frames": [line for line in recent.lines if _time_s(line) >= (begin_ns - recent.log_begin_ns) / 1e9],
        "lateness": {
            "columns": ["tick_ns", "late_ns"],
            "rows": [[tick_ns, late_ns] for tick_ns, late_ns in recent.lateness if tick_ns >= begin_ns],
        },
    }
    lines = (f"{json.dumps(key)}: {json.dumps(_finite(value), allow_nan=False)}" for key, value in content.items())
    return ("{\n" + ",\n".join(lines) + "\n}\n").encode()


def _time_s(line: str) -> float:
    return float(line[1 : line.index(")")])


def _table(table: Table, time: str, begin_ns: int) -> dict[str, Any]:
    rows = table[table[time] >= begin_ns]
    return {"columns": list(table.dtype.names or ()), "rows": np.asarray(rows).tolist()}


def _finite(value: Any) -> Any:
    """Return the same with None for numbers that JSON doesn't have."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return value
