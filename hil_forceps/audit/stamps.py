"""Audit of the time axis: gaps, jitter, drift, stamps that nearly repeat, and the rig's sample time."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hil_forceps.audit.finding import Finding, Severity, View
from hil_forceps.data.run import GAP_IN_INTERVALS, MAX_UNTOLD_JITTER_SHARE, WHOLE_MULTIPLE, Column, timing_notes
from hil_forceps.rig.schema import Rig

_MUCH_MISSING = 0.01  # of the rows: more costs accuracy
_MUCH_JITTER = 0.1  # of the usual interval: more costs accuracy
_ALMOST_REPEATED = 0.1  # of the usual interval
_DRIFT_WORTH_TELLING = 1e-4  # of the interval, over a run


def audit_stamps(view: View, rig: Rig | None) -> Iterator[Finding]:
    """Yield what the stamps of one run show."""
    intervals = np.diff(view.time_s)
    usual = view.interval_s
    is_gap = intervals > GAP_IN_INTERVALS * usual
    yield from _gaps(view, intervals, is_gap)
    regular = intervals[~is_gap]
    jitter = float(np.std(regular)) / usual
    if jitter > MAX_UNTOLD_JITTER_SHARE:
        text = f"the sample interval of {usual:.6g} s jitters by {100 * jitter:.2g} % (standard deviation)"
        severity: Severity = "warning" if jitter > _MUCH_JITTER else "note"
        yield view.finding("jitter", "time_s", severity, text)
    short = np.flatnonzero(intervals < _ALMOST_REPEATED * usual)
    if short.size:
        text = f"{short.size} stamps are almost equal to the one before, the first at {view.time_s[short[0] + 1]:.6g} s"
        yield view.finding("repeated_stamps", "time_s", "warning", text)
    yield from _drift(view, regular)
    yield from _rate(view, rig)
    known = set(timing_notes(view.time_s))
    for note in view.notes:
        if note not in known:
            yield view.finding("reader", "", "note", note)


def _gaps(view: View, intervals: Column, is_gap: NDArray[np.bool_]) -> Iterator[Finding]:
    gaps = np.flatnonzero(is_gap)
    if not gaps.size:
        return
    lost = float(np.sum(np.rint(intervals[gaps] / view.interval_s)) - gaps.size)
    longest = int(gaps[np.argmax(intervals[gaps])])
    share = lost / (lost + len(view))
    text = (
        f"{gaps.size} gap{'s' if gaps.size > 1 else ''}, about {lost:.0f} samples missing ({100 * share:.2g} %); "
        f"longest {intervals[longest]:.4g} s after {view.time_s[longest]:.6g} s"
    )
    yield view.finding("gaps", "time_s", "warning" if share > _MUCH_MISSING else "note", text)


def _drift(view: View, regular: Column) -> Iterator[Finding]:
    """Compare the mean interval of the first and the last third with what jitter alone would let them differ."""
    third = len(regular) // 3
    if third < 100:
        return
    first, last = regular[:third], regular[-third:]
    change = float((np.mean(last) - np.mean(first)) / view.interval_s)
    chance = float(np.hypot(np.std(first), np.std(last)) / np.sqrt(third) / view.interval_s)
    if abs(change) > max(_DRIFT_WORTH_TELLING, 6.0 * chance):
        text = f"the sample interval drifts by {100 * change:+.2g} % over the run: its clock is not even"
        yield view.finding("clock_drift", "time_s", "warning", text)


def _rate(view: View, rig: Rig | None) -> Iterator[Finding]:
    if rig is None or rig.drive is None:
        return
    ratio = view.interval_s / rig.drive.sample_time_s
    whole = max(round(ratio), 1)
    told = f"rows are {view.interval_s:.6g} s apart, samples of the rig's drive {rig.drive.sample_time_s:.6g} s"
    if abs(ratio - whole) > WHOLE_MULTIPLE * whole:
        text = f"{told}: no whole multiple; another unit of the stamps, another drive, or a resampled log"
        yield view.finding("sample_rate", "time_s", "problem", text)
    elif whole > 1:
        text = f"{told}: one row for {whole} samples"
        yield view.finding("sample_rate", "time_s", "note", text)
