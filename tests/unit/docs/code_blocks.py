"""Fenced blocks of Markdown pages: their language, their text, and what a comment above them says."""

import re
from collections.abc import Iterator
from typing import NamedTuple

_BLOCK = re.compile(
    r"^(?:<!-- (?P<note>[^\n]*) -->\n)?^```(?P<language>\w*)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL
)


class Block(NamedTuple):
    """One block; `line` is that of its first line of text, `note` is what `<!-- … -->` right above it says."""

    line: int
    language: str
    text: str
    note: str
    end: int

    @property
    def why_not_run(self) -> str:
        """The reason for which it is not run, empty where it is."""
        return self.note.removeprefix("not run: ") if self.note.startswith("not run: ") else ""


def blocks_of(page: str) -> Iterator[Block]:
    """Yield the blocks of a page in their order."""
    for match in _BLOCK.finditer(page):
        line = page.count("\n", 0, match.start("text")) + 1
        yield Block(line, match["language"], match["text"], match["note"] or "", match.end())
