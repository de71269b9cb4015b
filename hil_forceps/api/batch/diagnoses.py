"""Many diagnoses: each log, and each folder of logs, by itself, with a folder of results of its own."""

import hashlib
import json
import shutil
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from hil_forceps.api.batch.store import key_of
from hil_forceps.api.batch.work import MAX_REASON
from hil_forceps.api.diagnosis import Wishes, conclude
from hil_forceps.api.runs import read_runs
from hil_forceps.data.readers.tables.mapping import ColumnMap, read_map
from hil_forceps.data.sessions.folder import rig_above
from hil_forceps.data.sessions.session import RIG_NAME, TABLE_NAME
from hil_forceps.report.diagnosis.files import write_figures, write_report
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.loading import dump_rig

VERDICT = "verdict.json"  # written last: with it a diagnosis is done


class Set(NamedTuple):
    """What is diagnosed together."""

    name: str
    path: Path
    rig: Path


class DiagnosisTask(NamedTuple):
    """One diagnosis to be made."""

    of: Set
    rig: Rig
    out: Path  # of its own
    columns: tuple[str, ...]
    wishes: Wishes
    figures: bool
    key: str


class Line(NamedTuple):
    """What came of it, a line of the table."""

    name: str
    verdict: str  # "": it could not be made
    sentence: str  # or why not
    effects: tuple[str, ...]
    seconds: float


def sets_of(folder: Path, rig: Path | None, out: Path) -> list[Set]:
    """Return what a folder holds to be diagnosed: each file and each folder in it.

    UserError where it is no folder or holds nothing, and where no rig is known.
    """
    if not folder.is_dir():
        raise UserError(f"{folder}: {'is no folder' if folder.exists() else 'no such folder'}; name that of the logs")
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
        raise UserError(f"{folder}: no logs in it; `hil-forceps import` says what can be read")
    return found


def tasks_of(
    sets: Sequence[Set], rigs: dict[Path, Rig], out: Path, columns: Sequence[str], wishes: Wishes, *, figures: bool
) -> list[DiagnosisTask]:
    """Return the tasks; each runs in one thread, for there are many of them."""
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
    """Return what came of a diagnosis that was made already of the same bytes; None where it is to be made."""
    try:
        told = json.loads((task.out / VERDICT).read_text(encoding="utf-8"))
        if told["key"] != task.key:
            return None
        return Line(task.of.name, told["verdict"], told["sentence"], tuple(told["effects"]), told["seconds"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def diagnose_task(task: DiagnosisTask) -> Line:
    """Make one diagnosis and write its results; whatever is wrong with its logs is its line, and no exception."""
    began_s = time.monotonic()
    try:
        line, told = _diagnosed(task, began_s), True
    except UserError as error:
        line, told = _unusable(task, error.problems[0], began_s), True
    except OSError as error:
        line, told = _unusable(task, f"{error.filename or task.of.path}: {error.strerror or error}", began_s), False
    except Exception as error:
        line, told = _unusable(task, f"the diagnosis failed, {type(error).__name__}: {error}", began_s), True
    if told:
        task.out.mkdir(parents=True, exist_ok=True)
        _write(task.out / VERDICT, {"key": task.key, **line._asdict()})
    return line


def _diagnosed(task: DiagnosisTask, began_s: float) -> Line:
    runs = read_runs(task.of.path, rig=task.rig, columns=task.columns)
    result = conclude(runs, task.rig, task.wishes, began_s, _say_nothing, _say_nothing)
    if task.out.is_dir():
        shutil.rmtree(task.out)  # of other bytes
    task.out.mkdir(parents=True)
    write_report(result.diagnosis, task.out / "report.html")
    if task.figures:
        write_figures(result.diagnosis, task.out / "figures")
    _write(task.out / "diagnosis.json", result.to_json())
    (task.out / "extended.yaml").write_text(dump_rig(result.extended_rig), encoding="utf-8")
    effects = tuple(effect.id for effect in result.causes)
    return Line(task.of.name, result.verdict, result.sentence, effects, round(time.monotonic() - began_s, 1))


def _unusable(task: DiagnosisTask, reason: str, began_s: float) -> Line:
    said = " ".join(reason.split())[:MAX_REASON]
    return Line(task.of.name, "", said, (), round(time.monotonic() - began_s, 1))


def _key(of: Set, rig: Rig, mapping: ColumnMap, wishes: Wishes, *, figures: bool) -> str:
    """Return what the results hang on: the bytes of all files, the rig, the version and the options."""
    digest = hashlib.sha256(key_of(rig, mapping).encode())
    digest.update(repr((wishes, figures)).encode())
    files = sorted(of.path.rglob("*")) if of.path.is_dir() else [of.path]
    for file in files:
        if file.is_file():
            digest.update(str(file.relative_to(of.path)).encode())
            with file.open("rb") as stream:
                digest.update(hashlib.file_digest(stream, "sha256").digest())
    return digest.hexdigest()


def _write(path: Path, content: dict[str, Any]) -> None:
    unfinished = path.with_name(f".{path.name}")
    unfinished.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    unfinished.replace(path)


def _say_nothing(_: object) -> None:
    """Say nothing."""
