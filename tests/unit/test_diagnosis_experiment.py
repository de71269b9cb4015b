"""Runs made ready: even grids over gaps, jitter and printed stamps; jumps of the load; what is fitted."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.diagnosis.assemble import assemble
from hil_forceps.diagnosis.experiment import (
    AFTER_GAP_S,
    BURN_IN_S,
    DRAWS,
    MAX_ROWS,
    jumps,
    mode_of,
    prepare,
    with_load_course,
)
from hil_forceps.diagnosis.smoothing import LoadNoise
from hil_forceps.diagnosis.unknowns import Unknown, Unknowns, join, known_parameters, run_nuisances
from hil_forceps.rig.errors import UserError
from hil_forceps.runs.table import Run
from tests.hidden_effects.generator import RIG, make_case

COUNT = 1000
BURNT = round(BURN_IN_S / 1e-3)
Vector = NDArray[np.float64]


def stamps(count: int = COUNT) -> Vector:
    return np.arange(count, dtype=np.float64) * 1e-3


def a_run(time_s: Vector | None = None, **changes: Vector | None) -> Run:
    time = stamps() if time_s is None else time_s
    columns: dict[str, Vector | None] = {
        "time_s": time,
        "theta_m_ref_rad": np.sin(time),
        "theta_m_rad": np.sin(time),
        "current_A": 0.1 * np.cos(time),
        "theta_j_rad": 1.4 * np.sin(time),
        "tau_w_N_m": np.zeros(time.size),
    }
    columns |= changes
    return Run("a", {name: values for name, values in columns.items() if values is not None})


def test_an_even_run_stays_as_it_is_but_for_its_burn_in() -> None:
    run = a_run()
    [record], notes = prepare([run], RIG)
    assert notes == []
    assert record.mode == "closed_loop"
    assert record.evenly_logged
    assert record.period_s == 1e-3
    assert np.array_equal(record.channels["theta_m_rad"], run.columns["theta_m_rad"])
    assert not record.weights[:BURNT].any()
    assert record.weights[BURNT:].all()


def test_rows_of_a_gap_and_shortly_after_do_not_count() -> None:
    kept = np.r_[0:400, 450:COUNT]
    [record], _ = prepare([a_run(stamps()[kept])], RIG)
    assert record.time_s.size == COUNT
    assert not record.evenly_logged
    after = round(AFTER_GAP_S / 1e-3)
    assert not record.weights[400:450].any()
    assert record.weights[BURNT:400].all()
    assert record.weights[450 + after :].all()
    assert np.allclose(record.channels["theta_m_rad"][500:], np.sin(stamps()[500:]))


def test_jitter_is_resampled_and_a_little_of_it_is_not() -> None:
    rng = np.random.default_rng(1)
    for jitter, even in ((1e-6, True), (2e-4, False)):
        time = stamps() + rng.uniform(-jitter, jitter, COUNT)
        [record], _ = prepare([a_run(time)], RIG)
        assert record.evenly_logged is even
        assert record.time_s.size == COUNT
        # The grid's last row may lie behind the last stamp, where the last value holds.
        error = np.abs(record.channels["theta_m_rad"] - np.sin(time[0] + record.time_s))
        assert error[:-1].max() < 2e-6


def test_stamps_printed_with_few_digits_get_the_drive_s_period() -> None:
    [record], _ = prepare([a_run(1.0000004 * stamps())], RIG)
    assert record.period_s == 1e-3


def test_a_long_run_is_cut_and_that_is_said() -> None:
    time = stamps(MAX_ROWS + 10)
    [record], notes = prepare([a_run(time)], RIG)
    assert record.time_s.size == MAX_ROWS
    assert len(notes) == 1
    assert str(MAX_ROWS) in notes[0]


def test_too_few_rows_are_refused() -> None:
    with pytest.raises(UserError, match="too few"):
        prepare([a_run(stamps(49))], RIG)


def test_without_reference_drive_or_current_the_measured_angle_drives() -> None:
    assert mode_of([a_run()], RIG) == "closed_loop"
    assert mode_of([a_run(theta_m_ref_rad=None)], RIG) == "driven"
    assert mode_of([a_run(current_A=None, tau_m_N_m=np.zeros(COUNT))], RIG) == "driven"
    assert mode_of([a_run()], RIG.model_copy(update={"drive": None})) == "driven"


def test_jumps_are_found_and_ramps_are_none() -> None:
    rng = np.random.default_rng(2)
    load = np.where(np.arange(COUNT) > 300, 2e-3, 0.0) + 1e-5 * rng.standard_normal(COUNT)
    assert jumps(load).tolist() == [300]
    ramp = np.interp(np.arange(COUNT), [300, 320], [0.0, 2e-3]) + 1e-6 * rng.standard_normal(COUNT)
    assert jumps(ramp).size == 0
    assert jumps(np.zeros(COUNT)).size == 0


def test_known_parameters_carry_what_is_known_of_them() -> None:
    items = {item.name: item for item in known_parameters(RIG, 0.01).items}
    stiffness = items["forceps.wire_stiffness_N_per_m"]
    assert stiffness.centre == 2.6e4
    assert stiffness.scale == pytest.approx(2.6e3)
    assert stiffness.prior
    friction = items["forceps.motor_coulomb_N_m"]
    assert friction.scale == pytest.approx(0.3 * 0.01)  # a friction's prior is as wide as the torques seen
    assert friction.low == 0.0


def test_without_the_jaw_s_angle_its_radius_is_held_too_where_the_rig_says_it() -> None:
    radius = "forceps.jaw_pulley_radius_m"
    assert radius in known_parameters(RIG, 0.01).names
    assert radius not in known_parameters(RIG, 0.01, jaw_measured=False).names
    bounded = RIG.with_changes({radius: {"min": 1e-3, "max": 8e-3}})
    assert radius in known_parameters(bounded, 0.01, jaw_measured=False).names
    case = make_case({}, 3, scenarios=(("multisine",), ()), drop=("theta_j_rad",))
    records, _ = prepare(case.fit, case.assumed)
    assert radius not in assemble(records, case.assumed, map).problem.shared.names


def test_bounds_and_unknown_values_have_no_prior() -> None:
    bounded = RIG.with_changes({"forceps.wire_stiffness_N_per_m": {"min": 1e3, "max": 1e6}})
    items = {item.name: item for item in known_parameters(bounded, 0.01).items}
    stiffness = items["forceps.wire_stiffness_N_per_m"]
    assert not stiffness.prior
    assert (stiffness.low, stiffness.high) == (1e3, 1e6)
    unknown = RIG.with_changes({"forceps.wire_stiffness_N_per_m": "unknown"})
    with pytest.raises(UserError, match="no bounds"):
        known_parameters(unknown, 0.01)


def test_an_effect_joins_with_the_catalogue_s_bounds_and_only_its_free_parameters() -> None:
    start = {"rise_N_m": 2e-4, "speed_rad_per_s": 0.5}
    joined = Unknowns(()).with_effect("stribeck_friction", start, {"rise_N_m": 0.0})
    assert joined.names == ("effects.stribeck_friction.rise_N_m",)
    [item] = joined.items
    assert (item.low, item.high, item.prior, item.centre) == (0.0, 1.0, False, 2e-4)
    assert joined.values(np.zeros(1)).tolist() == [2e-4]


def test_numbers_of_the_optimiser_become_values_and_bounds() -> None:
    item = Unknown("a", "", 10.0, 2.0, 4.0, math.inf, True, 10.0)
    both = join((Unknowns((item,)), run_nuisances(2, 0.1, 0.2)))
    assert both.values(np.array([1.5, 1.0, 1.0, 0.0, -1.0])).tolist() == [13.0, 0.1, 0.2, 0.0, -0.2]
    low, high = both.bounds()
    assert low[0] == -3.0
    assert high[0] == math.inf
    assert both.prior_weights().tolist() == [1.0] * 5


def test_draws_of_a_load_are_as_far_from_it_as_its_error_says_and_together_nothing() -> None:
    noise = LoadNoise(np.array([0.0, 500.0]), np.full(2, 1e-10))
    time = stamps(6000)
    ramps = np.interp(time, (1.0, 2.0, 3.0, 4.0), (0.0, 2e-3, 2e-3, -1e-3))
    noisy = ramps + 1e-5 * np.random.default_rng(3).standard_normal(time.size)
    [record], _ = prepare([a_run(time, tau_w_N_m=noisy)], RIG)
    record = with_load_course(record, noise)
    assert record.straight
    assert record.load_error is not None
    assert record.load_draws is not None
    assert record.load_draws.shape == (DRAWS, time.size)
    deviations = np.sqrt(np.sum(record.load_error.astype(np.float64) ** 2, axis=1))
    assert np.abs(record.load_draws.sum(axis=0)).max() < 1e-6 * deviations.max()
    spread = np.sqrt(np.mean(record.load_draws**2, axis=0))
    assert np.mean(spread / deviations) == pytest.approx(1.0, abs=0.3)
    assert np.quantile(spread / deviations, 0.1) > 0.3  # but where it is quick, at corners
