"""Channels that are recorded late or early by rows: the filter finds them where they were measured."""

import numpy as np
import pytest

from hil_forceps.data.even_rows import EvenRun
from hil_forceps.diagnosis.evidence import pass_all
from hil_forceps.diagnosis.identification import identify, known_of
from hil_forceps.diagnosis.inference.fit import fit_from
from hil_forceps.diagnosis.inference.parameters import effect_parameters, start_of
from hil_forceps.diagnosis.options import Options
from hil_forceps.diagnosis.preparation.skewed_channels import moved_back, rows_late, rows_later
from hil_forceps.diagnosis.state_space.advance import physics_of
from hil_forceps.diagnosis.state_space.layout import CURRENT, ENCODER, JAW, LOAD_CELL
from hil_forceps.diagnosis.validation.verdict import judge
from hil_forceps.model import parameters
from hil_forceps.rig import Rig
from tests.hidden_effects.generator import RIG, true_rig
from tests.unit.diagnosis.simulated_runs import POOL, records_of, runs_of

FRICTION = {"forceps.motor_coulomb_N_m": 2.0e-4, "forceps.jaw_coulomb_N_m": 1.0e-4}
BASE = RIG.with_changes({**FRICTION, "encoder.counts_per_rev": 16384})
CHANNEL = {"theta_m_s": ENCODER, "theta_j_s": JAW, "tau_w_s": LOAD_CELL, "current_s": CURRENT}


def skewed(channel: str, skew_s: float) -> Rig:
    return true_rig(BASE, {"channel_skew": {channel: skew_s}}, {})


@pytest.mark.parametrize(
    ("channel", "skew_s"),
    [
        *((channel, skew_s) for channel in ("theta_j_s", "tau_w_s") for skew_s in (0.02, 0.0024, -0.0034)),
        # Between samples of the drive the simulated current is constant: of its skew only whole samples show.
        *(("current_s", skew_s) for skew_s in (0.02, 0.003, -0.003)),
    ],
)
def test_innovations_are_white_beside_the_true_skew(channel: str, skew_s: float) -> None:
    true = skewed(channel, skew_s)
    for record in records_of(runs_of(true, ("grasp", "multisine_mid"), 15100), true):
        passed = pass_all([record], parameters.vector(true), POOL.map).runs[0]
        for place in (JAW, LOAD_CELL, CURRENT):
            counts, innovations = passed.counts[:, place], passed.residual[:, place]
            assert counts.sum() > 500
            assert float(np.mean(innovations[counts] ** 2)) < 1.15


def test_beside_no_skew_they_are_not() -> None:
    """The runs above are hard: a jaw sensor 2.4 ms late is off by many deviations."""
    true = skewed("theta_j_s", 0.0024)
    for record in records_of(runs_of(true, ("multisine_mid",), 15100), true):
        passed = pass_all([record], parameters.vector(BASE), POOL.map).runs[0]
        counts = passed.counts[:, JAW]
        assert float(np.mean(passed.residual[counts, JAW] ** 2)) > 2.0


@pytest.mark.parametrize(("skew_s", "rows"), [(0.0004, 0), (0.0006, 1), (-0.0006, -1), (0.0016, 2)])
def test_a_channel_is_moved_to_the_nearest_row(skew_s: float, rows: int) -> None:
    for channel in ("theta_m_s", "theta_j_s", "tau_w_s"):
        late = rows_late(physics_of(parameters.vector(skewed(channel, skew_s))), 1e-3)
        assert late[CHANNEL[channel]] == rows
        assert sum(map(abs, late)) == abs(rows)


@pytest.mark.parametrize(("skew_s", "rows"), [(0.0004, 0), (0.0006, 0), (-0.0006, -1), (0.0016, 1)])
def test_of_a_current_a_part_of_a_row_is_left_that_is_late(skew_s: float, rows: int) -> None:
    assert rows_late(physics_of(parameters.vector(skewed("current_s", skew_s))), 1e-3)[CURRENT] == rows


def test_a_fit_holds_the_rows_where_it_begins_until_its_end_suits_others() -> None:
    """Steps with their own rows compared rows that held other measurements: skews near half a row were drawn there."""
    skew_s = 0.0026
    true = skewed("theta_j_s", skew_s)
    records = records_of(runs_of(true, ("multisine_mid", "multisine"), 15100), true)
    known = known_of(BASE, records)
    start = pass_all(records, parameters.vector(skewed("theta_j_s", 0.0024)), POOL.map)
    assert all(run.series.shifted_s[JAW] == pytest.approx(0.002) for run in start.runs)
    free = (*known, *effect_parameters("channel_skew", start_of("channel_skew", {"theta_j_s": 0.0024})))
    found = fit_from(records, start, free, POOL.map)
    assert all(run.series.shifted_s[JAW] == pytest.approx(0.003) for run in found.passes.runs)
    assert found.values[-1] == pytest.approx(skew_s, abs=4.0 * found.deviations[-1])
    assert found.deviations[-1] < 2e-5


def test_models_with_other_rows_are_compared_by_measurement() -> None:
    true = skewed("theta_j_s", 0.02)
    (record,) = records_of(runs_of(true, ("multisine_mid",), 15100), true)
    passed = record.passed(parameters.vector(true), physics_of(parameters.vector(true)))
    shown = passed.as_recorded(passed.series.jaw_rad[:, np.newaxis] * np.ones(4))[:, JAW]
    measured = np.isfinite(passed.series.jaw_rad)
    assert np.array_equal(shown[20:], record.series.jaw_rad[20:])
    assert measured.sum() == record.series.jaw_rad.size - 20
    assert not shown[:20].any()


def test_breaks_of_a_late_load_are_shared_between_rows() -> None:
    (record,) = records_of(runs_of(BASE, ("grasp",), 15100), BASE)
    before = record.series.load_slope_variance
    row = int(np.argmax(before))
    moved = moved_back(record.series, (0, 0, 3, 0), 0.0026).load_slope_variance
    assert moved[row - 3] == pytest.approx(0.4 * before[row - 1] + 0.6 * before[row], rel=1e-9)


def test_rows_later_repeats_the_ends() -> None:
    values = np.arange(4.0)
    assert rows_later(values, 2).tolist() == [2.0, 3.0, 3.0, 3.0]
    assert rows_later(values, -1).tolist() == [0.0, 0.0, 1.0, 2.0]


@pytest.mark.long
@pytest.mark.parametrize(
    ("channel", "skew_s"),
    [
        ("theta_j_s", 0.02),
        ("theta_j_s", -0.0034),
        ("tau_w_s", 0.04),
        ("tau_w_s", 0.0051),
        ("current_s", 0.003),
        ("current_s", -0.003),
        ("theta_m_s", 0.002),
    ],
)
def test_a_channel_that_is_late_by_rows_is_named(channel: str, skew_s: float) -> None:
    """A load cell 5 ms late once ended a diagnosis with an error; a jaw sensor 20 ms late was `unnamed`."""
    motions = ("multisine", "trapezoid", "grasp", "multisine_mid", "teleoperation", "slow")
    even = [EvenRun.whole(run) for run in runs_of(skewed(channel, skew_s), motions, 15200)]
    verdict = judge(identify(even[:4], even[4:], BASE, Options()), BASE)
    (found,) = verdict.effects
    assert found.id == "channel_skew"
    assert found.parameters[channel].value == pytest.approx(skew_s, abs=1e-4)
