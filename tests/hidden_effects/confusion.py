"""What was hidden against what was named, as counts and as a figure."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from hil_forceps.rig.catalogue import EFFECT_IDS

OTHERS = ("several", "unnamed", "parameters", "consistent", "undetermined", "crash")
NOTHING = {"none": "no effect", "shift": "shift only"}
Counts = NDArray[np.intp]


def confusion(records: Sequence[dict[str, Any]]) -> tuple[list[str], list[str], Counts]:
    """Return names of rows (hidden), of columns (said), and counts of cases with one effect or none."""
    rows = [*EFFECT_IDS, *NOTHING.values()]
    columns = [*EFFECT_IDS, *OTHERS]
    counts = np.zeros((len(rows), len(columns)), dtype=np.intp)
    for record in records:
        row = NOTHING.get(record["kind"]) or record["truth"][0]
        counts[rows.index(row), columns.index(_said(record))] += 1
    return rows, columns, counts


def _said(record: dict[str, Any]) -> str:
    if "error" in record:
        return "crash"
    if record["verdict"] != "effects":
        return str(record["verdict"])
    return str(record["named"][0]) if len(record["named"]) == 1 else "several"


def draw(rows: Sequence[str], columns: Sequence[str], counts: Counts, path: Path) -> None:
    """Draw the matrix: shades are shares of a row, numbers are counts."""
    figure = Figure(figsize=(13.0, 11.0), layout="constrained")
    axes = figure.add_subplot()
    totals = np.maximum(counts.sum(axis=1, keepdims=True), 1)
    axes.imshow(counts / totals, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    axes.set_xticks(range(len(columns)), columns, rotation=90)
    axes.set_yticks(range(len(rows)), rows)
    axes.set_xlabel("said")
    axes.set_ylabel("hidden")
    for row, column in zip(*np.nonzero(counts), strict=True):
        dark = counts[row, column] > 0.5 * totals[row, 0]
        colour = "white" if dark else "black"
        axes.text(column, row, str(counts[row, column]), ha="center", va="center", color=colour, fontsize=8)
    figure.savefig(path, dpi=110)
