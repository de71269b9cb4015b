"""Table of verdicts and progress line of the two conformance suites."""

import sys
from collections.abc import Callable, Sequence
from typing import Final

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from firmware_protocol.conformance.report import Verdicted
from firmware_protocol.conformance.suite import NEEDS_MOTION, Verdict
from hil_forceps.cli.terminal.notes import is_quiet
from hil_forceps.cli.terminal.tables import print_table

MINIMUM_WIDTH: Final = 120
_STYLES: Final = {
    Verdict.PASS: "green",
    Verdict.FAIL: "bold red",
    Verdict.INCONCLUSIVE: "yellow",
    Verdict.NOT_RUN: "dim",
}


def progress(total: int) -> Callable[[str], None]:
    """Return a function that shows progress: one line that is overwritten on a terminal, nothing elsewhere."""
    if is_quiet() or not sys.stderr.isatty():
        return lambda _: None
    done = 0

    def show(name: str) -> None:
        nonlocal done
        done += 1
        sys.stderr.write(f"\r\x1b[K{done}/{total} {name}" if done < total else "\r\x1b[K")
        sys.stderr.flush()

    return show


def print_verdicts(title: str, what: str, results: Sequence[Verdicted]) -> None:
    """Print a table of verdicts, the checks that don't apply by reason, and counts; `what` heads the first column."""
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1))
    table.add_column(what, no_wrap=True)
    table.add_column("verdict", no_wrap=True)
    table.add_column("property", overflow="fold", max_width=46)
    table.add_column("evidence", overflow="fold")
    for result in (r for r in results if r.applies):
        name = result.requirement.name + ("" if result.requirement.level == "MUST" else " (SHOULD)")
        verdict = Text(result.verdict, _STYLES[result.verdict])
        table.add_row(name, verdict, result.requirement.title, Text(result.evidence))
    print_table(table, MINIMUM_WIDTH)
    reasons: dict[str, list[str]] = {}
    for result in (r for r in results if not r.applies):
        reasons.setdefault(result.evidence, []).append(result.requirement.name)
    for reason, names in reasons.items():
        sys.stdout.write(f"not run, {reason}: {', '.join(names)}\n")
    sys.stdout.write(_summary(results) + "\n")


def _summary(results: Sequence[Verdicted]) -> str:
    counts = ", ".join(f"{n} {v}" for v in Verdict if (n := sum(r.verdict is v for r in results)))
    unmoved = sum(r.verdict is Verdict.NOT_RUN and NEEDS_MOTION in r.evidence for r in results)
    return counts + (f"; {unmoved} not run, because they need --allow-motion" if unmoved else "")
