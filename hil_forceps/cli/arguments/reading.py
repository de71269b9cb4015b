"""Runs read from the sources of the command line, with a progress bar, and the table of their audit."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import MappingProxyType

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.progress import Progress, TaskID
from rich.table import Table

from hil_forceps.audit.finding import Finding, Severity
from hil_forceps.cli.terminal.notes import note_console
from hil_forceps.cli.terminal.tables import FILE_COLUMNS, print_table
from hil_forceps.data.readers.format import Choice
from hil_forceps.data.readers.read_run import read_run
from hil_forceps.data.readers.tables.columns import OnColumns
from hil_forceps.data.readers.tables.mapping import ColumnMap
from hil_forceps.data.run import Run
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError

_STYLES: dict[Severity, str] = {"problem": "bold red", "warning": "yellow", "note": "dim"}


def read_sources(
    sources: Sequence[Path],
    progress: Progress,
    rig: Rig | None = None,
    choice: Choice = Choice(),  # noqa: B008 - a constant
    mapping: ColumnMap = MappingProxyType({}),
    on_columns: OnColumns | None = None,
) -> list[tuple[Path, Run]]:
    """Return every run with its source; UserError with the problems of all sources."""
    missing = [source for source in sources if not source.exists()]
    if missing or not sources:
        told = [f"{source}: no such file or folder; check the path" for source in missing]
        raise UserError(told or "SOURCE: missing; name files or folders (docs/real-data.md lists public data)")
    found: list[tuple[Path, Run]] = []
    problems: list[str] = []
    for source in sources:
        task = progress.add_task(f"reading {source.name}", total=None)
        try:
            runs = read_run(source, _teller(progress, task), rig, choice, mapping, on_columns)
            found += [(source, run) for run in runs]
        except UserError as error:
            problems += error.problems
        progress.remove_task(task)
    if problems:
        raise UserError(problems)
    return found


def _teller(progress: Progress, task: TaskID) -> Callable[[int, int], None]:
    return lambda done, total: progress.update(task, completed=done, total=total)


def bar() -> Progress:
    """Return a progress bar on standard error; silent if it isn't a terminal."""
    console = note_console()
    return Progress(console=console, disable=not console.is_terminal, transient=True)


def show_audit(findings: Sequence[Finding]) -> None:
    """Print the findings, one row for all runs with the same kind, channel and severity."""
    groups: dict[tuple[Severity, str, str], list[Finding]] = {}
    for finding in findings:
        text = finding.text if finding.kind == "reader" else ""
        groups.setdefault((finding.severity, f"{finding.kind}{text}", finding.channel), []).append(finding)
    if not groups:
        sys.stdout.write("audit: no findings\n")
        return
    table = Table(title="Audit of the data", title_justify="left", box=SIMPLE_HEAD)
    for header in ("", "kind", "runs", "finding"):
        table.add_column(header)
    for (severity, _, _), group in groups.items():
        names = [finding.run for finding in group if finding.run]
        runs = "all" if not names else names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"
        table.add_row(f"[{_STYLES[severity]}]{severity}[/]", group[0].kind, escape(runs), escape(group[0].text))
    print_table(table, FILE_COLUMNS)
