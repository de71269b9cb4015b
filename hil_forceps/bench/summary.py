"""`summary.json` and `timing.json`: results of a bench for other programs."""

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.bench.matrix import RunSpec
from hil_forceps.bench.metrics import Metrics
from hil_forceps.report.traces import TimingTraces
from hil_forceps.rig import Rig


class RunRecord(NamedTuple):
    """One run: its spec, metrics and timing."""

    spec: RunSpec
    metrics: Metrics
    frames_sent: int
    frames_lost: int
    ending: str  # why the run ended, in words
    timing: dict[str, Any]  # everything that depends on the wall clock


def summary(records: list[RunRecord], seed: int) -> dict[str, Any]:
    """Return the content of `summary.json`; in virtual time no entry depends on the wall clock."""
    return {"runs": [_run(record) for record in records], "seed": seed}


def _run(record: RunRecord) -> dict[str, Any]:
    spec = record.spec
    believed = {"estimator_rig": spec.estimator_rig} if spec.estimator_rig else {}
    return {
        "simulation": spec.simulation,
        "algorithm": spec.algorithm,
        "compensated": spec.compensated,
        "sample_time_s": spec.sample_time_s,
        **record.metrics._asdict(),
        "frames_sent": record.frames_sent,
        "frames_lost": record.frames_lost,
        "on_bus": spec.on_bus,
        "ending": record.ending,
        **believed,
    }


def timing(records: list[RunRecord], simulated_s: float, wall_s: float) -> dict[str, Any]:
    """Return the content of `timing.json`; `real_time_factor` is the median over the runs on the bus, one core each."""
    factors = sorted(r.timing["real_time_factor"] for r in records if r.spec.on_bus and r.metrics.finite)
    return {
        "real_time_factor": factors[len(factors) // 2] if factors else None,
        "simulated_s": simulated_s,
        "wall_s": wall_s,
        "runs": [{"name": r.spec.name, **r.timing} for r in records],
    }


def timing_traces(record: RunRecord, rig: Rig, wire: str) -> TimingTraces:
    """Return the data of the timing figure of a run in real time; ages and lateness as fine as their histograms."""
    loop = record.timing["loop"]
    feedback = dict(record.timing["accounting"]["feedback"])
    duration_s = record.timing["simulated_s"]
    return TimingTraces(
        age_s=_spread(loop["age"]),
        lateness_s=_spread(loop["lateness"]),
        age_marks_s=_marks(loop["age"]),
        lateness_marks_s=_marks(loop["lateness"]),
        period_s=rig.bench.host_period_s,
        frames={name: count for name, count in feedback.items() if count or name in {"delivered", "lost"}},
        label=f"{wire}, {duration_s:.0f} s",
    )


def _spread(histogram: dict[str, Any]) -> NDArray[np.float64]:
    bins = np.array(histogram["bins"], dtype=float).reshape(-1, 2)
    above = np.full(histogram["above_range"], (histogram["max_us"] or 0.0) * 1e-6)
    return np.concatenate((np.repeat(bins[:, 0] * 1e-6, bins[:, 1].astype(int)), above))


def _marks(histogram: dict[str, Any]) -> dict[str, float]:
    named = (("p50", "p50_us"), ("p99", "p99_us"), ("max", "max_us"))
    return {name: histogram[key] * 1e-6 for name, key in named if histogram[key] is not None}


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write JSON with a fixed layout; ValueError for numbers that aren't finite."""
    path.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")
