"""Excerpts of long runs: time and memory are bounded, whatever their length."""

from collections.abc import Sequence

import numpy as np

from hil_forceps.audit.finding import Finding
from hil_forceps.data.even_rows import EvenRun

MAX_ROWS = 120_000  # of all runs together: some 1.2 GB
EXCERPT_ROWS = 10_000  # long against all that a plant forgets, short enough for many of them


def excerpts(runs: Sequence[EvenRun]) -> tuple[list[EvenRun], list[Finding]]:
    """Return runs, the longest in excerpts where all together are too long; and what was left out.

    Excerpts are spread evenly over their run, from its beginning to its end, and named by the second they begin at.
    """
    most = _longest([even.lost.size for even in runs])
    found: list[EvenRun] = []
    said: list[Finding] = []
    for even in runs:
        rows = even.lost.size
        if rows <= most:
            found.append(even)
            continue
        count = max(1, most // EXCERPT_ROWS)
        length = min(most, EXCERPT_ROWS)
        firsts = np.linspace(0, rows - length, count).astype(int)
        found += [even.part(int(first), int(first) + length) for first in firsts]
        text = (
            f"{count} excerpts of {length} rows each are used, {100.0 * count * length / rows:.2g} % of its {rows} rows"
        )
        said.append(Finding("excerpts", "note", even.name, "", text))
    return found, said


def _longest(rows: Sequence[int]) -> int:
    """Return how many rows of a run are used, so that all together are no more than `MAX_ROWS`."""
    left, share = MAX_ROWS, 0
    for place, count in enumerate(sorted(rows)):
        share = left // (len(rows) - place)
        if count > share:
            return share
        left -= count
    return max(rows)
