"""The file of `import --write-map`."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hil_forceps.data.column_names import split_name
from hil_forceps.data.readers.tables.columns import Found, Header, OnColumns
from hil_forceps.data.readers.tables.mapping import yaml_of
from hil_forceps.rig.errors import UserError


@contextmanager
def leaving_map(path: Path | None) -> Iterator[OnColumns]:
    """Write the column mapping of the first table; if reading fails, a proposal as comments."""
    seen: list[tuple[Header, Found]] = []

    def keep(header: Header, found: Found) -> None:
        seen.append((header, found))

    try:
        yield keep
    except UserError as error:
        if path is None or not seen:
            raise
        _write(path, *seen[0])
        told = f"{path}: contains proposals as comments; correct them, remove the #, and use --map {path}"
        raise UserError([*error.problems, told]) from error
    if path is not None:
        if not seen:
            raise UserError("--write-map: none of the sources is a table, and other formats need no map; leave it out")
        _write(path, *seen[0])
        sys.stdout.write(f"{path}: column map of {seen[0][0].place}, for --map\n")


def _write(path: Path, header: Header, found: Found) -> None:
    used = [(use.name, header.names[use.position], use.unit) for use in found.uses]
    proposed = [(name, column, unit or split_name(name)[1]) for name, column, unit in found.proposals]
    try:
        path.write_text(yaml_of(used, proposed, header.place), encoding="utf-8")
    except OSError as error:
        raise UserError(f"{path}: {error.strerror or error}; name another file") from error
