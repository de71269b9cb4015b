"""Runs on equally spaced rows: lost ones are filled, and marked, for the drive's law goes on through them.

At a gap that is too long for that a run is cut; each piece begins anew. What is filled is no measurement.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.data.run import Run
from hil_forceps.rig import Rig

Mask = NDArray[np.bool_]

MAX_STAMP_SPREAD_ROWS = 0.02  # of a row: stamps that vary by more are no equally spaced rows
MAX_LOST_SHARE = 0.1  # of the rows
MAX_GAP_ROWS = 20  # rows: over a longer one the law's memory is worth nothing
MIN_ROWS = 50  # of a run, or of a piece of one, that is diagnosed


class EvenRun(NamedTuple):
    """A run with equally spaced rows."""

    run: Run
    lost: Mask  # n: rows that were filled
    begin_s: float = 0.0  # of a part, after the run's first row
    of: str = ""  # name of the run that it is a part of

    @property
    def name(self) -> str:
        """Name of the run."""
        return self.run.name

    @classmethod
    def whole(cls, run: Run) -> "EvenRun":
        """Return a run whose rows are equally spaced already, none of them lost."""
        return cls(run, np.zeros(len(run), dtype=np.bool_))

    def part(self, first: int, behind: int) -> "EvenRun":
        """Return the rows from `first` to `behind`, named by the second they begin at."""
        of = self.of or self.name
        run, begin_s = _part(self.run, first, behind, of, self.begin_s)
        return EvenRun(run, self.lost[first:behind], begin_s, of)


def _part(run: Run, first: int, behind: int, of: str, begin_s: float) -> tuple[Run, float]:
    """Return rows of a run that itself begins at `begin_s`, named by the second they begin at; and that second."""
    columns = {name: values[first:behind] for name, values in run.columns.items()}
    begin_s += float(columns["time_s"][0] - run.columns["time_s"][0])
    return Run(f"{of} from {begin_s:.2f} s", columns, run.notes), begin_s


def even_pieces(run: Run, rig: Rig) -> list[EvenRun]:
    """Return a run on equally spaced rows, in pieces where gaps are too long to be filled.

    Pieces of fewer than `MIN_ROWS` rows are left out. Empty where a piece's stamps vary, or too many rows are lost.
    """
    time_s = run.columns["time_s"]
    if time_s.size < 2:
        return []
    intervals = np.diff(time_s)
    edges = np.flatnonzero(intervals > (MAX_GAP_ROWS + 0.5) * float(np.median(intervals))) + 1
    if not edges.size:
        even = even_rows(run, rig)
        return [even] if even is not None else []
    found = []
    for first, behind in zip((0, *edges), (*edges, time_s.size), strict=True):
        if behind - first < MIN_ROWS:
            continue
        piece, begin_s = _part(run, first, behind, run.name, 0.0)
        even = even_rows(piece, rig)
        if even is None:
            return []
        found.append(even._replace(begin_s=begin_s, of=run.name))
    return found


def even_rows(run: Run, rig: Rig) -> EvenRun | None:
    """Return a run on equally spaced rows; None where its stamps vary, or too many rows are lost."""
    time_s = run.columns["time_s"]
    if time_s.size < 2:
        return None
    intervals = np.diff(time_s)
    period_s = float(np.median(intervals))
    if rig.drive is not None:
        samples = round(period_s / rig.drive.sample_time_s)
        if samples > 0 and math.isclose(samples * rig.drive.sample_time_s, period_s, rel_tol=MAX_STAMP_SPREAD_ROWS):
            period_s = samples * rig.drive.sample_time_s  # stamps are printed with few digits
    steps = np.rint(intervals / period_s).astype(np.intp)
    if np.any(steps < 1) or steps.max() > MAX_GAP_ROWS:
        return None
    rows = np.concatenate(([0], np.cumsum(steps)))
    count = int(rows[-1]) + 1
    # A clock that runs a little fast or slow is no jitter: rows are spaced by what it says on the whole.
    spacing = float(time_s[-1] - time_s[0]) / (count - 1)
    even = time_s[0] + spacing * np.arange(count)
    if (
        count > (1.0 + MAX_LOST_SHARE) * time_s.size
        or np.max(np.abs(time_s - even[rows])) > MAX_STAMP_SPREAD_ROWS * spacing * steps.max()
    ):
        return None
    lost = np.ones(count, dtype=np.bool_)
    lost[rows] = False
    columns = {name: np.interp(even, time_s, values) for name, values in run.columns.items() if name != "time_s"}
    counts = rig.encoder.counts_per_rev
    if counts is not None:
        quantum = 2.0 * math.pi / counts
        columns["theta_m_rad"][lost] = np.rint(columns["theta_m_rad"][lost] / quantum) * quantum
    return EvenRun(Run(run.name, {"time_s": even, **columns}, run.notes), lost)
