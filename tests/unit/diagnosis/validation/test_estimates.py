"""Estimates before and after an effect is known: nearer to what was measured, causal, and counted right."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.data.run import Run
from hil_forceps.diagnosis.conclude import diagnose
from hil_forceps.diagnosis.options import Options
from hil_forceps.diagnosis.validation.estimates import GAINS, compared, estimate, estimate_gains
from hil_forceps.diagnosis.validation.rows import Rows
from hil_forceps.estimation import batch
from hil_forceps.estimation.registry import make_estimator
from hil_forceps.rig import Rig
from hil_forceps.rig.catalogue import EFFECT_IDS
from tests.hidden_effects.estimates import ALGORITHMS, PAGE, Errors, Row, compared_rows, errors, lines, sized
from tests.hidden_effects.generator import RIG, generate, true_rig
from tests.hidden_effects.generator_scenarios import SCENARIOS
from tests.hidden_effects.generator_sizes import Effects

SHORT_S = 4.0
NOISE = {"theta_j_rad": RIG.noise.theta_j_rad}
COGGING = sized("cogging")


def run_of(effects: Effects, scenario: str = "multisine", seed: int = 1) -> Run:
    return generate(true_rig(RIG, effects, {}), replace(SCENARIOS[scenario], duration_s=SHORT_S), seed)


def record_of(effects: Effects, scenario: str = "multisine") -> Rows:
    return compared_rows(run_of(effects, scenario))


def rig_of(effects: Effects) -> Rig:
    return true_rig(RIG, effects, {})


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_without_effects_they_are_the_estimators_own(algorithm: str) -> None:
    record, plant = record_of({}), RIG.plant()
    found = estimate(record, RIG, algorithm)
    made = make_estimator(algorithm, RIG, record.period_s, over_wire=False)
    angle, torque = record.channels["theta_m_rad"], plant.torque_constant_N_m_per_A * record.channels["current_A"]
    tau_w, elongation = batch.run(made, np.rint(record.time_s * 1e9).astype(np.int64), angle, torque)
    assert np.array_equal(found.tau_w_N_m, tau_w)
    expected = (plant.motor_pulley_radius_m * angle - elongation) / plant.jaw_pulley_radius_m
    assert found.theta_j_rad == pytest.approx(expected, abs=1e-12)
    told = errors([record], RIG, algorithm)
    assert told.tau_w_N_m < 4e-5
    assert told.theta_j_rad < 1e-3


# How much of the blind error is left at most: of the load's, of the jaw angle's (None: no gain there).
LEFT = {
    "presliding_friction": (0.3, 0.3),
    "load_dependent_friction": (0.6, 0.6),
    "coulomb_asymmetry": (0.7, 0.7),
    "jaw_gravity": (0.7, None),
    "wire_slack": (None, 0.4),
    "wire_hysteresis": (None, 0.8),
    "wire_permanent_stretch": (None, 0.4),
    "torque_constant_drift": (0.6, 0.7),
    "cogging": (0.2, 0.2),
    "torque_ripple": (0.4, 0.4),
    "current_offset": (0.2, 0.3),
    "encoder_eccentricity": (None, 0.2),
    "channel_skew": (None, 0.4),
    "pulley_eccentricity": (0.6, 0.2),
}


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("effect_id", LEFT)
def test_knowing_the_effect_brings_them_nearer(effect_id: str, algorithm: str) -> None:
    effects = sized(effect_id)
    record = record_of(effects)
    blind, told = errors([record], RIG, algorithm), errors([record], rig_of(effects), algorithm)
    for name, left in zip(told._fields, LEFT[effect_id], strict=True):
        if left is not None:
            assert getattr(told, name) < left * getattr(blind, name), (name, blind, told)


@pytest.mark.parametrize("effect_id", ["cogging", "wire_creep", "actuation_delay", "channel_skew"])
@pytest.mark.parametrize("skew", ["theta_m_s", "current_s", "tau_w_s"])
def test_nothing_is_taken_from_what_is_yet_to_come(effect_id: str, skew: str) -> None:
    effects = {**sized(effect_id), "channel_skew": {skew: 7e-4}}
    early = {**effects, "channel_skew": {skew: -7e-4}}
    record, cut = record_of({}), 1500

    def spoilt(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.concatenate((values[:cut], values[cut:] + 1.0))

    other = record._replace(channels={name: spoilt(values) for name, values in record.channels.items()})
    for rig in (rig_of(effects), rig_of(early)):
        for one, two in zip(estimate(record, rig), estimate(other, rig), strict=True):
            assert np.array_equal(one[:cut], two[:cut])
            assert not np.array_equal(one[cut:], two[cut:])


def test_gain_is_told_where_the_truth_was_measured() -> None:
    record, ideal = record_of(COGGING), record_of(COGGING).channels
    rigs = (RIG, rig_of(COGGING))
    shown, gains = estimate_gains([record], rigs, [ideal], NOISE, 0)
    assert set(gains) == set(GAINS.values())
    for gain in gains.values():
        assert gain.extended_rmse < 0.2 * gain.baseline_rmse
        assert gain.floor_rmse <= gain.extended_rmse
        assert 0.95 < gain.low <= gain.explained_share <= gain.high <= 1.0
    before, after = (estimate(record, rig) for rig in rigs)
    assert all(np.array_equal(shown[0][name], values) for name, values in compared(before, after).items())

    channels = {name: values for name, values in record.channels.items() if name != "theta_j_rad"}
    shown, gains = estimate_gains([record._replace(channels=channels)], rigs, [channels], NOISE, 0)
    assert set(gains) == {"tau_w_estimate_N_m"}
    assert set(shown[0]) == set(compared(before, after))
    _, gains = estimate_gains([record._replace(channels=channels, tau_w_N_m=None)], rigs, [channels], NOISE, 0)
    assert gains == {}


def test_no_effect_no_gain_and_the_same_seed_the_same_interval() -> None:
    record = record_of({})
    _, gains = estimate_gains([record], (RIG, RIG), [record.channels], NOISE, 0)
    assert [(gain.explained_share, gain.low, gain.high) for gain in gains.values()] == [(0.0, 0.0, 0.0)] * 2
    rigs = (RIG, rig_of(sized("wire_hysteresis")))
    twice = [estimate_gains([record], rigs, [record.channels], NOISE, 5)[1] for _ in range(2)]
    assert twice[0] == twice[1]
    # An effect that isn't there makes them worse, and explains nothing.
    jaw = twice[0]["theta_j_estimate_rad"]
    assert jaw.extended_rmse > 1.2 * jaw.baseline_rmse
    assert jaw.explained_share <= 0.0


@pytest.mark.long
def test_diagnosis_tells_the_gain_on_held_out_runs() -> None:
    runs = [run_of(COGGING, name, seed) for seed, name in enumerate(("multisine", "trapezoid", "teleoperation"))]
    without = frozenset(EFFECT_IDS) - {"cogging", "jaw_gravity"}
    found = diagnose(runs, RIG, Options(without=without, hold_out=(runs[2].name,))).diagnosis
    assert [effect.id for effect in found.effects] == ["cogging"]
    for name in GAINS.values():
        assert found.gain[name].explained_share > 0.9
    for run in found.runs:
        assert {"tau_w_before_N_m", "tau_w_after_N_m", "theta_j_before_rad", "theta_j_after_rad"} == set(run.estimates)
        assert all(values.shape == run.time_s.shape for values in run.estimates.values())


def test_every_effect_stands_in_the_published_table() -> None:
    page = PAGE.read_text(encoding="utf-8")
    for effect_id in ("none", *EFFECT_IDS):
        row = lines([Row(effect_id, name, Errors(1e-6, 1e-3), Errors(2e-6, 2e-3)) for name in ALGORITHMS])
        name = row.splitlines()[2].split("|")[1]
        assert row.endswith(f"|{name}| 1.0 → 2.0 | 1.00 → 2.00 | 1.0 → 2.0 | 1.00 → 2.00 |\n")
        assert page.count(f"\n|{name}|") == 1, effect_id
