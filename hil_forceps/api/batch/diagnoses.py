"""Many diagnoses: each log and each folder of logs separately, each with its folder of results."""

import hashlib
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from hil_forceps.api.batch.files import write_json
from hil_forceps.api.batch.store import key_of
from hil_forceps.api.batch.work import MAX_REASON_CHARACTERS
from hil_forceps.api.diagnosis import Wishes, conclude
from hil_forceps.api.runs import read_runs
from hil_forceps.data.readers.tables.mapping import ColumnMap, read_map
from hil_forceps.data.sessions.folder import require_folder, rig_above
from hil_forceps.data.sessions.session import RIG_NAME, TABLE_NAME
from hil_forceps.report.diagnosis.files import write_figures, write_report
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.loading import dump_rig

VERDICT = "verdict.json"  # written last: with it a diagnosis is done
REPORT, RESULT, EXTENDED, FIGURES = "report.html", "diagnosis.json", "extended.yaml", "figures"


class Set(NamedTuple):
    """Logs that are diagnosed together."""

    name: str
    path: Path
    rig: Path


class DiagnosisTask(NamedTuple):
    """The input of one diagnosis."""

    of: Set
    rig: Rig
    out: Path  # of its own
    columns: tuple[str, ...]
    wishes: Wishes
    figures: bool
    key: str


class Line(NamedTuple):
    """The result of one diagnosis: a row of the table."""

    name: str
    verdict: str  # "": it could not be made
    sentence: str  # or why not
    effects: tuple[str, ...]
    seconds: float


def sets_of(folder: Path, rig: Path | None, out: Path) -> list[Set]:
    """Return the sets of logs in a folder: each file and each folder in it.

    UserError if it is not a folder or is empty, if a rig is missing, or if the results would be in the folder of the
    logs.
    """
    require_folder(folder)
    found, problems = [], []
    for path in sorted(folder.iterdir()):
        is_other = path.name in {RIG_NAME, TABLE_NAME} or path.suffix in {".yaml", ".yml", ".json", ".html"}
        if path.name.startswith((".", "_")) or is_other or path.resolve() == out.resolve():
            continue
        own = rig_above(folder, path / RIG_NAME if path.is_dir() else path)[0] or rig
        if own is None:
            problems.append(f"{path}: no {RIG_NAME} beside or in it; put one there, or name one for all with --rig")
        else:
            found.append(Set(path.name, path, own))
    if problems:
        raise UserError(problems)
    if not found:
        raise UserError(f"{folder}: contains no logs; see `hil-forceps import --help` for the formats")
    for each in found:
        _refuse_among_logs(each.path.resolve(), (out / each.name).resolve())
    return found


def _refuse_among_logs(logs: Path, results: Path) -> None:
    if results.is_relative_to(logs) or logs.is_relative_to(results):
        raise UserError(f"out {results.parent}: is within the folder of the logs, {logs}; name a folder outside it")


def tasks_of(
    sets: Sequence[Set], rigs: dict[Path, Rig], out: Path, columns: Sequence[str], wishes: Wishes, *, figures: bool
) -> list[DiagnosisTask]:
    """Return the tasks; each runs in one thread, because many run in parallel."""
    mapping = read_map(columns)
    alone = wishes._replace(jobs=1)
    return [
        DiagnosisTask(
            each,
            rigs[each.rig],
            out / each.name,
            tuple(columns),
            alone,
            figures,
            _key(each, rigs[each.rig], mapping, alone, figures=figures),
        )
        for each in sets
    ]


def done(task: DiagnosisTask) -> Line | None:
    """Return the result of an earlier diagnosis with the same inputs; None if there is none."""
    try:
        told = json.loads((task.out / VERDICT).read_text(encoding="utf-8"))
        if told["key"] != task.key:
            return None
        return Line(task.of.name, told["verdict"], told["sentence"], tuple(told["effects"]), told["seconds"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def diagnose_task(task: DiagnosisTask) -> Line:
    """Make one diagnosis and write its results; an error in its logs is its row of the table, not an exception."""
    began_s = time.monotonic()
    figures: list[str] = []
    try:
        _clear(task.out)
        line, figures = _diagnosed(task, began_s)
    except UserError as error:
        line = _unusable(task, error.problems[0], began_s)
    except OSError as error:  # of the disk, not of the logs: it is made again
        return _unusable(task, f"{error.filename or task.of.path}: {error.strerror or error}", began_s)
    except Exception as error:
        line = _unusable(task, f"the diagnosis failed, {type(error).__name__}: {error}", began_s)
    write_json(task.out / VERDICT, {"key": task.key, **line._asdict(), "figures": figures})
    return line


def _diagnosed(task: DiagnosisTask, began_s: float) -> tuple[Line, list[str]]:
    """Write the results; return the line and the names of the figures."""
    runs = read_runs(task.of.path, rig=task.rig, columns=task.columns)
    result = conclude(runs, task.rig, task.wishes, began_s, _say_nothing, _say_nothing)
    write_report(result.diagnosis, task.out / REPORT)
    figures = write_figures(result.diagnosis, task.out / FIGURES) if task.figures else []
    write_json(task.out / RESULT, result.to_json())
    (task.out / EXTENDED).write_text(dump_rig(result.extended_rig), encoding="utf-8")
    effects = tuple(effect.id for effect in result.causes)
    line = Line(task.of.name, result.verdict, result.sentence, effects, round(time.monotonic() - began_s, 1))
    return line, [path.name for path in figures]


def _clear(folder: Path) -> None:
    """Remove only the results of an earlier diagnosis with other inputs; its verdict file names its figures."""
    try:
        told = json.loads((folder / VERDICT).read_text(encoding="utf-8"))
        figures = [Path(str(name)).name for name in told["figures"]]
    except (OSError, ValueError, KeyError, TypeError):
        return
    for path in (*(folder / name for name in (REPORT, RESULT, EXTENDED)), *(folder / FIGURES / n for n in figures)):
        path.unlink(missing_ok=True)
    (folder / VERDICT).unlink()


def _unusable(task: DiagnosisTask, reason: str, began_s: float) -> Line:
    said = " ".join(reason.split())[:MAX_REASON_CHARACTERS]
    return Line(task.of.name, "", said, (), round(time.monotonic() - began_s, 1))


def _key(of: Set, rig: Rig, mapping: ColumnMap, wishes: Wishes, *, figures: bool) -> str:
    """Return the key of the results: a digest of all files, the rig, the version and the options."""
    digest = hashlib.sha256(key_of(rig, mapping).encode())
    digest.update(repr((wishes, figures)).encode())
    files = sorted(of.path.rglob("*")) if of.path.is_dir() else [of.path]
    for file in files:
        if file.is_file():
            digest.update(str(file.relative_to(of.path)).encode())
            with file.open("rb") as stream:
                digest.update(hashlib.file_digest(stream, "sha256").digest())
    return digest.hexdigest()


def _say_nothing(_: object) -> None:
    """Say nothing."""
