"""Runs in virtual time, shortened: what they leave, that they repeat to the byte, and how they end early."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hil_forceps.bench.campaign import run_all
from hil_forceps.bench.execute import Executed, execute, rig_for
from hil_forceps.bench.matrix import RunSpec
from hil_forceps.bench.summary import summary
from hil_forceps.bridge.replay import replay
from hil_forceps.data.recording.reader import read_recording
from hil_forceps.rig import Rig, load_rig
from hil_forceps.rig.errors import UserError

ROOT = Path(__file__).parents[3]
SHORT_S = 0.5
SPEC = RunSpec(2, "improved", True, 1e-3, True, SHORT_S)


@pytest.fixture(scope="module")
def paper() -> Rig:
    return load_rig(ROOT / "configs" / "paper.yaml")


@pytest.fixture(scope="module")
def realistic() -> Rig:
    return load_rig(ROOT / "configs" / "realistic.yaml")


def nobody(_: Executed) -> None:
    """Nobody wants to know."""


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def test_run_on_the_bus_leaves_a_recording_and_a_bus_log(paper: Rig, tmp_path: Path) -> None:
    executed = execute(SPEC, paper, 0, tmp_path)
    assert set(files(tmp_path)) == {f"{SPEC.name}.mcap", f"{SPEC.name}.log"}
    assert executed.record.ending == "completed"
    assert executed.record.frames_lost == 0
    recording = read_recording(tmp_path / f"{SPEC.name}.mcap")
    assert recording.result["reason"] == "completed"
    assert recording.notes == ()
    counters = json.loads(recording.result["counters"])
    assert executed.record.frames_sent == counters["service"]["frames_sent"]
    logged = (tmp_path / f"{SPEC.name}.log").read_text().splitlines()
    assert len(logged) == counters["service"]["frames_sent"] + counters["service"]["frames_received"]
    assert abs(executed.traces.time_s[-1] - SHORT_S) < 0.01
    assert executed.traces.time_s[0] == 0.0
    assert not executed.record.metrics.finite  # it did not reach the window


def test_run_without_the_bus_leaves_nothing(paper: Rig, tmp_path: Path) -> None:
    spec = RunSpec(2, "kalman", True, 1e-4, False, 0.05)
    executed = execute(spec, paper, 0, tmp_path)
    assert files(tmp_path) == {}
    steps = np.diff(executed.traces.time_s)
    assert steps == pytest.approx(1e-4)
    assert executed.record.frames_lost == 0


def test_rig_of_a_run_without_the_bus_has_its_rate_and_no_delays(realistic: Rig) -> None:
    rig = rig_for(RunSpec(2, "kalman", True, 1e-4, False), realistic)
    bench = rig.bench
    assert rig.require_drive().sample_time_s == bench.host_period_s == 1e-4
    assert (bench.latency_s, bench.latency_jitter_s, bench.drive_clock_ppm, bench.feedback_divider) == (0, 0, 0, 1)
    assert bench.plant_step_s <= 1e-4
    assert rig.encoder == realistic.encoder
    assert rig.noise == realistic.noise
    assert rig_for(SPEC, realistic) is realistic


@pytest.mark.parametrize("algorithm", ["previous", "kalman"])
def test_recording_replays_to_the_byte(realistic: Rig, tmp_path: Path, algorithm: str) -> None:
    from hil_forceps.bench.assembly import make_pipeline, settings_of  # noqa: PLC0415

    spec = SPEC._replace(algorithm=algorithm)
    execute(spec, realistic, 3, tmp_path)
    recording = read_recording(tmp_path / f"{spec.name}.mcap")
    rig, settings = settings_of(recording)
    assert rig == realistic
    assert settings.algorithm == algorithm
    assert replay(recording, make_pipeline(rig, settings)).first_difference is None


@pytest.mark.long
@pytest.mark.parametrize("spec", [SPEC._replace(algorithm="kalman"), RunSpec(2, "kalman", True, 2e-4, False, SHORT_S)])
def test_estimator_may_be_blind_to_what_the_plant_has(paper: Rig, tmp_path: Path, spec: RunSpec) -> None:
    from hil_forceps.bench.assembly import make_pipeline, settings_of  # noqa: PLC0415

    cogging = {"sine_N_m": 3e-4, "cosine_N_m": 3e-4, "harmonic": 6.0}
    extended = paper.with_changes({"effects": {"cogging": cogging}})
    blind_spec = spec._replace(estimator_rig="paper.yaml")
    told, blind = run_all([spec, blind_spec], extended, 0, tmp_path, 1, nobody, estimator_rig=paper)
    errors = [np.sqrt(np.mean((run.traces.tau_w_est - run.traces.tau_w_true)[50:] ** 2)) for run in (told, blind)]
    assert errors[0] < 0.2 * errors[1], errors
    entries = summary([told.record, blind.record], 0)["runs"]
    assert [entry.get("estimator_rig") for entry in entries] == [None, "paper.yaml"]
    if not spec.on_bus:
        return
    recording = read_recording(tmp_path / f"{blind_spec.name}.mcap")
    rig, settings = settings_of(recording)
    assert rig.effects == {}
    assert replay(recording, make_pipeline(rig, settings)).first_difference is None
    # The plant is the same in both: a rig without the effect in it gives another run.
    alone = execute(spec, paper, 0, tmp_path)
    assert not np.array_equal(alone.traces.theta_j_true, blind.traces.theta_j_true)


def test_run_that_names_a_rig_that_is_not_given_raises(paper: Rig, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="rig for its estimator"):
        execute(SPEC._replace(estimator_rig="other.yaml"), paper, 0, tmp_path)


def test_same_seed_same_bytes_whatever_the_jobs(realistic: Rig, tmp_path: Path) -> None:
    specs = [
        SPEC._replace(algorithm="kalman"),
        SPEC._replace(compensated=False),
        RunSpec(1, "kalman", True, 2e-4, False, 0.05),
    ]
    found = {}
    for name, seed, jobs in (("one", 5, 1), ("two", 5, 2), ("other", 6, 1)):
        out = tmp_path / name
        out.mkdir()
        told: list[Executed] = []
        executed = run_all(specs, realistic, seed, out, jobs, told.append)
        assert [e.record.spec for e in executed] == specs
        assert sorted(e.record.spec for e in told) == sorted(specs)
        traces = [np.concatenate([np.asarray(field) for field in e.traces[:7]]).tobytes() for e in executed]
        found[name] = (files(out), summary([e.record for e in executed], seed)["runs"], traces)
    assert found["one"] == found["two"]
    for file, content in found["one"][0].items():
        assert found["other"][0][file] != content, f"{file} does not depend on the seed"
    assert all(a != b for a, b in zip(found["one"][2], found["other"][2], strict=True))


def test_run_that_is_asked_to_stop_ends_clean(paper: Rig, tmp_path: Path) -> None:
    executed = execute(SPEC, paper, 0, tmp_path, after(300))
    assert executed.record.ending == "stopped on request"
    recording = read_recording(tmp_path / f"{SPEC.name}.mcap")
    assert recording.result["reason"] == "stop_requested"
    assert 0 < len(recording.samples) < 1000 * SHORT_S
    assert recording.samples["state"][-1] == 0  # disabled


def test_campaign_that_is_asked_to_stop_begins_no_more(paper: Rig, tmp_path: Path) -> None:
    executed = run_all([SPEC, SPEC._replace(compensated=False)], paper, 0, tmp_path, 1, nobody, after(300))
    assert [e.record.ending for e in executed] == ["stopped on request"]


def after(ticks: int) -> Callable[[], bool]:
    """Ask for a stop once it has been asked about so many times."""
    asked = iter(range(ticks))
    return lambda: next(asked, None) is None


def test_folder_that_is_not_there_is_told(paper: Rig, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="none"):
        execute(SPEC, paper, 0, tmp_path / "none")


@pytest.mark.parametrize("jobs", [1, 2])
def test_failure_of_a_run_ends_the_campaign(paper: Rig, tmp_path: Path, jobs: int) -> None:
    with pytest.raises(UserError, match="none"):
        run_all([SPEC, SPEC._replace(compensated=False)], paper, 0, tmp_path / "none", jobs, nobody)


def test_rig_without_the_values_is_told(tmp_path: Path) -> None:
    rig = load_rig(ROOT / "configs" / "surgical_tool.yaml")
    with pytest.raises(UserError, match="drive"):
        execute(SPEC, rig, 0, tmp_path)
