"""Explanation of a run: its events, what ended it, the last samples, likely causes; as text and as JSON."""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from firmware_protocol.messages import DriveState
from hil_forceps.bench.explanation.causes import Cause, causes_of
from hil_forceps.bench.explanation.events import Event, events_of
from hil_forceps.bench.explanation.evidence import Evidence
from hil_forceps.bridge.fault import compared
from hil_forceps.data.recording.reader import Table

LAST_ROWS = 8
MIN_LEFT_OUT_INTERVALS = 4.5  # median intervals between two rows above which the table shows an ellipsis
MAX_TOLD_EVENTS = 40  # of more events, the first and the last are shown
FIRST_EVENTS = 12
START = "the start of the run, when the service began to look for the drive"
FIRST_MESSAGE = "the first recorded message; the start of the run is not recorded"
COLUMNS = ("time_s", "theta_m_rad", "current_A", "requested_rad", "passed_rad", "verdict", "state")


class Story(NamedTuple):
    """The content of `explain`."""

    name: str
    notes: tuple[str, ...]
    events: list[Event]
    reason: str
    message: str
    has_trip: bool  # a check of the gate ended the run
    compared: str  # the failed check, with value and limit; empty if nothing was compared
    ended_s: float
    counted_from: str  # origin of all times here
    rows: list[dict[str, Any]]
    causes: list[Cause]


def story_of(evidence: Evidence) -> Story:
    """Return the explanation of a run."""
    events = events_of(evidence)
    return Story(
        evidence.name,
        evidence.notes,
        events,
        evidence.reason,
        evidence.message,
        evidence.gate_trip_ns is not None,
        _compared(evidence),
        evidence.time_s(evidence.ended_ns),
        START if evidence.stages else FIRST_MESSAGE,
        last_rows(evidence),
        causes_of(evidence, events),
    )


def last_rows(evidence: Evidence) -> list[dict[str, Any]]:
    """Return the last samples up to the end, each with the reference computed from it, or None without one."""
    samples = _last_samples(evidence)
    references = evidence.references
    rows = []
    for sample in samples:
        own = references[references["stamp_ns"] == sample["stamp_ns"]]
        reference = own[0] if len(own) else None
        code = None if reference is None else int(reference["verdict"])
        rows.append(
            {
                "time_s": round(evidence.time_s(int(sample["received_ns"])), 6),
                "theta_m_rad": _finite(sample["theta_m_rad"]),
                "current_A": _finite(sample["current_A"]),
                "requested_rad": None if reference is None else _finite(reference["requested_rad"]),
                "passed_rad": None if reference is None else _finite(reference["passed_rad"]),
                "verdict": None if code is None else evidence.verdicts.get(code, str(code)),
                "state": _state(int(sample["state"])),
            }
        )
    return rows


def _last_samples(evidence: Evidence) -> Table:
    """Return the last samples; if a check of the gate failed before them, first the samples around that time."""
    samples = evidence.samples[evidence.samples["received_ns"] <= evidence.ended_ns]
    last = len(samples)
    trip = last if evidence.gate_trip_ns is None else np.searchsorted(samples["received_ns"], evidence.gate_trip_ns)
    if trip >= last - LAST_ROWS:
        return samples[-LAST_ROWS:]
    half = LAST_ROWS // 2
    return np.concatenate([samples[max(0, trip - half + 1) : trip + 2], samples[-half:]])


def text_of(story: Story) -> Iterator[str]:
    """Yield the lines; unprintable characters, which could control a terminal, become question marks."""
    for line in _lines(story):
        yield "".join(character if character.isprintable() else "?" for character in line)


def _lines(story: Story) -> Iterator[str]:
    yield f"{story.name}: {_headline(story)}"
    yield from (f"note: {note}" for note in story.notes)
    yield ""
    yield f"Events (time in s since {story.counted_from})"
    yield from (f"  {line}" for line in _told_events(story.events))
    yield ""
    yield "End"
    yield f"  {story.ended_s:9.3f}  {story.message or 'not recorded'}"
    if story.compared:
        yield f"             {story.compared}"
    if story.rows:
        yield ""
        around = "The samples around the failed check, and the last samples" if story.has_trip else "The last samples"
        yield f"{around}, with the reference computed from each"
        yield from (f"  {line}" for line in _table(story.rows))
    if story.causes:
        yield ""
        yield "Likely causes, the most likely first, and what to check"
        for number, (cause, check) in enumerate(story.causes, 1):
            yield f"  {number}. {cause}"
            yield f"     check: {check}"


def json_of(story: Story) -> dict[str, Any]:
    """Return the explanation for JSON."""
    return {
        **story._asdict(),
        "notes": list(story.notes),
        "events": [event._asdict() for event in story.events],
        "causes": [cause._asdict() for cause in story.causes],
    }


def _headline(story: Story) -> str:
    if not story.reason:
        return "its end is not recorded"
    if story.reason in {"completed", "stop_requested"}:
        return f"ended normally: {story.reason.replace('_', ' ')}"
    return f"ended with a fault: {story.reason.replace('_', ' ')}"


def _told_events(events: list[Event]) -> Iterator[str]:
    left_out = len(events) - MAX_TOLD_EVENTS
    for place, event in enumerate(events):
        if left_out > 0 and FIRST_EVENTS <= place < FIRST_EVENTS + left_out:
            if place == FIRST_EVENTS:
                yield f"           {left_out} more, shown with --json"
            continue
        yield f"{event.time_s:9.3f}  {event.text}"


def _table(rows: list[dict[str, Any]]) -> Iterator[str]:
    yield f"{'time s':>9}  {'θ_m rad':>10}  {'current A':>10}  {'asked rad':>10}  {'passed rad':>10}  verdict / drive"
    usual_s = float(np.median(np.diff([row["time_s"] for row in rows]))) if len(rows) > 1 else math.inf
    before_s = math.inf
    for row in rows:
        if row["time_s"] - before_s > MIN_LEFT_OUT_INTERVALS * usual_s:
            yield f"{'...':>9}"
        before_s = row["time_s"]
        numbers = "  ".join(
            f"{'–':>10}" if row[name] is None else f"{row[name]:10.5f}"
            for name in ("theta_m_rad", "current_A", "requested_rad", "passed_rad")
        )
        yield f"{row['time_s']:9.4f}  {numbers}  {row['verdict'] or 'no reference'} / {row['state']}"


def _compared(evidence: Evidence) -> str:
    fault = evidence.fault or {}
    value, limit = fault.get("value"), fault.get("limit")
    if not isinstance(value, int | float) or not isinstance(limit, int | float):
        return ""
    return compared(evidence.reason, fault["check"], value, limit, fault.get("unit", ""))


def _finite(value: np.floating[Any]) -> float | None:
    return float(value) if math.isfinite(value) else None


def _state(state: int) -> str:
    return DriveState(state).name if state in set(DriveState) else str(state)
