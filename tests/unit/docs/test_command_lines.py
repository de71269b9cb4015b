"""Every `hil-forceps …` line in the README and the docs is one that the command understands."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from cyclopts import CycloptsError

from hil_forceps.cli.examples import EXAMPLES
from hil_forceps.cli.main import app
from virtual_bus.realtime.process import _parser as drive_parser

ROOT = Path(__file__).parents[3]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
COMMANDS = tuple(EXAMPLES)
_FENCE = re.compile(r"^\s*```")
_INLINE = re.compile(r"`([^`\n]*\bhil-forceps\b[^`\n]*)`")
_PLACEHOLDER = re.compile(r"[\[\]…<>|]|\.\.\.|\b[A-Z]{2,}\b|\bN\b")  # a synopsis, as `--seed N`, and no line to type
_OPERATORS = {"|", "&", "&&", ";", ">", ">>", "<", "2>"}


class Line(NamedTuple):
    """What follows `hil-forceps` somewhere in a page."""

    where: str
    text: str
    is_block: bool


def lines_of(page: str, name: str) -> Iterator[Line]:
    """Find the lines of code blocks and the inline code that call the command."""
    in_block, held, began = False, "", 0
    for number, line in enumerate(page.splitlines(), 1):
        if _FENCE.match(line):
            in_block = not in_block
            continue
        if not (in_block or held or (line.startswith("    ") and "`" not in line)):
            for match in _INLINE.finditer(line):
                yield from _calls(match[1], f"{name}:{number}", False)
            continue
        began = began if held else number
        held += line
        if held.endswith("\\"):
            held = held[:-1] + " "
            continue
        yield from _calls(held, f"{name}:{began}", True)
        held = ""


def _calls(text: str, where: str, is_block: bool) -> Iterator[Line]:
    match = re.match(r"^(?:\$ )?(?:\S*/)?hil-forceps\b(?!:)(.*)$", text.strip()) or re.search(
        r"(?:[|;&] |\bpython\S* -m )(?:\S*/)?hil-forceps\b(?!:)(.*)$", text
    )
    if match:
        yield Line(where, match[1].strip(), is_block)


def problem_of(line: Line) -> str:
    """Return what is wrong with a line, empty when nothing is."""
    if not line.is_block or _PLACEHOLDER.search(line.text.partition(" #")[0]):
        return _problem_of_words(line.text)
    tokens = shlex.split(line.text, comments=True)
    end = next((place for place, token in enumerate(tokens) if token in _OPERATORS), len(tokens))
    tokens = tokens[:end]
    if not tokens or tokens[0] in ("--help", "--version"):
        return ""
    if "--help" in tokens:
        return "" if tokens[0] in COMMANDS else f"no command {tokens[0]}"
    try:
        if tokens[0] == "drive":
            drive_parser().parse_args(tokens[1:])
        else:
            app.parse_args(tokens, exit_on_error=False, print_error=False)
    except CycloptsError as error:
        return " ".join(str(error).split())
    except SystemExit:
        return "the drive does not understand it"
    return ""


def _problem_of_words(text: str) -> str:
    """Check a synopsis: that the command and the options it names are there."""
    words = re.findall(r"--?[a-z][a-z-]*|[a-z]+", text)
    if not words:
        return ""
    if words[0] in ("--help", "--version"):
        return ""
    if words[0] not in COMMANDS:
        return f"no command {words[0]}"
    known = set(_options(words[0])) | {"--help"}
    unknown = [word for word in re.findall(r"(?<![\w-])--[a-z][a-z-]*", text) if word not in known]
    return f"no option {', '.join(unknown)}" if unknown else ""


def _options(command: str) -> Iterator[str]:
    if command == "drive":
        for action in drive_parser()._actions:
            yield from action.option_strings
        yield "--kind"
        return
    for argument in app[command].assemble_argument_collection():
        yield from argument.names
        yield from argument.negatives


@pytest.mark.parametrize("page", PAGES, ids=[str(page.relative_to(ROOT)) for page in PAGES])
def test_command_lines_of_the_docs_are_understood(page: Path) -> None:
    found = lines_of(page.read_text(encoding="utf-8"), str(page.relative_to(ROOT)))
    problems = [f"{line.where}: hil-forceps {line.text}: {problem}" for line in found if (problem := problem_of(line))]
    assert problems == []


def test_the_two_commands_of_the_readme_are_targets() -> None:
    makefile = (ROOT / "Makefile").read_text()
    named = set(re.findall(r"`?\bmake ([a-z]+)`", (ROOT / "README.md").read_text(encoding="utf-8")))
    assert {target for target in named if not re.search(rf"^{target}:", makefile, re.MULTILINE)} == set()


def test_the_makefile_calls_the_command_as_it_is() -> None:
    calls = [
        line.split("hil-forceps ", 1)[1]
        for line in (ROOT / "Makefile").read_text().splitlines()
        if "hil-forceps " in line
    ]
    assert len(calls) >= 2
    assert [problem_of(Line("Makefile", call.replace("$(OUT)", "out"), True)) for call in calls] == [""] * len(calls)


PAGE = """
Say `hil-forceps bench --config FILE --out DIR [--seed N]` or `hil-forceps benhc`, never `hil-forceps run --speed`.
`hil-forceps` is the command.

```sh
$ hil-forceps bench --config configs/paper.yaml \\
      --out out/paper --simulation 2   # a comment
hil-forceps decode out/bus.log | head -1
candump -L can0 | hil-forceps decode - --form jsonl > x
.venv/bin/hil-forceps drive --rig configs/paper.yaml --serial-pty /tmp/forceps &
hil-forceps run --rig configs/paper.yaml --out out --serial /tmp/forceps --speed 3
hil-forceps bench --config a --out b --simulation two
hil-forceps drive --rig a
hil-forceps: what it says when something is wrong
echo nothing of ours
```

    hil-forceps replay run.mcap
    hil-forceps replay run.mcap --speed 2
"""


def test_lines_are_found_and_the_wrong_ones_among_them() -> None:
    found = list(lines_of(PAGE, "page"))
    assert [line.where for line in found] == [f"page:{n}" for n in (2, 2, 2, 3, 6, 8, 9, 10, 11, 12, 13, 18, 19)]
    assert [bool(problem_of(line)) for line in found] == [
        False, True, True, False, False, False, False, False, True, True, True, False, True,
    ]  # fmt: skip
