"""Say which targets ran, and how it went.

python -m tools.targets.target_table [--root DIR] [--markdown FILE] [--figure FILE]: prints a row for each target; exit
code 1 when one has no outcome, failed, or could not run where HIL_FORCEPS_EXPECT_TARGETS wants it. --markdown also
writes figures and the matrix of targets and requirements, between the marks where the file has them. --figure draws the
times to no torque. Where the outcomes come from: tests/targets/record.py.
"""

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np

from tests.targets.record import TARGETS, State, is_expected, targets_root

MARKS = {"pass": "✓", "fail": "✗", "inconclusive": "?", "not run": "–"}
FIGURE_MS = (19.0, 26.0)
BINS = 140
SHOWN_WITHIN_MS = 22.0  # published 21 (HFP-120, HFP-123), and a sample period of 1 until a sample shows it
BEGIN, END = "<!-- targets: begin -->\n", "<!-- targets: end -->\n"
HEADER = (
    "target", "state", "passed", "failed", "incl.", "n/a", "RMSE µN·m", "direct", "p50 µs", "p99 µs",
    "no torque ms", "most", "s",
)  # fmt: skip


class Ran(NamedTuple):
    """What one target left behind; each is empty where there is nothing."""

    outcome: Mapping[str, Any]
    certificate: Mapping[str, Any]
    loop: Mapping[str, Any]
    torque_free: Mapping[str, Any]


def read(root: Path) -> dict[str, Ran]:
    """Return what stands below `root`, for each target that there is."""
    return {target: Ran(*(_load(root / target / f"{name}.json") for name in Ran._fields)) for target in TARGETS}


def problem(target: str, ran: Ran) -> str:
    """Say what is wrong with a target; empty when nothing is."""
    if not ran.outcome:
        return "no outcome: it was not run"
    state, reason = ran.outcome["state"], ran.outcome["reason"]
    if state == State.FAILED or (state == State.NOT_AVAILABLE and is_expected(target)):
        return f"{state}: {reason}"
    if state == State.NOT_AVAILABLE:
        return ""
    missing = [part for part in TARGETS[target].parts if part not in ran.outcome["parts"]]
    return f"not run: {', '.join(missing)}" if missing else ""


def row(target: str, ran: Ran) -> tuple[str, ...]:
    """Return a target's row of the table."""
    state = ran.outcome.get("state", "missing")
    if state == State.NOT_AVAILABLE:
        return (target, f"{state}: {ran.outcome['reason']}", *[""] * (len(HEADER) - 3), _number(ran.outcome, "seconds"))
    verdicts = ran.certificate.get("verdicts", {})
    latency = ran.loop.get("latency_us", {})
    times = ran.torque_free.get("times_ms", [])
    return (
        target,
        state,
        *(_number(verdicts, verdict) for verdict in MARKS),
        *(f"{ran.loop[key] * 1e6:.2f}" if key in ran.loop else "" for key in ("rmse_N_m", "in_process_rmse_N_m")),
        *(_number(latency, name) for name in ("p50", "p99")),
        *((f"{times[len(times) // 2]:.1f}", f"{times[-1]:.1f}") if times else ("", "")),
        _number(ran.outcome, "seconds"),
    )


def table(rows: Sequence[Sequence[str]]) -> str:
    """Return rows as aligned text, numbers to the right."""
    widths = [max(len(line[i]) for line in rows) for i in range(len(HEADER))]
    aligned = [
        "  ".join(line[i].ljust(width) if i < 2 else line[i].rjust(width) for i, width in enumerate(widths))
        for line in rows
    ]
    return "\n".join(line.rstrip() for line in aligned)


def figures(targets: Mapping[str, Ran]) -> str:
    """Return the rows of the targets that left a certificate as Markdown."""
    rows = [row(target, ran) for target, ran in targets.items() if ran.certificate]
    lines = ["| " + " | ".join(HEADER) + " |", "|---|---|" + "--:|" * (len(HEADER) - 2)]
    return "\n".join([*lines, *("| " + " | ".join(each) + " |" for each in rows)]) + "\n"


def publish(page: Path, text: str) -> None:
    """Write the text between the marks of a page; over the whole of it where it has none."""
    before, begin, rest = page.read_text(encoding="utf-8").partition(BEGIN) if page.exists() else ("", "", "")
    if not begin:
        page.write_text(text, encoding="utf-8")
        return
    _, end, after = rest.partition(END)
    if not end:
        raise SystemExit(f"{page}: {BEGIN.strip()} without {END.strip()}")
    page.write_text(before + begin + text + end + after, encoding="utf-8")


def matrix(targets: Mapping[str, Ran]) -> str:
    """Return targets against requirements as Markdown; only what some certificate speaks of."""
    verdicts = {
        target: {each["id"]: each["verdict"] for each in ran.certificate["requirements"]}
        for target, ran in targets.items()
        if ran.certificate
    }
    requirements = sorted({name for judged in verdicts.values() for name in judged})
    lines = ["| requirement | " + " | ".join(verdicts) + " |", "|---|" + ":-:|" * len(verdicts)]
    for name in requirements:
        marks = (MARKS[judged[name]] if name in judged else "" for judged in verdicts.values())
        lines.append(f"| {name} | " + " | ".join(marks) + " |")
    return "\n".join(lines) + "\n\n" + ", ".join(f"{mark} {verdict}" for verdict, mark in MARKS.items()) + "\n"


def draw(targets: Mapping[str, Ran], path: Path) -> None:
    """Draw the histograms of the times to no torque; SystemExit where no target has any."""
    measured = {target: ran.torque_free for target, ran in targets.items() if ran.torque_free}
    if not measured:
        raise SystemExit("no target has times to no torque")
    size = (7.0, 0.5 * len(measured) + 1.1)
    figure, panels = plt.subplots(len(measured), 1, figsize=size, layout="constrained", sharex=True, squeeze=False)
    for panel, (target, result) in zip(panels[:, 0], measured.items(), strict=True):
        shown = np.clip(result["times_ms"], FIGURE_MS[0], FIGURE_MS[1])
        panel.hist(shown, bins=BINS, range=FIGURE_MS, color="tab:blue")
        panel.axvline(SHOWN_WITHIN_MS, color="tab:red", linewidth=1.0)
        panel.set_ylabel(target, rotation=0, ha="right", va="center", fontsize=8)
        panel.set_yticks([])
    title = "from the last reference until a sample without torque arrives; red: 21 ms and a sample period"
    figure.suptitle(title, fontsize=9)
    panels[-1, 0].set_xlabel(f"ms (the last bin: {FIGURE_MS[1]:g} ms and more)")
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--root", type=Path, default=targets_root(), help="folder with a folder for each target")
    parser.add_argument("--markdown", type=Path, help="page for figures and matrix")
    parser.add_argument("--figure", type=Path, help="PNG for the times to no torque")
    chosen = parser.parse_args(arguments)
    targets = read(chosen.root)
    print(table([HEADER, *(row(target, ran) for target, ran in targets.items())]))
    if chosen.markdown is not None:
        publish(chosen.markdown, figures(targets) + "\n" + matrix(targets))
    if chosen.figure is not None:
        draw(targets, chosen.figure)
    problems = {target: text for target, ran in targets.items() if (text := problem(target, ran))}
    for target, text in problems.items():
        print(f"{target}: {text}")
    return 1 if problems else 0


def _load(path: Path) -> Mapping[str, Any]:
    content: Mapping[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    return content


def _number(of: Mapping[str, Any], name: str) -> str:
    return f"{of[name]:g}" if name in of else ""


if __name__ == "__main__":
    sys.exit(main())
