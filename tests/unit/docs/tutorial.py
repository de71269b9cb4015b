"""Tutorials as tests: their `sh` blocks are run in order, and what they print is held against the `text` block behind.

    python -m tests.unit.docs.tutorial docs/tutorials/first-bench.md

runs one in a folder of its own and prints each block with what it printed.
"""

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from tests.unit.docs.code_blocks import Block, blocks_of

ROOT = Path(__file__).parents[3]
REST = "..."  # a line of its own: any lines
ANY = "…"  # a word of its own: any word
FIRST_TIME = "Compiling numerical kernels"  # only on the first run of a machine
VARY = "numbers vary"
SAME_WITHIN = 0.02
_NUMBER = re.compile(r"[-+−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


class Step(NamedTuple):
    """A block of commands, and what they should print; None where the page shows nothing."""

    line: int
    commands: str
    expected: Block | None


def steps_of(page: str) -> Iterator[Step]:
    """Yield the steps of a tutorial; a file that it shows (`<!-- file: NAME -->`) is written where it stands."""
    blocks = list(blocks_of(page))
    for block, after in zip(blocks, [*blocks[1:], None], strict=True):
        if block.note.startswith("file: "):
            yield Step(block.line, f"cat >{block.note[6:]} <<'__END__'\n{block.text}__END__\n", None)
        elif block.language == "sh" and not block.why_not_run:
            follows = after is not None and after.language == "text" and _is_next(page, block, after)
            yield Step(block.line, block.text, after if follows else None)


def _is_next(page: str, block: Block, after: Block) -> bool:
    between = page.splitlines()[page.count("\n", 0, block.end) + 1 : after.line - 2]
    return not any(line and not line.startswith("<!--") for line in between)


def printed(commands: str, folder: Path) -> str:
    """Run commands in a folder as a user types them; return what they print, whatever their exit codes."""
    environment = os.environ | {
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "COLUMNS": "100",
    }
    environment.pop("CI", None)
    script = ["bash", "-c", commands]
    done = subprocess.run(
        script, cwd=folder, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, text=True, check=False,
    )  # fmt: skip
    return "".join(line for line in done.stdout.splitlines(keepends=True) if not line.startswith(FIRST_TIME))


def difference(expected: str, got: str, *, numbers_vary: bool = False) -> str:
    """Return the first line that differs, empty where none does: spaces don't count, numbers agree within 2 %."""
    wanted = [line for line in map(_plain, expected.splitlines()) if line]
    lines = [line for line in map(_plain, got.splitlines()) if line]
    at, free = 0, False
    for line in wanted:
        if line == REST:
            free = True
            continue
        places = range(at, len(lines) if free else min(at + 1, len(lines)))
        found = next((place for place in places if _agree(line, lines[place], numbers_vary)), None)
        if found is None:
            return f"expected {line!r}, got {lines[at] if at < len(lines) else 'nothing more'!r}"
        at, free = found + 1, False
    return "" if free or at == len(lines) else f"more than expected: {lines[at]!r}"


def _plain(line: str) -> str:
    return " ".join(re.sub("─+", "─", line).split())


def _agree(wanted: str, got: str, numbers_vary: bool) -> bool:
    pairs = list(zip(wanted.split(), got.split(), strict=False))
    return len(wanted.split()) == len(got.split()) and all(
        word == ANY or _same_word(word, other, numbers_vary) for word, other in pairs
    )


def _same_word(wanted: str, got: str, numbers_vary: bool) -> bool:
    if _NUMBER.sub("#", wanted) != _NUMBER.sub("#", got):
        return False
    pairs = zip(_NUMBER.findall(wanted), _NUMBER.findall(got), strict=True)
    return numbers_vary or all(_near(a, b) for a, b in pairs)


def _near(wanted: str, got: str) -> bool:
    """Tell whether two numbers agree within 2 %, or within 1.5 units of the last place that the page shows."""
    mantissa, _, exponent = wanted.partition("e")
    last_place = 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
    return abs(_value(wanted) - _value(got)) <= max(SAME_WITHIN * abs(_value(wanted)), 1.5 * last_place)


def _value(number: str) -> float:
    return float(number.replace("−", "-"))


def prepared(folder: Path) -> Path:
    """Put what a clone of the project has, as far as tutorials need it, into a folder."""
    for name in ("configs", "docs"):
        (folder / name).symlink_to(ROOT / name)
    return folder


if __name__ == "__main__":
    page = Path(sys.argv[1]).read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as scratch:
        folder = prepared(Path(scratch))
        for step in steps_of(page):
            told = printed(step.commands, folder)
            problem = "" if step.expected is None else difference(
                step.expected.text, told, numbers_vary=step.expected.note == VARY
            )  # fmt: skip
            sys.stdout.write(f"--- line {step.line}: {problem or 'as expected'}\n{step.commands}---\n{told}")
            sys.stdout.flush()
