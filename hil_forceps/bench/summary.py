"""`summary.json` and `timing.json`: what a bench leaves for programs to read."""

import json
from pathlib import Path
from typing import Any, NamedTuple

from hil_forceps.bench.matrix import RunSpec
from hil_forceps.bench.metrics import Metrics


class RunRecord(NamedTuple):
    """One run: what was asked, what came out, and how its clock behaved."""

    spec: RunSpec
    metrics: Metrics
    frames_sent: int
    frames_lost: int
    ending: str  # why the run ended, in words
    timing: dict[str, Any]  # all that depends on the wall clock


def summary(records: list[RunRecord], seed: int) -> dict[str, Any]:
    """Return what `summary.json` holds: no entry of it depends on the wall clock in virtual time."""
    return {"runs": [_run(record) for record in records], "seed": seed}


def _run(record: RunRecord) -> dict[str, Any]:
    spec = record.spec
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
    }


def timing(records: list[RunRecord], wall_s: float) -> dict[str, Any]:
    """Return what `timing.json` holds; `real_time_factor` is the median over the runs on the bus, one core each."""
    factors = sorted(r.timing["real_time_factor"] for r in records if r.spec.on_bus and r.metrics.finite)
    return {
        "real_time_factor": factors[len(factors) // 2] if factors else None,
        "simulated_s": sum(record.spec.duration_s for record in records),
        "wall_s": wall_s,
        "runs": [{"name": r.spec.name, **r.timing} for r in records],
    }


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write JSON with a fixed layout; numbers that aren't finite are refused (ValueError)."""
    path.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")
