"""What was found over sessions, as plain data: `to_json` gives `trend.json`. Dates are ISO 8601, in UTC."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.result import TWO_SIDED_95, plain
from hil_forceps.drift.change_test import Kind
from hil_forceps.drift.words import behind, name_of

Vector = NDArray[np.float64]
Verdict = Literal["steady", "changes", "too few"]
SCHEMA = 1


@dataclass(frozen=True, slots=True)
class SessionLine:
    """A session: when it was, who says so, and why it was not used where it wasn't."""

    name: str
    instrument: str
    date: str | None
    date_from: str  # "table", "recording", "name", "file", or "" where none is known
    reason: str | None  # None where it is used
    notes: str | None = None


@dataclass(frozen=True, slots=True)
class When:
    """A session that a change is told by."""

    session: str
    date: str


@dataclass(frozen=True, slots=True)
class ParameterChange:
    """A change of a parameter."""

    kind: Kind
    onset: When  # the first session that it touches
    low: When  # 95 % interval of that
    high: When
    size: float  # of a step; of a slope, by session
    size_sd: float
    total: float  # until the last session
    total_sd: float
    before: float  # the level at the session before it
    p_value: float

    @property
    def direction(self) -> Literal["rises", "falls"]:
        """Which way."""
        return "rises" if self.size > 0.0 else "falls"


@dataclass(frozen=True, slots=True, eq=False)
class ParameterTrend:
    """A parameter of an instrument over its n sessions that measure it."""

    name: str  # dotted, as a rig file has it
    unit: str
    assumed: float
    verdict: Verdict
    sessions: tuple[When, ...]  # n
    values: Vector  # n
    deviations: Vector  # n: of each session's own error
    level: Vector  # n: without the scatter between sessions
    level_sd: Vector  # n
    scatter: float  # deviation of a change from session to session, beyond the sessions' own errors
    correlation: float  # of the scatter, from one session to the next
    p_value: float  # of no change at all; NaN for too few sessions
    changes: tuple[ParameterChange, ...]
    apart: tuple[str, ...]  # sessions that lie apart from all others

    def sentences(self) -> tuple[str, ...]:
        """Return the changes in words."""
        return tuple(_sentence(self, change) for change in self.changes)


@dataclass(frozen=True, slots=True, eq=False)
class InstrumentTrend:
    """An instrument over its sessions."""

    name: str
    parameters: tuple[ParameterTrend, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Trend:
    """All instruments of a folder."""

    instruments: tuple[InstrumentTrend, ...]
    sessions: tuple[SessionLine, ...]
    false_alarms: float  # of an instrument, over all its sessions and parameters


def _sentence(trend: ParameterTrend, change: ParameterChange) -> str:
    share = f"{100.0 * change.total / change.before:+.3g} %" if change.before else f"{change.total:+.3g} {trend.unit}"
    if change.kind == "step":
        how = f"{change.direction} by {share} at {change.onset.session} ({change.onset.date[:10]})"
    else:
        how = (
            f"{change.direction} from {change.onset.session} ({change.onset.date[:10]}) on, by {share} until "
            f"{trend.sessions[-1].session}"
        )
    cause = behind(trend.name, change.direction)
    return f"{name_of(trend.name)} {how}" + (f"; usual causes: {cause}" if cause else "")


def to_json(trend: Trend) -> dict[str, Any]:
    """Return the content of `trend.json`; numbers that aren't finite become None."""
    return {
        "schema": SCHEMA,
        "false_alarms": trend.false_alarms,
        "instruments": [
            {"name": each.name, "parameters": [_parameter(parameter) for parameter in each.parameters]}
            for each in trend.instruments
        ],
        "sessions": [
            {
                "name": s.name,
                "instrument": s.instrument,
                "date": s.date,
                "date_from": s.date_from or None,
                "reason": s.reason,
                "notes": s.notes,
            }
            for s in trend.sessions
        ],
    }


def _parameter(p: ParameterTrend) -> dict[str, Any]:
    return {
        "name": p.name,
        "unit": p.unit,
        "assumed": plain(p.assumed),
        "verdict": p.verdict,
        "p_value": plain(p.p_value),
        "scatter": {"sd": plain(p.scatter), "correlation": plain(p.correlation)},
        "changes": [_change(change, text) for change, text in zip(p.changes, p.sentences(), strict=True)],
        "apart": list(p.apart),
        "sessions": [each.session for each in p.sessions],
        "dates": [each.date for each in p.sessions],
        "values": [plain(v) for v in p.values],
        "ci95": [_ci(v, sd) for v, sd in zip(p.values, p.deviations, strict=True)],
        "level": [plain(v) for v in p.level],
        "level_ci95": [_ci(v, sd) for v, sd in zip(p.level, p.level_sd, strict=True)],
    }


def _change(change: ParameterChange, text: str) -> dict[str, Any]:
    return {
        "sentence": text,
        "kind": change.kind,
        "direction": change.direction,
        "onset": {"session": change.onset.session, "date": change.onset.date},
        "onset_ci95": {
            "sessions": [change.low.session, change.high.session],
            "dates": [change.low.date, change.high.date],
        },
        "size": plain(change.size),
        "size_ci95": _ci(change.size, change.size_sd),
        "total": plain(change.total),
        "total_ci95": _ci(change.total, change.total_sd),
        "before": plain(change.before),
        "p_value": plain(change.p_value),
    }


def _ci(value: float, sd: float) -> list[float | None]:
    return [plain(value - TWO_SIDED_95 * sd), plain(value + TWO_SIDED_95 * sd)]
