"""Links of Markdown pages: where they stand, what they point at, and the anchors that a page has."""

import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from markdown.extensions.toc import slugify

_FENCE = re.compile(r"^ {0,3}(?P<mark>`{3,}|~{3,}).*?^ {0,3}(?P=mark)[`~]*[ \t]*$", re.MULTILINE | re.DOTALL)
_INLINE_CODE = re.compile(r"(?<!`)(`+)(?!`)(?:(?!\n\s*\n).)+?(?<!`)\1(?!`)", re.DOTALL)
_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
_TARGET = re.compile(r"(?P<head>!?\[(?:[^\[\]]|\[[^\[\]]*\])*\]\()(?P<target>[^()\s]+)(?P<tail>(?:\s+\"[^\"]*\")?\))")
_HTML_TARGET = re.compile(r"(?P<head><(?:a|img)\b[^>]*?\b(?:href|src)=\")(?P<target>[^\"]+)(?P<tail>\")")
_HEADING = re.compile(r"^#{1,6}\s+(?P<text>.+?)\s*#*$", re.MULTILINE)
_OWN_ANCHOR = re.compile(r"<a (?:id|name)=\"([^\"]+)\"")


class Link(NamedTuple):
    """One link of a page: its line, from 1 on, and its target as written."""

    line: int
    target: str

    @property
    def is_outside(self) -> bool:
        """Whether it leads out of the repository."""
        return bool(re.match(r"[a-z][a-z+.-]*:|//", self.target))


def links_of(text: str) -> Iterator[Link]:
    """Yield the links and images of a page, none of those that stand in code."""
    bare = _without_code(text)
    for pattern in (_TARGET, _HTML_TARGET):
        for match in pattern.finditer(bare):
            yield Link(bare.count("\n", 0, match.start()) + 1, match["target"])


def anchors_of(text: str) -> set[str]:
    """Return what `#…` may name on a page: its headings, numbered where they repeat, and anchors of its own."""
    found = set(_OWN_ANCHOR.findall(text))
    for match in _HEADING.finditer(_blanked(_blanked(text, _FENCE), _COMMENT)):
        words = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", match["text"]).replace("`", "").replace("*", "")
        name, number = anchor(words), 1
        while name in found:
            name, number = f"{anchor(words)}_{number}", number + 1
        found.add(name)
    return found


def anchor(words: str) -> str:
    """Return the anchor of a heading: what git forges make of it, letters of any alphabet kept."""
    return str(slugify(words, "-", unicode=True))


def relinked(text: str, change: Callable[[str], str]) -> str:
    """Return a page with each target in it changed, and its code as it is."""
    bare = _without_code(text)
    places = [match for pattern in (_TARGET, _HTML_TARGET) for match in pattern.finditer(bare)]
    for match in sorted(places, key=lambda match: -match.start()):
        if not Link(0, match["target"]).is_outside and not match["target"].startswith("#"):
            text = text[: match.start("target")] + change(match["target"]) + text[match.end("target") :]
    return text


def path_of(target: str, page: PurePosixPath) -> tuple[PurePosixPath, str]:
    """Return where a target of a page lies, from the repository's root, and the anchor behind `#`."""
    path, _, place = target.partition("#")
    return PurePosixPath(os.path.normpath(page.parent / path) if path else page), place


def problem_of(link: Link, page: PurePosixPath, root: Path) -> str:
    """Return what is wrong with a link, empty when nothing is."""
    if link.is_outside:
        return ""
    path, place = path_of(link.target, page)
    if path.parts[:1] == ("..",):
        return "leads out of the repository"
    if not (root / path).exists():
        return f"{path} is not there"
    if place and path.suffix == ".md" and place not in anchors_of((root / path).read_text(encoding="utf-8")):
        return f"{path} has no heading #{place}"
    return ""


def _without_code(text: str) -> str:
    text = _blanked(_blanked(text, _FENCE), _COMMENT)
    text = _blanked(text, _INLINE_CODE, "`")  # a line that begins with code is no block of it
    return "".join(
        re.sub(r"\S", " ", line) if line.startswith("    ") and before.strip() == "" else line
        for before, line in _with_line_before(text)
    )


def _with_line_before(text: str) -> Iterator[tuple[str, str]]:
    before, is_code = "", False
    for line in text.splitlines(keepends=True):
        is_code = line.startswith("    ") and (is_code or before.strip() == "")
        yield ("" if is_code else before or " ", line)
        before = line


def _blanked(text: str, pattern: re.Pattern[str], filling: str = " ") -> str:
    return pattern.sub(lambda match: re.sub(r"[^\n]", filling, match[0]), text)
