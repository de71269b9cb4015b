"""A text in blocks of whole lines; what is behind zero bytes, or has no line end, is left out and said."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from hil_forceps.data.readers.cut_text import no_end_note, zero_bytes_note
from hil_forceps.data.readers.tables.cells import MAX_LINE_CHARACTERS, is_empty, is_number, is_skipped, split_line
from hil_forceps.rig.errors import UserError

MAX_FOOTER_LINES = 100
_MAX_JOINED_BYTES = 1 << 16  # a last piece that is joined to the one before, so that a footer is in one block
_SHOWN_CHARACTERS = 40


class Block(NamedTuple):
    """Whole lines, and the number of the line before them."""

    text: bytes
    line: int
    is_last: bool


def whole_blocks(path: Path, pieces: Iterator[bytes], notes: list[str]) -> Iterator[Block]:
    """Yield the pieces so that each ends where a line ends; a note where the text doesn't."""
    line = 0
    rest, whole = b"", b""
    ended = False
    for piece, is_last in _with_end(pieces):
        text = rest + piece
        zero = text.find(b"\0")
        ended = zero >= 0
        end = text.rfind(b"\n", 0, zero if ended else len(text)) + 1
        fresh, rest = text[:end], text[end:]
        if len(rest) > MAX_LINE_CHARACTERS and not ended:
            raise UserError(f"{path}: a line of more than {MAX_LINE_CHARACTERS} characters: not a CSV file")
        if whole and not ((is_last or ended) and len(fresh) <= _MAX_JOINED_BYTES):
            yield Block(whole, line, is_last=False)
            line += whole.count(b"\n")
            whole = b""
        whole += fresh
        if ended:
            break
    if not is_skipped(rest.decode(errors="replace")):
        last = line + whole.count(b"\n") + 1
        notes.append(zero_bytes_note(last) if ended else no_end_note(last))
    if whole:
        yield Block(whole, line, is_last=True)


def _with_end(pieces: Iterator[bytes]) -> Iterator[tuple[bytes, bool]]:
    waiting = next(pieces, None)
    while waiting is not None:
        following = next(pieces, None)
        yield waiting, following is None
        waiting = following


def without_footer(block: Block, delimiter: str, count: int, used: Sequence[int], notes: list[str]) -> Block:
    """Cut off lines behind the last sample that are none: of another number of cells, without a number in front."""
    if not block.is_last:
        return block
    text, first = block.text, ""
    for _ in range(MAX_FOOTER_LINES):
        begin = text.rfind(b"\n", 0, len(text) - 1) + 1
        line = text[begin:].decode(errors="replace")
        if not text or not (is_skipped(line) or _is_footer(line, delimiter, count, used)):
            break
        first = first if is_skipped(line) else line
        text = text[:begin]
    if not first:
        return block
    line_number = block.line + text.count(b"\n") + 1
    notes.append(
        f"line {line_number} and what follows, behind the table, was left out: {first.strip()[:_SHOWN_CHARACTERS]!r}"
    )
    return block._replace(text=text)


def _is_footer(line: str, delimiter: str, count: int, used: Sequence[int]) -> bool:
    cells = split_line(line, delimiter)
    if is_number(cells[0]) or all(map(is_empty, cells)):
        return False
    return len(cells) != count or not any(is_number(cells[at]) for at in used)
