"""The pages that the generator gets: docs/, README and CONTRIBUTING beside it, the reference from the program."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path, PurePosixPath

from tools.site import api_page, cli_page
from tools.site.links import path_of, relinked

ROOT = Path(__file__).parents[2]
# Pages that lie outside docs/ in the repository, and their places on the site.
OUTSIDE = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
DECISIONS = ROOT / "docs" / "decisions"


def decisions() -> str:
    """Return the list of decision records."""
    titles = {
        path.name: path.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")
        for path in sorted(DECISIONS.glob("0*.md"))
        if path.name != "0000-template.md"
    }
    lines = (f"- [{title}]({name})" for name, title in titles.items())
    return "\n".join(("# Decisions\n", "Why things are as they are, one page each.\n", *lines, ""))


MADE: dict[str, Callable[[], str]] = {
    "command-line.md": cli_page.page,
    "api.md": api_page.page,
    "decisions/index.md": decisions,
}


def stage(target: Path) -> None:
    """Lay all pages out in a folder, which is emptied before."""
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(ROOT / "docs", target, ignore=shutil.ignore_patterns("__pycache__", ".*"))
    for source in sorted((ROOT / "docs").rglob("*.md")):
        page = PurePosixPath(source.relative_to(ROOT))
        _write(target / page.relative_to("docs"), _moved(source.read_text(encoding="utf-8"), page, target))
    for name, place in OUTSIDE.items():
        _write(target / place, _moved((ROOT / name).read_text(encoding="utf-8"), PurePosixPath(name), target))
    for place, make in MADE.items():
        _write(target / place, make())


def place_of(path: PurePosixPath) -> PurePosixPath:
    """Return where a file of the repository lies on the site."""
    if path.parts[0] == "docs":
        place = path.relative_to("docs")
        return place / "index.md" if (ROOT / path).is_dir() else place
    return PurePosixPath(OUTSIDE.get(str(path), str(path)))


def _moved(text: str, page: PurePosixPath, target: Path) -> str:
    """Point a page's links at where things lie on the site; files outside docs/ that it names come along."""
    here = place_of(page).parent

    def change(link: str) -> str:
        path, anchor = path_of(link, page)
        place = place_of(path)
        if path.parts[0] != "docs" and path.suffix != ".md" and (ROOT / path).is_file():
            (target / place).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / path, target / place)
        return os.path.relpath(place, here) + (f"#{anchor}" if anchor else "")

    return relinked(text, change)


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
