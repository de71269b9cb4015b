"""`track` and `trend`: the known parameters of one session, and of many sessions over time."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from hil_forceps.api.batch.executor import PROCESSES, check_executor
from hil_forceps.api.batch.files import write_json
from hil_forceps.api.batch.store import SESSIONS
from hil_forceps.api.runs import RigSource, Source, as_rig, read_runs
from hil_forceps.api.trend_rows import consolidated, estimated, session_lines
from hil_forceps.data.pandas_frame import to_pandas
from hil_forceps.data.readers.tables.mapping import read_map
from hil_forceps.data.sessions.folder import sessions_of
from hil_forceps.data.sessions.session import Session
from hil_forceps.drift.likelihood import Measured
from hil_forceps.drift.result import InstrumentTrend, SessionLine, Trend, to_json
from hil_forceps.drift.session_fit import SessionFit, fit_session
from hil_forceps.rig import Rig, load_rig
from hil_forceps.rig.errors import UserError

ESTIMATES = "estimates.parquet"
RESULT = "trend.json"
FALSE_ALARM_RATE = 0.05


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class TrendResult:
    """Parameters of instruments over their sessions; printed as on the command line."""

    trend: Trend  # everything, as plain data
    rows: tuple[dict[str, Any], ...]  # of estimates.parquet: one for each session and parameter

    @property
    def instruments(self) -> tuple[InstrumentTrend, ...]:
        """Each instrument with its parameters: values with intervals, scatter, changes."""
        return self.trend.instruments

    @property
    def sessions(self) -> tuple[SessionLine, ...]:
        """Each session: its date, the source of the date, and the reason if it could not be used."""
        return self.trend.sessions

    @property
    def changes(self) -> tuple[str, ...]:
        """The changes that were found, one sentence each."""
        several = len(self.instruments) > 1
        return tuple(
            f"{instrument.name}: {text}" if several else text
            for instrument in self.instruments
            for parameter in instrument.parameters
            for text in parameter.sentences()
        )

    def to_json(self) -> dict[str, Any]:
        """Return the content of trend.json."""
        return to_json(self.trend)

    def to_pandas(self) -> Any:
        """Return the estimates as a pandas DataFrame; UserError if pandas is not installed."""
        names = self.rows[0] if self.rows else ()
        columns = {name: np.array([row[name] for row in self.rows], dtype=object) for name in names}
        return to_pandas(columns).infer_objects()

    def report(self, path: str | PathLike[str]) -> None:
        """Write the report, one HTML page that opens offline; OSError if writing fails."""
        from hil_forceps.report.trend.files import write_report  # noqa: PLC0415 - matplotlib takes a while to load

        write_report(self.trend, Path(path))

    def __str__(self) -> str:
        said = "\n".join(self.changes) or "no change was found beyond the scatter between sessions"
        used = sum(line.reason is None for line in self.sessions)
        return f"{said}\n({used} of {len(self.sessions)} sessions used)"

    def __repr__(self) -> str:
        return f"<TrendResult: {len(self.sessions)} sessions, {len(self.changes)} changes>"


def track(runs: Source | Sequence[Source], rig: RigSource) -> SessionFit:
    """Fit the known parameters of a rig to the runs of one session, without the catalogue of effects.

    `runs`: one or several sources of `read_runs`. The rig has starting values only: estimates and their deviations
    follow from the likelihood of these runs. UserError for runs that can't be used or have no information.
    """
    known = as_rig(rig)
    sources = runs if isinstance(runs, list | tuple) else [runs]
    return fit_session(read_runs(*sources, rig=known), known)


def trend(
    folder: str | PathLike[str],
    rig: RigSource | None = None,
    *,
    out: str | PathLike[str],
    false_alarms: float = FALSE_ALARM_RATE,
    file_dates: bool = False,
    seed: int = 0,
    jobs: int | None = None,
    executor: str = PROCESSES,
    columns: Sequence[str] = (),
    progress: Callable[[str], None] | None = None,
) -> TrendResult:
    """Estimate the parameters of instruments in each session of a folder; find changes and their onsets.

    `rig`: for sessions without a rig.yaml above them. `out`: folder for the results; stored results of the same logs
    are reused. `false_alarms`: false-alarm rate of an instrument. `file_dates`: use the modification time of a file as
    date of a session without another. `seed`: of the bootstrap. `jobs`: processes. `executor`: `processes`,
    `dask://HOST:PORT`, `ray`, `ray://HOST:PORT`; the results are the same. `columns`: as of `read_runs`. UserError for
    invalid arguments; for an unusable log the list of sessions has the reason.
    """
    say = progress or (lambda _: None)
    _check(false_alarms, seed, jobs, executor)
    home, results = Path(folder), Path(out)
    if home.resolve().is_relative_to((results / SESSIONS).resolve()):
        raise UserError(f"out {results}: is within the folder of the logs, {home}; name a folder outside it")
    one = Path(str(rig)) if isinstance(rig, str | PathLike) else None
    given = as_rig(rig) if rig is not None else None
    sessions = sessions_of(home, one or (Path("rig") if given is not None else None), results)
    rigs = _rigs(sessions, one or Path("rig"), given)
    from hil_forceps.api.batch.sessions import fit_sessions  # noqa: PLC0415 - what fits takes seconds to load

    rows = fit_sessions(sessions, rigs, results, read_map(columns), executor, jobs, say)
    lines, dates = session_lines(sessions, rows, file_dates=file_dates)
    table = consolidated(rows, lines, dates, results / ESTIMATES)
    instruments = _instruments(sessions, rows, dates, false_alarms, seed, jobs, say)
    found = TrendResult(Trend(tuple(instruments), tuple(lines), false_alarms), tuple(table))
    write_json(results / RESULT, found.to_json())
    return found


def _instruments(
    sessions: Sequence[Session],
    rows: Sequence[dict[str, Any]],
    dates: dict[str, datetime],
    false_alarms: float,
    seed: int,
    jobs: int | None,
    say: Callable[[str], None],
) -> Iterator[InstrumentTrend]:
    from hil_forceps.drift.family import instrument_trend  # noqa: PLC0415 - as above

    for name in sorted({session.instrument for session in sessions}):
        say(f"looking for changes: {name}")
        parameters = estimated([row for row in rows if row["instrument"] == name], dates)
        yield instrument_trend(name, parameters, false_alarms, seed, lambda work, tasks: _in_order(work, tasks, jobs))


def _in_order(work: Callable[[Any], Any], tasks: Any, jobs: int | None) -> list[Any]:
    """Distribute tasks over processes if they are long enough, and return their results in order."""
    from hil_forceps.api.batch.ordered import over_processes  # noqa: PLC0415 - as above

    return over_processes(work, list(tasks), jobs)


def _rigs(sessions: Sequence[Session], one: Path, given: Rig | None) -> dict[Path, Rig]:
    """Read each rig of the sessions once; UserError with a line for each problem."""
    found: dict[Path, Rig] = {} if given is None else {one: given}
    problems: list[str] = []
    for path in sorted({session.rig for session in sessions} - found.keys()):
        try:
            found[path] = load_rig(str(path))
        except UserError as error:
            problems += error.problems
    for path, rig in found.items():
        try:
            rig.plant()
        except UserError as error:
            problems += [f"{path}: {problem}" for problem in error.problems]
    if problems:
        raise UserError(problems)
    return found


def _check(false_alarms: float, seed: int, jobs: int | None, executor: str) -> None:
    if not (math.isfinite(false_alarms) and 0.0 < false_alarms < 1.0):
        raise UserError(f"false_alarms {false_alarms}: must be above 0 and below 1, such as 0.05")
    if seed < 0:
        raise UserError(f"seed {seed}: must be 0 or more")
    if jobs is not None and jobs < 1:
        raise UserError(f"jobs {jobs}: must be 1 or more")
    check_executor(executor)


__all__ = ["Measured", "SessionFit", "TrendResult", "track", "trend"]
