"""A recording through the pipeline again: the same samples and tick times give the same references, byte for byte.

With the algorithm of the recording that is a proof (`first_difference` is None); with another it gives the estimates
that this one would have made of the same samples.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.host.machine import RawSample
from hil_forceps.bridge.pipeline import NOWHERE_NS, Pipeline
from hil_forceps.data.recording.format import REFERENCE, SAMPLE
from hil_forceps.data.recording.reader import Recording, Table

REFERENCE_FIELDS = (
    "stamp_ns",
    "trajectory_ns",
    "reference_raw",
    "theta_j_ref_rad",
    "elongation_used_m",
    "requested_rad",
    "passed_rad",
    "verdict",
    "sample_sequence",
)
ESTIMATE_FIELDS = ("tau_w_estimate_N_m", "elongation_estimate_m")


class Difference(NamedTuple):
    """Where a replay leaves its recording: row `row` of the topic, at `time_ns` of the host's clock."""

    topic: str
    row: int
    time_ns: int
    field: str
    recorded: float
    replayed: float

    def __str__(self) -> str:
        return (
            f"{self.topic} {self.row} at {self.time_ns / 1e9:.6f} s: {self.field} was {self.recorded!r}, "
            f"is {self.replayed!r}"
        )


class Replay(NamedTuple):
    """What came out. Tables have the rows of the recording; `first_difference` is in the order of time."""

    samples: Table
    references: Table
    first_difference: Difference | None


class RecordedReference:
    """References that came from outside, as they were recorded: what `replay` sets is in force for the next tick."""

    def __init__(self) -> None:
        self.theta_j_ref_rad = np.nan

    def __call__(self, _t_s: float) -> float:
        """Return the reference in force [rad]."""
        return self.theta_j_ref_rad


def replay(recording: Recording, pipeline: Pipeline, outside: RecordedReference | None = None) -> Replay:
    """Feed a fresh pipeline with what the recording holds, in its order.

    `outside`: what the pipeline takes its references from, where the run had them from outside.
    """
    wanted = recording.references["theta_j_ref_rad"].tolist()
    samples, references = recording.samples.copy(), recording.references.copy()
    raws = [RawSample(*row) for row in recording.samples[list(_raw_columns())].tolist()]
    tick_times = recording.references["tick_ns"].tolist()
    begin_ns = _begin_ns(recording.references)
    estimates: list[tuple[float, float]] = []
    rows: list[tuple[float, ...]] = []
    for channel in recording.order.tolist():
        if channel == SAMPLE.channel:
            raw_sample = raws[len(estimates)]
            pipeline.is_waiting = begin_ns is None or raw_sample.stamp_ns < begin_ns
            is_taken = pipeline.feed(raw_sample)
            estimates.append(pipeline.estimate if is_taken else (np.nan, np.nan))
        elif channel == REFERENCE.channel:
            if outside is not None:
                outside.theta_j_ref_rad = wanted[len(rows)]
            reference = pipeline.reference(tick_times[len(rows)])
            raw = reference.reference_raw
            rows.append((*reference[1:3], 0 if raw is None else raw, *reference[4:]))
    for field, column in zip(ESTIMATE_FIELDS, _columns(estimates, len(ESTIMATE_FIELDS)), strict=True):
        samples[field] = column
    for field, values in zip(REFERENCE_FIELDS, zip(*rows, strict=True), strict=bool(rows)):
        references[field] = values
    found = [
        _first(recording.samples, samples, ESTIMATE_FIELDS, "received_ns", SAMPLE.topic),
        _first(recording.references, references, REFERENCE_FIELDS, "tick_ns", REFERENCE.topic),
    ]
    differences = [difference for difference in found if difference is not None]
    return Replay(samples, references, min(differences, key=lambda each: each.time_ns, default=None))


def _begin_ns(references: Table) -> int | None:
    """Return the stamp at which the trajectory began; None where it never did: other axes were waited for."""
    followed = references[references["trajectory_ns"] != NOWHERE_NS]
    return int(followed["stamp_ns"][0] - followed["trajectory_ns"][0]) if followed.size else None


def _raw_columns() -> tuple[str, ...]:
    names = {"theta_m": "theta_m_raw", "current": "current_raw"}
    return tuple(names.get(field, field) for field in RawSample._fields)


def _columns(rows: list[tuple[float, float]], width: int) -> NDArray[np.float64]:
    return np.array(rows, dtype=np.float64).reshape(-1, width).T


def _first(recorded: Table, replayed: Table, fields: tuple[str, ...], time: str, topic: str) -> Difference | None:
    """Return the earliest row whose bytes differ (so NaN equals NaN, and -0.0 is not 0.0)."""
    rows = {field: _differing(recorded[field], replayed[field]) for field in fields}
    row = min((int(each[0]) for each in rows.values() if each.size), default=None)
    if row is None:
        return None
    field = next(field for field in fields if row in rows[field])
    return Difference(
        topic, row, int(recorded[time][row]), field, recorded[field][row].item(), replayed[field][row].item()
    )


def _differing(a: NDArray[np.generic], b: NDArray[np.generic]) -> NDArray[np.intp]:
    bits = np.dtype(f"u{a.dtype.itemsize}")
    return np.flatnonzero(np.ascontiguousarray(a).view(bits) != np.ascontiguousarray(b).view(bits))
