"""Fit of all sessions: stored results are read, the other sessions are distributed over workers."""

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from hil_forceps.api.batch.executor import spread
from hil_forceps.api.batch.store import Rows, clear_others, keep, kept, key_of, rows_of, schema
from hil_forceps.api.batch.work import Task, fit_task
from hil_forceps.data.readers.tables.mapping import ColumnMap
from hil_forceps.data.sessions.session import Session
from hil_forceps.rig import Rig

TOLD_EVERY_S = 3.0


def fit_sessions(
    sessions: Sequence[Session],
    rigs: Mapping[Path, Rig],
    out: Path,
    mapping: ColumnMap,
    executor: str,
    jobs: int | None,
    say: Callable[[str], None],
) -> Rows:
    """Return the rows of all sessions, in their order. UserError if a cluster can't be reached."""
    keys = {path: key_of(rig, mapping) for path, rig in rigs.items()}
    clear_others(out, sessions)
    found: dict[str, Rows] = {}
    tasks = []
    for session in sessions:
        task = Task(session, rigs[session.rig], dict(mapping), keys[session.rig])
        there = kept(out, task)
        if there is None:
            tasks.append(task)
        else:
            found[session.name] = there
    already = len(found)
    say(_line(already, len(sessions), 0, 0.0, already))
    began_s, broken = time.monotonic(), 0
    told_s = began_s
    for outcome in spread(fit_task, tasks, executor, jobs):
        keep(outcome, out)
        found[outcome.session.name] = [_whole(row) for row in rows_of(outcome)]
        broken += outcome.fit is None
        now_s = time.monotonic()
        if now_s - told_s > TOLD_EVERY_S or len(found) == len(sessions):
            told_s = now_s
            say(_line(len(found), len(sessions), broken, now_s - began_s, already))
    return [row for session in sessions for row in found[session.name]]


def _whole(row: dict[str, Any]) -> dict[str, Any]:
    return {name: row.get(name) for name in schema().names}


def _line(done: int, of: int, broken: int, passed_s: float, already: int) -> str:
    told = f"{done} of {of} sessions"
    if already and not passed_s:
        return f"{told} are done already"
    told += f", {broken} could not be used" if broken else ""
    if done > already and done < of:
        told += f", some {passed_s / (done - already) * (of - done):.0f} s more"
    return told
