"""Grids of panels laid out in millimetres.

matplotlib's layout engine measures every text several times, which takes longer than drawing; here the space for labels
is fixed, and y labels are aligned.
"""

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hil_forceps.report.style import DOUBLE_COLUMN, MM, panel_letter

LETTERS = "abcdefghijklmnopqrstuvwxyz"
LABEL_MM = 8.0  # from an axis to its label: five digits and a sign
LEFT_MM = 17.5  # two lines of label left of that
TOP_MM = 12.0  # legend and titles
BOTTOM_MM = 9.5
RIGHT_MM = 2.5

Share = bool | Literal["none", "all", "row", "col"]


class Panels(NamedTuple):
    """A figure and its axes [row, column]."""

    figure: Figure
    axes: list[list[Axes]]

    def flat(self) -> list[Axes]:
        """Return the axes row by row."""
        return [axes for row in self.axes for axes in row]

    def column(self, place: int) -> list[Axes]:
        """Return the axes of a column from the top."""
        return [row[place] for row in self.axes]


def panels(
    heights_mm: Sequence[float],
    columns: int = 1,
    *,
    widths: Sequence[float] | None = None,
    left_mm: float = LEFT_MM,
    gap_x_mm: float = 12.0,
    gap_y_mm: float = 3.5,
    sharex: Share = False,
    sharey: Share = False,
) -> Panels:
    """Make a figure as wide as a page with panels of the given heights; panels of a column share its width."""
    rows = len(heights_mm)
    width_mm = DOUBLE_COLUMN / MM
    height_mm = TOP_MM + sum(heights_mm) + gap_y_mm * (rows - 1) + BOTTOM_MM
    inner_mm = width_mm - left_mm - RIGHT_MM - gap_x_mm * (columns - 1)
    figure = Figure(figsize=(DOUBLE_COLUMN, height_mm * MM))
    grid = figure.add_gridspec(
        rows,
        columns,
        left=left_mm / width_mm,
        right=1 - RIGHT_MM / width_mm,
        top=1 - TOP_MM / height_mm,
        bottom=BOTTOM_MM / height_mm,
        height_ratios=heights_mm,
        width_ratios=widths or [1.0] * columns,
        hspace=gap_y_mm * rows / sum(heights_mm),
        wspace=gap_x_mm * columns / inner_mm,
    )
    made: Any = grid.subplots(sharex=sharex, sharey=sharey, squeeze=False)
    parts = [part / sum(widths or [1.0] * columns) for part in (widths or [1.0] * columns)]
    for row in made:
        for axes, part in zip(row, parts, strict=True):
            axes.yaxis.set_label_coords(-LABEL_MM / (inner_mm * part), 0.5)
            axes.locator_params(axis="both", nbins=5)
    return Panels(figure, [list(row) for row in made])


def letters(found: Sequence[Axes]) -> None:
    """Letter panels in order."""
    for axes, letter in zip(found, LETTERS, strict=False):
        panel_letter(axes, letter)


def legend(figure: Figure, *first: Axes) -> None:
    """Put one legend for all panels on top, beginning with the entries of `first`."""
    found: dict[str, Artist] = {}
    for axes in (*first, *figure.axes):
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    if not found:
        return
    place: Literal["upper center", "outside upper center"]
    place = "upper center" if figure.get_layout_engine() is None else "outside upper center"
    figure.legend(list(found.values()), list(found), loc=place, ncols=min(len(found), 6))
