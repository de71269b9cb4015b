"""`hil-forceps diagnose --batch`: a diagnosis of each log and each folder in a folder, and a table of verdicts."""

import json
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.table import Table

from hil_forceps.api.batch.diagnoses import DiagnosisTask, Line, diagnose_task, done, sets_of, tasks_of
from hil_forceps.api.batch.executor import check_executor, spread
from hil_forceps.api.diagnosis import Wishes
from hil_forceps.cli.arguments.files import make_folder
from hil_forceps.cli.terminal.notes import note_console
from hil_forceps.cli.terminal.progress import progress_on
from hil_forceps.cli.terminal.tables import FILE_COLUMNS, print_table
from hil_forceps.rig import load_rig
from hil_forceps.rig.errors import UserError

TABLE = "verdicts.json"


def diagnose_batch(
    folders: Sequence[Path],
    rig: Path | None,
    out: Path,
    wishes: Wishes,
    executor: str,
    columns: Sequence[str],
    *,
    figures: bool,
) -> int:
    """Diagnose each log of a folder. A log that can't be used is a row of the table, not a UserError."""
    if len(folders) != 1:
        raise UserError("--batch: takes one folder, whose files and folders are diagnosed separately; name one")
    wishes.check()
    check_executor(executor)
    sets = sets_of(folders[0], rig, out)
    rigs = {path: load_rig(str(path)) for path in sorted({each.rig for each in sets})}
    make_folder(out)
    with progress_on(note_console()) as tell:
        lines = _lines(tasks_of(sets, rigs, out, columns, wishes, figures=figures), executor, wishes.jobs, tell)
    content = [line._asdict() for line in lines]
    (out / TABLE).write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    _print(lines, out)
    return 0


def _lines(tasks: Sequence[DiagnosisTask], executor: str, jobs: int | None, tell: Callable[[str], None]) -> list[Line]:
    found = {task.of.name: there for task in tasks if (there := done(task)) is not None}
    todo = [task for task in tasks if task.of.name not in found]
    tell(f"{len(found)} of {len(tasks)} were diagnosed before")
    for line in spread(diagnose_task, todo, executor, jobs):
        found[line.name] = line
        tell(f"{len(found)} of {len(tasks)} diagnosed; {line.name}: {line.verdict or line.sentence}")
    return [found[task.of.name] for task in tasks]


def _print(lines: Sequence[Line], out: Path) -> None:
    table = Table(box=SIMPLE_HEAD)
    for name in ("logs", "verdict", "effects", "in words"):
        table.add_column(name)
    for line in lines:
        table.add_row(line.name, line.verdict or "not made", " + ".join(line.effects), line.sentence)
    print_table(table, FILE_COLUMNS)
    count = Counter(line.verdict or "not made" for line in lines)
    told = ", ".join(f"{number} {verdict}" for verdict, number in count.most_common())
    sys.stdout.write(f"{len(lines)} diagnoses: {told}; report.html of each is in {out}/NAME, all verdicts in {TABLE}\n")
