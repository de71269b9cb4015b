"""All parameters of an instrument under one rate of false alarms: each is tested at its share (Bonferroni)."""

import zlib
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from hil_forceps.drift.change_test import FEWEST_SESSIONS
from hil_forceps.drift.result import InstrumentTrend, ParameterChange, ParameterTrend, Verdict, When
from hil_forceps.drift.series import Followed, FoundChange, follow

Mapper = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]


class Estimated(NamedTuple):
    """A parameter in those sessions of an instrument that measure it, in their order."""

    name: str
    unit: str
    assumed: float
    sessions: tuple[When, ...]
    values: tuple[float, ...]
    deviations: tuple[float, ...]


class _Task(NamedTuple):
    parameter: Estimated
    rate: float
    seed: tuple[int, ...]


def instrument_trend(
    name: str, parameters: Sequence[Estimated], false_alarms: float, seed: int, mapper: Mapper = map
) -> InstrumentTrend:
    """Return what became of an instrument's parameters.

    `false_alarms`: how often an instrument that doesn't change is said to. `mapper` may work in other processes.
    """
    tested = sum(len(each.sessions) >= FEWEST_SESSIONS for each in parameters)
    rate = false_alarms / max(tested, 1)
    tasks = [
        _Task(each, rate, (seed, zlib.crc32(name.encode()), zlib.crc32(each.name.encode()))) for each in parameters
    ]
    return InstrumentTrend(name, tuple(mapper(_followed, tasks)))


def _followed(task: _Task) -> ParameterTrend:
    p = task.parameter
    values, deviations = np.array(p.values), np.array(p.deviations)
    # In units of the usual value: a torque of friction squared is next to nothing in SI.
    unit = float(np.median(np.abs(values))) or 1.0
    found = follow(values / unit, deviations / unit, task.rate, np.random.default_rng(task.seed))
    verdict: Verdict = "too few" if np.isnan(found.p_value) else "changes" if found.changes else "steady"
    return ParameterTrend(
        p.name,
        p.unit,
        p.assumed,
        verdict,
        p.sessions,
        values,
        deviations,
        unit * found.level,
        unit * found.level_sd,
        unit * found.scatter.deviation,
        found.scatter.correlation,
        found.p_value,
        tuple(_change(p, found, change, unit) for change in found.changes),
        tuple(p.sessions[place].session for place in found.apart),
    )


def _change(p: Estimated, found: Followed, change: FoundChange, unit: float) -> ParameterChange:
    likeliest, low, high = (p.sessions[place] for place in change.onset)
    before = unit * float(found.level[max(change.onset.likeliest - 1, 0)])
    size, size_sd, total, total_sd = (unit * v for v in (change.size, change.size_sd, change.total, change.total_sd))
    return ParameterChange(change.kind, likeliest, low, high, size, size_sd, total, total_sd, before, change.p_value)
