"""`hil-forceps configs`: the example rig files, for installations without the repository."""

import sys
import textwrap
from pathlib import Path
from typing import Annotated, NamedTuple

from cyclopts import Parameter

from hil_forceps.cli.arguments.shipped import chosen
from hil_forceps.rig.errors import UserError

PACKAGE = Path(__file__).parents[2]
# A wheel contains the files in the package; in a checkout they are next to it.
FOLDERS = (PACKAGE / "configs", PACKAGE.parent / "configs")
NAME_WIDTH, TITLE_WIDTH = 23, 57  # columns: together those of a terminal


class Example(NamedTuple):
    """An example of a rig file."""

    name: str  # as it is typed: drives/odrive
    path: Path

    @property
    def title(self) -> str:
        """The beginning of the comment in its first line."""
        first = self.path.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")
        return textwrap.shorten(first.removesuffix("."), TITLE_WIDTH, placeholder=" ...")


def configs(
    name: str | None = None,
    *,
    out: Path | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """List the example rig files of this version, print one, or write them to a folder.

    Examples in the documents name them `configs/NAME.yaml`: `--out configs` writes them to where these commands expect
    them.

    Parameters
    ----------
    name
        One of the examples: `realistic`, or `configs/drives/odrive.yaml`.
    out
        Folder to write the examples to, or the one that is named.
    overwrite
        Overwrite existing files.
    """
    found = examples()
    some = found if name is None else [_chosen(name, found)]
    if out is not None:
        _write(some, out, overwrite=overwrite)
    elif name is None:
        sys.stdout.write("".join(f"{each.name:<{NAME_WIDTH}}{each.title}\n" for each in found))
    else:
        sys.stdout.write(some[0].path.read_text(encoding="utf-8"))
    return 0


def examples() -> list[Example]:
    """Return all examples, by name."""
    for folder in FOLDERS:
        paths = [*sorted(folder.glob("*.yaml")), *sorted(folder.glob("drives/*.yaml"))]
        if paths:
            return [Example(path.relative_to(folder).with_suffix("").as_posix(), path) for path in paths]
    raise UserError(f"{FOLDERS[0]}: the example rig files are missing; install the package again")


def _chosen(wanted: str, found: list[Example]) -> Example:
    name = wanted.removeprefix("configs/").removesuffix(".yaml")
    return chosen(wanted, name, {each.name: each for each in found}, "example", "configs")


def _write(some: list[Example], out: Path, *, overwrite: bool) -> None:
    """Write examples to a folder; UserError, and nothing written, where a file has another content already."""
    files = [(out / f"{each.name}.yaml", each.path.read_bytes()) for each in some]
    if not overwrite:
        changed = [path for path, content in files if path.exists() and path.read_bytes() != content]
        if changed:
            raise UserError([f"{path}: already exists; name another folder, or use --overwrite" for path in changed])
    for path, content in files:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    sys.stdout.write("".join(f"{path}\n" for path, _ in files))
