"""Tables in Markdown, and their place in a document."""

from collections.abc import Sequence

BEGIN = "<!-- hidden-effects: begin -->"
END = "<!-- hidden-effects: end -->"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def between_marks(document: str, text: str) -> str:
    """Return the document with `text` between its marks; ValueError when it doesn't hold both, once, in order."""
    if document.count(BEGIN) != 1 or document.count(END) != 1 or document.index(END) < document.index(BEGIN):
        raise ValueError(f"the document must hold {BEGIN} and {END} once, in this order")
    before, rest = document.split(BEGIN)
    after = rest.split(END)[1]
    return f"{before}{BEGIN}\n{text}\n{END}{after}"
