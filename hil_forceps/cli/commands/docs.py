"""`hil-forceps docs`: the pages of the documents, for installations without the repository."""

import sys
from pathlib import Path
from typing import NamedTuple

from hil_forceps.cli.arguments.shipped import chosen
from hil_forceps.rig.errors import UserError

PACKAGE = Path(__file__).parents[2]
# A wheel contains the pages in the package; in a checkout they are next to it.
FOLDERS = (PACKAGE / "docs", PACKAGE.parent / "docs")
NAME_WIDTH = 30


class Page(NamedTuple):
    """A page of the documents."""

    name: str  # as it is typed: tutorials/your-own-logs
    path: Path

    @property
    def title(self) -> str:
        """Its first heading."""
        return self.path.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")


def docs(page: str | None = None) -> int:
    """List the pages of the documents of this version, or print one of them.

    Parameters
    ----------
    page
        Name of a page, as messages give it: `docs/rig-file.md`, or `rig-file`.
    """
    found = pages()
    if page is None:
        lines = [f"{each.name:<{NAME_WIDTH}}{each.title}\n" for each in found]
        sys.stdout.write("".join(lines))
        return 0
    sys.stdout.write(_chosen(page, found).path.read_text(encoding="utf-8"))
    return 0


def pages() -> list[Page]:
    """Return all pages, by name, without the decision records, which are for developers."""
    for folder in FOLDERS:
        if (folder / "glossary.md").is_file():
            paths = [
                *sorted(folder.glob("*.md")),
                *sorted(folder.glob("tutorials/*.md")),
                *sorted(folder.glob("drives/*.md")),
            ]
            return [Page(str(path.relative_to(folder).with_suffix("").as_posix()), path) for path in paths]
    raise UserError(f"{FOLDERS[0]}: the pages are missing; install the package again")


def _chosen(wanted: str, found: list[Page]) -> Page:
    name = wanted.partition("#")[0].removeprefix("docs/").removesuffix(".md")
    return chosen(wanted, name, {page.name: page for page in found}, "page", "docs")
