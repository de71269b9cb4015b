"""`hil-forceps trend`: the known parameters over many sessions, and their changes."""

import json
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.box import SIMPLE_HEAD
from rich.table import Table

from hil_forceps.api.batch.executor import PROCESSES
from hil_forceps.api.trend import FALSE_ALARM_RATE, TrendResult
from hil_forceps.api.trend import trend as follow
from hil_forceps.cli.arguments.files import make_folder
from hil_forceps.cli.arguments.options import spoken_as_options
from hil_forceps.cli.terminal.notes import note, note_console
from hil_forceps.cli.terminal.progress import progress_on
from hil_forceps.cli.terminal.tables import FILE_COLUMNS, print_table
from hil_forceps.drift.result import ParameterTrend
from hil_forceps.report.trend.files import write_figures, write_report

_OPTIONS = {name: name for name in ("false_alarms", "seed", "jobs", "executor", "out")}
MAX_TOLD_SESSIONS = 20  # unused sessions on the terminal; trend.html has all


def trend(
    folder: Path,
    /,
    *,
    out: Path,
    rig: Path | None = None,
    jobs: int | None = None,
    executor: str = PROCESSES,
    false_alarms: float = FALSE_ALARM_RATE,
    file_dates: Annotated[bool, Parameter(negative="")] = False,
    seed: int = 0,
    figures: Annotated[bool, Parameter(negative="")] = False,
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
    map_: Annotated[tuple[str, ...], Parameter(name="--map")] = (),
) -> int:
    """Estimate the known parameters of a rig in each session of a folder; report which of them change, and since when.

    A session is a log in FOLDER or below it, or the folder of a run. Writes OUT/estimates.parquet (a row for each
    session and parameter), OUT/trend.json and OUT/trend.html (opens offline). After an interruption the same command
    continues; logs that have changed are fitted again. For a log that can't be used the tables give the reason.

    Parameters
    ----------
    folder
        Folder of the logs, with a folder for each instrument if there are several. A rig.yaml in a folder is the rig
        of all logs below it. A sessions.csv sets instrument, date and rig (docs/trend.md).
    out
        Folder for the results.
    rig
        Rig file for sessions without a rig.yaml above them.
    jobs
        Number of processes; default: all processors.
    executor
        processes, dask://HOST:PORT, ray or ray://HOST:PORT; the results are the same.
    false_alarms
        False-alarm rate of an instrument, over all its sessions and parameters.
    file_dates
        Use the modification time of the file as date of a session without another date.
    seed
        Seed of the bootstrap; the same seed gives the same numbers.
    figures
        Also write the figures as files.
    json_
        Print trend.json instead of the table.
    map_
        Column of a table for a quantity of a run, with its unit, such as theta_m_rad=pos:deg; or a YAML file of such
        lines.
    """
    make_folder(out)
    with progress_on(note_console()) as tell, spoken_as_options(_OPTIONS):
        result = follow(
            folder,
            rig,
            out=out,
            false_alarms=false_alarms,
            file_dates=file_dates,
            seed=seed,
            jobs=jobs,
            executor=executor,
            columns=map_,
            progress=tell,
        )
        tell("drawing")
        write_report(result.trend, out / "trend.html")
        if figures:
            make_folder(out / "figures", inside=out)
            write_figures(result.trend, out / "figures")
    if json_:
        sys.stdout.write(json.dumps(result.to_json(), indent=1, allow_nan=False) + "\n")
    else:
        _print(result, out)
    return 0


def _print(result: TrendResult, out: Path) -> None:
    for instrument in result.instruments:
        table = Table(title=instrument.name, title_justify="left", box=SIMPLE_HEAD)
        for name in ("parameter", "sessions", "first", "last", "unit", "p", "verdict", "since"):
            table.add_column(name, justify="right" if name in {"sessions", "first", "last", "p"} else "left")
        for each in instrument.parameters:
            table.add_row(*_cells(each))
        print_table(table, FILE_COLUMNS)
    sys.stdout.write("".join(f"{text}\n" for text in result.changes) or "no change was found beyond the scatter\n")
    unused = [line for line in result.sessions if line.reason is not None]
    for line in unused[:MAX_TOLD_SESSIONS]:
        sys.stdout.write(f"  not used: {line.name}: {line.reason}\n")
    if len(unused) > MAX_TOLD_SESSIONS:
        sys.stdout.write(f"  and {len(unused) - MAX_TOLD_SESSIONS} more, in trend.html\n")
    by_file = sum(line.date_from == "file" for line in result.sessions)
    if by_file:
        note(f"{by_file} sessions have the modification time of their file as date; copying a file can change it")
    used = len(result.sessions) - len(unused)
    sys.stdout.write(f"  {used} of {len(result.sessions)} sessions used; trend.html and the estimates are in {out}/\n")


def _cells(p: ParameterTrend) -> list[str]:
    since = ", ".join(f"{change.onset.session} ({change.onset.date[:10]})" for change in p.changes)
    return [
        p.name,
        str(len(p.sessions)),
        f"{p.level[0]:.4g}",
        f"{p.level[-1]:.4g}",
        p.unit,
        f"{p.p_value:.2g}",
        p.verdict,
        since,
    ]
