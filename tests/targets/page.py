"""What docs/conformance.md publishes of the targets, read back."""

from typing import Final

from tests.targets.record import ROOT
from tools.targets.target_table import BEGIN, END

PAGE: Final = ROOT / "docs" / "conformance.md"
Rows = list[list[str]]


def published() -> tuple[Rows, Rows]:
    """Return figures and matrix, each with its heading first; ValueError when they are not there."""
    text = PAGE.read_text(encoding="utf-8").split(BEGIN)[1].split(END)[0]
    tables = [part for part in text.split("\n\n") if part.startswith("|")]
    if len(tables) != 2:
        raise ValueError(f"{PAGE.name}: figures and matrix are wanted, not {len(tables)} tables")
    figures, matrix = ([_cells(line) for line in part.splitlines() if "|--" not in line] for part in tables)
    return figures, matrix


def column(target: str) -> dict[str, str]:
    """Return the marks of a target by requirement; empty when it is not published."""
    _, (heading, *rows) = published()
    if target not in heading:
        return {}
    return {row[0]: row[heading.index(target)] for row in rows}


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.removeprefix("|").removesuffix("|").split("|")]
