"""The reference of the command line, out of what the program tells of itself."""

import re
from argparse import HelpFormatter
from collections.abc import Iterator
from typing import Any

from hil_forceps.cli.examples import EXAMPLES
from hil_forceps.cli.main import app
from virtual_bus.realtime.process import _parser as drive_parser

HEAD = """# Command line

What `hil-forceps COMMAND --help` says, of each command. Options of a table may stand in any order. With `--quiet`
nothing but errors goes to standard error.

Exit codes: 0 all well; 1 the answer is no (a replay that differs, frames that can't be decoded); 2 one clear line on
what is wrong and what to do; 130 interrupted.
"""


def page() -> str:
    """Return the page in Markdown."""
    return "\n".join((HEAD, *(part for name in EXAMPLES for part in _of_command(name))))


def _of_command(name: str) -> Iterator[str]:
    yield f"## {name}\n"
    if name == "drive":
        yield f"{app[name].help}\n\n```text\n{_drive_help()}\n```\n"
    else:
        yield _told_by_cyclopts(name)
    yield f"Example:\n\n```sh\n{EXAMPLES[name]}\n```\n"


def _drive_help() -> str:
    parser = drive_parser()
    parser.formatter_class = lambda prog: HelpFormatter(prog, width=96)
    return parser.format_help().strip()


def _told_by_cyclopts(name: str) -> str:
    """Return usage, docstring and options: headings of groups one level below the command's."""
    command: Any = app[name]
    short, command.help = command.help, None  # all of its docstring, as its own --help shows it
    epilogue, command.help_epilogue = command.help_epilogue, None
    try:
        text = command.generate_docs(recursive=False, heading_level=2, usage_name=f"hil-forceps {name}")
    finally:
        command.help, command.help_epilogue = short, epilogue
    text = re.sub(r"^#+ .*\n", "", text, count=1)
    text = re.sub(r"^\*\*(.+?)\*\*:$", rf"### \1 (`{name}`)", text, flags=re.MULTILINE)
    text = re.sub(r", --empty-[\w-]+|, --no-[\w-]+(?=`)| \*\[default: (?:\(\)|\"\"|False)\]\*", "", text)
    return re.sub(r"\(docs/([a-z-]+)\.md\)", r"([\1](\1.md))", text)
