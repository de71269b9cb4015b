"""Reading rig files, and writing them."""

from collections.abc import Mapping
from os import PathLike
from pathlib import Path as FilePath

from hil_forceps.rig.errors import UserError
from hil_forceps.rig.schema import Rig, validate
from hil_forceps.rig.validation import consistency
from hil_forceps.rig.validation.problems import Path, Problem
from hil_forceps.rig.yaml_loader import MAX_FILE_BYTES, Document, Mark, load_document, render


def load_rig(path: str | PathLike[str]) -> Rig:
    """Read a rig file; UserError with every problem of it, one line each: `path:line: key: what is wrong; remedy`."""
    if not isinstance(path, str | PathLike):
        raise TypeError(f"path: must be the path of a rig file, not {type(path).__name__}")
    name = str(path)
    if FilePath(path).is_dir():
        raise UserError(f"{name}: is a folder; name a rig file (YAML)")
    try:
        with FilePath(path).open("rb") as file:
            content = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        remedy = "check the path"
        if FilePath(path).parts[:1] == ("configs",):
            remedy += ", or write the examples with `hil-forceps configs --out configs`"
        raise UserError(f"{name}: can't be read: {error.strerror or error}; {remedy}") from None
    except ValueError as error:  # a NUL in the path
        raise UserError(f"{name!r}: can't be read: {error}; check the path") from None
    if len(content) > MAX_FILE_BYTES:
        raise UserError(f"{name}: larger than {MAX_FILE_BYTES} bytes, so not a rig file; name a rig file (YAML)")
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        column = error.start - (content.rfind(b"\n", 0, error.start) + 1) + 1
        raise UserError(f"{name}:{line}:{column}: not UTF-8; save the file as UTF-8") from None
    return parse_rig(text, name)


def parse_rig(text: str, name: str = "<rig>") -> Rig:
    """Read a rig from text; UserError as `load_rig`, with `name` in place of the path."""
    document = load_document(text, name)
    problems = list(document.problems)
    rig: Rig | None = None
    if not isinstance(document.data, dict):
        if not document.refused:
            problems.append((Mark(1, 1), Problem((), "holds no mapping; a rig file begins with `forceps:`")))
    else:
        empty = _drop_empty(document.data, (), document.refused)
        rig, found = validate(document.data)
        if "bench" in document.data:
            bad = {*document.refused, *(problem.path for problem in found)}
            found += consistency.check_bench(consistency.flatten(document.data, Rig, bad))
        said = {*document.refused, *(problem.path for problem in empty)}
        found = [problem for problem in found if not any(problem.path[: len(path)] == path for path in said)]
        problems += [(_mark_of(problem.path, document), problem) for problem in (*empty, *found)]
    if rig is None or problems:
        raise UserError(render(name, problems))
    return rig


def _drop_empty(data: dict[str, object], path: Path, refused: set[Path]) -> list[Problem]:
    """Take keys without a value out of the data, and say so once for each."""
    problems: list[Problem] = []
    for key in list(data):
        value = data[key]
        here = (*path, key)
        if value is None:
            del data[key]
            if here not in refused:
                problems.append(Problem(here, "has no value; give one or remove the key"))
        elif isinstance(value, dict):
            problems += _drop_empty(value, here, refused)
    return problems


def _mark_of(path: Path, document: Document) -> Mark:
    """Return the place of a key, or of the nearest thing around it that is there."""
    for length in range(len(path), 0, -1):
        if mark := document.key_marks.get(path[:length]):
            return mark
    return Mark(1, 1)


def dump_rig(rig: Rig) -> str:
    """Write a rig as a file that loads back equal: what was given, defaults left out."""
    lines: list[str] = []
    for section, entries in rig.to_data().items():
        if not entries:
            lines.append(f"{section}: {{}}")
            continue
        lines.append(f"{section}:")
        lines += [f"  {key}: {_written(value)}" for key, value in entries.items()]
    return "\n".join(lines) + "\n"


def _written(value: object) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {_written(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_written(item) for item in value) + "]"
    return str(value)
