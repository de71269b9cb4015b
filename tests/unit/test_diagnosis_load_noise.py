"""The colour of the load cell's noise is found from runs, and the encoder's slow rounding is followed."""

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d

from hil_forceps.diagnosis import diagnose
from hil_forceps.diagnosis.options import Options, fit_baseline, without_load_noise
from hil_forceps.diagnosis.experiment import Record, prepare, with_load_course
from hil_forceps.diagnosis.linear import Response
from hil_forceps.diagnosis.load_noise import beside_straight, load_noise
from hil_forceps.diagnosis.predict import ClosedLoop
from hil_forceps.diagnosis.smoothing import LoadNoise
from hil_forceps.diagnosis.spectrum import Flat, Layout
from tests.hidden_effects.generator import COLOURED, RIG, WHITE, NoiseKind, make_case, run_seed, simulate
from tests.hidden_effects.generator_scenarios import SCENARIOS

KINDS = ("multisine", "slow")


def assert_known_as_well_as_is_said(known: Sequence[Record], most_N_m: float) -> None:
    """Compare the loads of records with the true ones."""
    for place, (name, record) in enumerate(zip(KINDS, known, strict=True)):
        _, true = simulate(RIG, SCENARIOS[name], run_seed(31, place))
        assert record.tau_w_N_m is not None
        assert record.load_error is not None
        rms = np.sqrt(np.mean((record.tau_w_N_m - true.tau_w_N_m) ** 2))
        told = np.sqrt(np.mean(np.sum(record.load_error.astype(float) ** 2, axis=1)))
        assert rms < most_N_m
        assert 0.75 < rms / told < 1.25


@pytest.mark.parametrize(("kind", "plateau", "most"), [(WHITE, 1.0e-5, 3.0e-6), (COLOURED, 4.36e-5, 9.0e-6)])
def test_the_colour_is_found_and_the_load_known_as_well_as_is_said(
    kind: NoiseKind, plateau: float, most: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = make_case({}, 31, scenarios=(KINDS, ()), noise=kind)
    seen: list[LoadNoise] = []
    found = load_noise

    def spy(layout: Layout, left: Flat, responses: Sequence[Response], records: Sequence[Record]) -> LoadNoise:
        seen.append(found(layout, left, responses, records))
        return seen[-1]

    monkeypatch.setattr(diagnose, "load_noise", spy)
    records, _ = prepare(case.fit, case.assumed)
    known, _ = without_load_noise(records, [], case.assumed, Options())
    slow = seen[0].frequency_Hz < 12.0
    assert np.median(np.sqrt(seen[0].power[slow])) == pytest.approx(plateau, rel=0.25)
    assert_known_as_well_as_is_said(known, most)


def test_straight_loads_show_the_noise_where_the_jaw_is_not_measured() -> None:
    case = make_case({}, 31, scenarios=(KINDS, ()), drop=("theta_j_rad",))
    records, _ = prepare(case.fit, case.assumed)
    known, _ = without_load_noise(records, [], case.assumed, Options())
    assert all(record.straight for record in known)
    noise = known[0].load_noise
    assert noise is not None
    assert np.sqrt(noise.power) == pytest.approx(np.full(noise.power.size, 1.0e-5), rel=0.25)
    assert_known_as_well_as_is_said(known, 3.0e-6)


def test_straight_loads_put_right_a_noise_that_an_effect_has_spoilt() -> None:
    case = make_case({}, 31, scenarios=(("multisine", "teleoperation"), ()))
    straight, smooth = prepare(case.fit, case.assumed)[0]
    frequency_Hz = np.geomspace(0.5, 450.0, 15)
    spoilt = LoadNoise(frequency_Hz, np.where(frequency_Hz < 20.0, 5.0e-8, 1.0e-10))
    first = with_load_course(straight, spoilt)
    assert first.straight
    found = beside_straight([first, with_load_course(smooth, spoilt)], spoilt)
    again = beside_straight([with_load_course(straight, found)], found)
    assert again.power == pytest.approx(np.full(15, 1.0e-10), rel=0.4)
    assert beside_straight([with_load_course(smooth, again)], again) is again


def test_straight_loads_put_right_a_noise_that_was_taken_for_half_as_loud(monkeypatch: pytest.MonkeyPatch) -> None:
    case = make_case({}, 24003, scenarios=(("slow", "chirp"), ()), noise=COLOURED)
    frequency_Hz = np.geomspace(0.5, 450.0, 30)
    true = 1.0e-10 * 0.19 / (1.81 - 1.8 * np.cos(2.0 * np.pi * frequency_Hz * 1.0e-3))
    quiet = LoadNoise(frequency_Hz, np.where(frequency_Hz < 60.0, 0.5 * true, true))
    monkeypatch.setattr(diagnose, "load_noise", lambda *_: quiet)
    records, _ = prepare(case.fit, case.assumed)
    known, _ = without_load_noise(records, [], case.assumed, Options())
    assert [record.straight for record in known] == [True, False]
    found = known[0].load_noise
    assert found is not None
    slow = frequency_Hz < 20.0
    assert np.mean(found.power[slow] / true[slow]) == pytest.approx(1.0, abs=0.3)


def test_slow_noise_that_a_course_takes_along_is_put_back() -> None:
    case = make_case({}, 31, scenarios=(KINDS, ()), noise=COLOURED)
    frequency_Hz = np.geomspace(0.5, 450.0, 15)
    turn = 2.0 * np.pi * frequency_Hz * 1.0e-3
    true = 1.0e-10 * (1.0 - 0.9**2) / (1.0 + 0.9**2 - 1.8 * np.cos(turn))
    noise = LoadNoise(frequency_Hz, true)
    known = [with_load_course(record, noise) for record in prepare(case.fit, case.assumed)[0]]
    assert all(record.straight for record in known)
    found = beside_straight(known, noise).power / true
    assert np.mean(found[frequency_Hz < 12.0]) == pytest.approx(1.0, abs=0.2)
    assert found[frequency_Hz > 12.0] == pytest.approx(np.ones(np.count_nonzero(frequency_Hz > 12.0)), rel=0.2)


def test_the_jaw_of_a_motor_that_creeps_is_where_the_counting_puts_it() -> None:
    rig = RIG.with_changes({"noise.tau_w_N_m": 1.0e-8})  # or the load's error moves the jaw by more
    case = make_case({}, 32, scenarios=(("slow",), ()), rig=rig)
    records, _ = prepare(case.fit, case.assumed)
    setting, _, baseline, _ = fit_baseline(records, case.assumed, Options())
    simulator = setting.simulator
    assert isinstance(simulator, ClosedLoop)
    theta, nuisances = baseline.problem.theta(baseline.fit.u), baseline.problem.nuisances(baseline.fit.u)
    measured = records[0].channels["theta_j_rad"]
    with_it = measured - simulator.raw(0, theta, nuisances[0]).theta_j_rad
    without = with_it + simulator.slow[0].theta_j_rad
    dwelling = np.abs(np.gradient(records[0].reference_rad, 1e-3)) < 1e-6
    assert np.count_nonzero(dwelling) > 2000
    left, before = (np.std(uniform_filter1d(values, 50)[dwelling]) for values in (with_it, without))
    assert left < 0.9 * before
