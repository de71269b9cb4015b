"""Thresholds by replicas: what a replica is, what bound comes of what replicas show, and what a verdict makes of it."""

import numpy as np
import pytest

from hil_forceps.diagnosis.calibration import bootstrap
from hil_forceps.diagnosis.calibration.bootstrap import beyond, calibrate, identify_calibrated, is_approximate
from hil_forceps.diagnosis.calibration.replica import replica
from hil_forceps.diagnosis.error_rates import CALIBRATED_FALSE_ALARMS, LEFT_OVER_CHANCE
from hil_forceps.diagnosis.evidence import pass_all
from hil_forceps.diagnosis.identification import Calibration, Identified, identify
from hil_forceps.diagnosis.lack_of_fit.omnibus_test import LackOfFit
from hil_forceps.diagnosis.preparation.even_rows import EvenRun
from hil_forceps.diagnosis.validation.verdict import judge
from tests.hidden_effects.generator import RIG, true_rig
from tests.unit.diagnosis.simulated_runs import POOL, runs_of

KINDS = ("multisine", "short_hold")
DEADBAND = {"amplifier_deadband": {"half_width_A": 4.0e-3}}


def even_runs_of(effects: dict[str, dict[str, float]]) -> list[EvenRun]:
    return [EvenRun.whole(run) for run in runs_of(true_rig(RIG, effects, {}), KINDS, 7900)]


@pytest.fixture(scope="module")
def found() -> Identified:
    return identify(even_runs_of(DEADBAND), [], RIG, mapper=POOL.map)


def test_below_the_threshold_chance_is_what_the_score_test_draws() -> None:
    assert beyond([3.0, 15.9], 16.0) == 0.0


def test_beyond_it_a_further_replica_seldom_exceeds_the_bound() -> None:
    rng = np.random.default_rng(5)
    for count in (2, 4):
        drawn = rng.lognormal(6.0, 0.7, (20_000, count + 1))
        bounds = np.array([beyond(row[:-1], 0.0) for row in drawn]) / LEFT_OVER_CHANCE
        share = float(np.mean(drawn[:, -1] > bounds))
        assert share == pytest.approx(CALIBRATED_FALSE_ALARMS, rel=0.1)


def test_a_replica_has_the_motion_the_load_and_the_noise_of_its_run(found: Identified) -> None:
    evens, theta = even_runs_of(DEADBAND), found.found.best.fit.passes.theta
    passes = pass_all(found.records, theta, POOL.map)
    for even, record, passed in zip(evens, found.records, passes.runs, strict=True):
        first, second = (
            replica(even, record, passed, RIG, theta, found.noise, np.random.default_rng(seed)) for seed in (1, 2)
        )
        again = replica(even, record, passed, RIG, theta, found.noise, np.random.default_rng(1))
        columns = {name: values[record.settling_rows :] for name, values in even.run.columns.items()}
        for name, values in first.run.columns.items():
            assert np.array_equal(values, again.run.columns[name])
            near = 0.05 * float(np.ptp(columns[name]))
            assert float(np.sqrt(np.mean((values - columns[name]) ** 2))) < near, name
        for channel, name in enumerate(("theta_j_rad", "tau_w_N_m")):
            apart = first.run.columns[name] - second.run.columns[name]
            assert float(np.std(apart)) == pytest.approx(np.sqrt(2.0) * found.noise.deviation[channel], rel=0.1)
        count = 2.0 * np.pi / (RIG.encoder.counts_per_rev or 1)
        steps = first.run.columns["theta_m_rad"] / count
        assert float(np.abs(steps - np.round(steps)).max()) < 1e-6


def test_coloured_noise_is_drawn_as_coloured(found: Identified) -> None:
    even, record = even_runs_of(DEADBAND)[0], found.records[0]
    theta = found.found.best.fit.passes.theta
    passed = pass_all([record], theta, POOL.map).runs[0]
    noise = found.noise._replace(correlation=np.array([0.9, 0.0, 0.0]))
    first, second = (
        replica(even, record, passed, RIG, theta, noise, np.random.default_rng(seed)).run.columns["theta_j_rad"]
        for seed in (1, 2)
    )
    apart = first - second
    assert float(np.corrcoef(apart[1:], apart[:-1])[0, 1]) == pytest.approx(0.9, abs=0.02)
    assert float(np.std(apart)) == pytest.approx(np.sqrt(2.0) * noise.deviation[0], rel=0.2)


def test_a_verdict_within_what_replicas_show_is_undetermined(found: Identified) -> None:
    assert judge(found, RIG).verdict == "effects"
    gain = float(found.found.steps[0].tested.gains.max())
    beaten = found._replace(calibration=Calibration(1.1 * gain, 0.0, 0.0, (gain, 0.2 * gain)))
    verdict = judge(beaten, RIG)
    assert verdict.verdict == "undetermined"
    assert "amplifier_deadband would explain" in verdict.reasons[0]
    beats = found._replace(calibration=Calibration(0.9 * gain, 0.0, 0.0, (0.2 * gain,)))
    assert [effect.id for effect in judge(beats, RIG).effects] == ["amplifier_deadband"]


def test_what_is_left_within_what_replicas_leave_is_undetermined() -> None:
    nothing = identify(even_runs_of({})[:1], [], RIG, mapper=POOL.map)
    assert judge(nothing, RIG).verdict == "consistent"
    left = nothing._replace(after=LackOfFit(500.0, 16.0, (("wire", "tension", 500.0),)))
    assert judge(left, RIG).verdict == "unnamed"
    verdict = judge(left._replace(calibration=Calibration(0.0, 600.0, 0.0, (1.0,))), RIG)
    assert verdict.verdict == "undetermined"
    assert "runs simulated without any effect leave as much" in verdict.reasons[0]
    assert judge(left._replace(calibration=Calibration(0.0, 400.0, 0.0, (1.0,))), RIG).verdict == "unnamed"


def test_usual_runs_need_no_replicas(found: Identified, monkeypatch: pytest.MonkeyPatch) -> None:
    assert not is_approximate(found)
    monkeypatch.setattr(bootstrap, "calibrate", None)  # not called
    assert identify_calibrated(even_runs_of(DEADBAND), [], RIG, mapper=POOL.map).calibration is None


def test_replicas_of_sound_runs_show_no_more_than_chance() -> None:
    asked, runs = bootstrap._Asked(RIG, POOL.map, frozenset(), 0), even_runs_of({})
    found = identify(runs, [], RIG, mapper=POOL.map)
    calibration = calibrate(found, runs, [], asked, lambda _: None)
    assert (calibration.gain, calibration.left, calibration.unseen) == (0.0, 0.0, 0.0)
    assert len(calibration.draws) == bootstrap.DRAWS
    assert max(calibration.draws) < found.found.steps[0].tested.threshold


def test_where_replicas_show_more_there_are_more_of_them(found: Identified, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = iter([(3.0, 4.0, 0.0), (300.0, 4.0, 0.0), (100.0, 4.0, 0.0), (200.0, 4.0, 0.0)])
    monkeypatch.setattr(bootstrap, "shown_by_chance", lambda *_, **__: next(shown))
    asked = bootstrap._Asked(RIG, POOL.map, frozenset(), 0)
    calibration = calibrate(found, even_runs_of(DEADBAND), [], asked, lambda _: None)
    assert calibration.draws == (3.0, 300.0, 100.0, 200.0)
    assert calibration.gain == beyond(calibration.draws, 0.0) > 300.0
    assert calibration.left == 0.0
