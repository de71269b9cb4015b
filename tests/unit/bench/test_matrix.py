"""Which runs there are, their names, and what the two JSON files say of them."""

import json
from pathlib import Path
from typing import Any

import pytest

from hil_forceps.bench.matrix import RunSpec, run_matrix
from hil_forceps.bench.metrics import Metrics
from hil_forceps.bench.summary import RunRecord, summary, timing, write_json
from hil_forceps.estimation.registry import ESTIMATOR_IDS
from hil_forceps.rig import Rig, load_rig
from hil_forceps.rig.errors import UserError

ROOT = Path(__file__).parents[3]
CONTRACT = {
    "simulation": int,
    "algorithm": str,
    "compensated": bool,
    "sample_time_s": float,
    "finite": bool,
    "tau_w_rmse_N_m": float,
    "tau_w_peak_error_N_m": float,
    "jaw_error_steady_deg": float,
    "elongation_rmse_m": float,
    "frames_sent": int,
    "frames_lost": int,
}
METRICS = Metrics(True, 1e-3, 2e-3, -2.249, 1e-6)
SPEC = RunSpec(2, "kalman", True, 1e-3, True)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(ROOT / "configs" / "paper.yaml")


def record(spec: RunSpec = SPEC, metrics: Metrics = METRICS, factor: float = 20.0) -> RunRecord:
    return RunRecord(spec, metrics, 60_000, 0, "completed", {"real_time_factor": factor, "wall_s": 1.0})


def test_every_simulation_and_algorithm_on_the_bus_with_and_without_compensation(rig: Rig) -> None:
    specs = run_matrix(rig)
    on_bus = {(s.simulation, s.algorithm, s.compensated) for s in specs if s.on_bus}
    assert on_bus == {(s, a, c) for s in (1, 2) for a in ESTIMATOR_IDS for c in (True, False)}
    assert {s.sample_time_s for s in specs if s.on_bus} == {1e-3}
    direct = [(s.simulation, s.algorithm, s.sample_time_s) for s in specs if not s.on_bus]
    assert sorted(direct) == sorted((s, a, 1e-4) for s in (1, 2) for a in ESTIMATOR_IDS)
    assert all(s.compensated for s in specs if not s.on_bus)
    assert [s.on_bus for s in specs] == sorted((s.on_bus for s in specs), reverse=True)


def test_choice_of_one(rig: Rig) -> None:
    specs = run_matrix(rig, simulation=1, algorithm="improved")
    assert {(s.simulation, s.algorithm) for s in specs} == {(1, "improved")}
    assert [s.on_bus for s in specs] == [True, True, False]


def test_file_says_what_there_is(rig: Rig) -> None:
    changes = {"bench.algorithms": ["kalman"], "bench.simulations": [2], "bench.direct_sample_times_s": []}
    specs = run_matrix(rig.with_changes(changes))
    assert specs == [SPEC, SPEC._replace(compensated=False)]
    with pytest.raises(UserError, match="--algorithm improved: this bench has kalman"):
        run_matrix(rig.with_changes(changes), algorithm="improved")
    with pytest.raises(UserError, match="--simulation 1: this bench has 2"):
        run_matrix(rig.with_changes(changes), simulation=1)


def test_names_are_file_names_of_their_own(rig: Rig) -> None:
    names = [spec.name for spec in run_matrix(rig)]
    assert len(set(names)) == len(names)
    assert all(name.replace("_", "").replace(".", "").replace("-", "").isalnum() for name in names)


def test_summary_has_the_keys_and_types_of_the_contract() -> None:
    content = json.loads(json.dumps(summary([record()], 7)))
    assert set(content) == {"runs", "seed"}
    assert content["seed"] == 7
    (run,) = content["runs"]
    for key, kind in CONTRACT.items():
        assert type(run[key]) is kind, key
    assert run["tau_w_rmse_N_m"] == METRICS.tau_w_rmse_N_m
    assert run["jaw_error_steady_deg"] == METRICS.jaw_error_steady_deg


def test_figures_of_a_run_that_diverged_are_null() -> None:
    run = json.loads(json.dumps(summary([record(metrics=Metrics(False, None, None, None, None))], 0)))["runs"][0]
    assert run["finite"] is False
    measured = [key for key, kind in CONTRACT.items() if kind is float and key != "sample_time_s"]
    assert {key: run[key] for key in measured} == dict.fromkeys(measured)


def test_nothing_of_the_wall_clock_in_the_summary() -> None:
    slow, fast = (record(factor=factor) for factor in (2.0, 30.0))
    assert summary([slow], 0) == summary([fast], 0)


def test_timing_takes_the_median_of_finite_runs_on_the_bus() -> None:
    records = [record(factor=factor) for factor in (10.0, 30.0, 20.0)]
    records.append(record(SPEC._replace(on_bus=False), factor=1.0))
    records.append(record(metrics=Metrics(False, None, None, None, None), factor=99.0))
    content = timing(records, 100.0, 12.0)
    assert content["real_time_factor"] == 20.0
    assert content["wall_s"] == 12.0
    assert content["simulated_s"] == 100.0
    assert [run["name"] for run in content["runs"]] == [r.spec.name for r in records]
    assert timing([], 0.0, 1.0)["real_time_factor"] is None


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_number_that_is_not_finite_is_never_written(tmp_path: Path, value: float) -> None:
    content: dict[str, Any] = {"runs": [value]}
    with pytest.raises(ValueError, match="JSON"):
        write_json(tmp_path / "summary.json", content)
    assert not (tmp_path / "summary.json").exists()
