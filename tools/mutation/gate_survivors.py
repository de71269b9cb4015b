"""Which mutants of the gate survived its tests, and whether docs/safety-gate.md explains each; behind `mutmut run`.

    python -m tools.mutation.gate_survivors

Exit code 1 where one is not explained: its changed line has to stand there, in backquotes.
"""

import subprocess
import sys
from collections import Counter
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "safety-gate.md"
FOUND = ("killed", "timeout", "caught by type check", "segfault")  # what counts as found by the tests


def told_by(*arguments: str) -> str:
    """Return what mutmut prints."""
    command = [sys.executable, "-m", "mutmut", *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def changed_line(mutant: str) -> str:
    """Return the line that a mutant has in place of the gate's, or the line that it lacks."""
    lines = told_by("show", mutant).splitlines()
    new = [line[1:].strip() for line in lines if line.startswith("+") and not line.startswith("+++")]
    return new[0].partition("  # ")[0] if new else ""


def main() -> int:
    """Print the score and the survivors."""
    results = dict(
        line.strip().rsplit(": ", 1) for line in told_by("results", "--all", "true").splitlines() if ": " in line
    )
    counts = Counter(results.values())
    found = sum(counts[each] for each in FOUND)
    print(f"{found} of {len(results)} mutants found: {dict(counts)}")
    page, unexplained = PAGE.read_text(encoding="utf-8"), 0
    for mutant, outcome in results.items():
        if outcome not in FOUND:
            line = changed_line(mutant)
            is_known = bool(line) and f"`{line}`" in page
            unexplained += not is_known
            print(f"{outcome}{', explained' if is_known else ''}: {mutant.rpartition('.')[2]}: {line}")
    return 1 if unexplained or not results else 0


if __name__ == "__main__":
    sys.exit(main())
