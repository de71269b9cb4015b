"""Replicates tell the bias of a fit, and what its tests find where nothing is left."""

import numpy as np
import pytest

from hil_forceps.data.even_rows import EvenRun
from hil_forceps.diagnosis import identification
from hil_forceps.diagnosis.bootstrap import REPLICATES, Bootstrap, bias_corrected, corrected_replicates, shifted
from hil_forceps.diagnosis.evidence import Passes
from hil_forceps.diagnosis.identification import identify, is_approximate
from hil_forceps.diagnosis.inference.fit import Fit, fit, is_stationary
from hil_forceps.diagnosis.options import Options
from hil_forceps.diagnosis.state_space.advance import physics_of
from hil_forceps.diagnosis.state_space.layout import Noise
from hil_forceps.diagnosis.validation.verdict import judge
from hil_forceps.model import parameters
from tests.hidden_effects.drawn_cases import draw, even_parts, make
from tests.hidden_effects.generator import RIG
from tests.unit.diagnosis.simulated_runs import POOL, known_of, records_of, runs_of

FREE = known_of(RIG)
THETA = parameters.vector(RIG)


def model() -> Fit:
    rng = np.random.default_rng(0)
    root = 1e-3 * rng.standard_normal((len(FREE), len(FREE)))
    return Fit(FREE, Passes(THETA, physics_of(THETA), ()), root @ root.T + 1e-6 * np.eye(len(FREE)))


def scaled(fitted: Fit) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.array([value / free.scale for free, value in zip(FREE, fitted.values, strict=True)])


def test_a_bias_goes_and_what_chance_adds_to_it_widens_the_intervals() -> None:
    rng = np.random.default_rng(1)
    fitted = model()
    bias = 3.0 * np.sqrt(np.diag(fitted.covariance)) * rng.choice((-1.0, 1.0), len(FREE))
    without = bias_corrected(fitted, [bias, bias, bias])
    np.testing.assert_allclose(scaled(without), scaled(fitted) - bias, rtol=1e-9)
    np.testing.assert_allclose(without.covariance, 4.0 / 3.0 * fitted.covariance)


def test_shifts_that_scatter_more_than_the_fit_says_are_what_it_knows() -> None:
    rng = np.random.default_rng(2)
    fitted = model()
    shifts = list(5.0 * rng.multivariate_normal(np.zeros(len(FREE)), fitted.covariance, REPLICATES))
    ratio = bias_corrected(fitted, shifts).covariance[0, 0] / fitted.covariance[0, 0]
    assert 0.4 * 25.0 * 4.0 / 3.0 < ratio < 2.0 * 25.0 * 4.0 / 3.0


def test_an_estimate_without_bias_is_off_by_what_its_own_runs_are_from_their_mean() -> None:
    fitted = model()
    shifts = [np.full(len(FREE), size) for size in (1e-3, 2e-3, 3e-3)]
    offs = [scaled(one) - scaled(fitted) for one in corrected_replicates(fitted, shifts)]
    np.testing.assert_allclose([off[0] for off in offs], [-1e-3, 0.0, 1e-3], atol=1e-9)
    assert [one is fitted for one in corrected_replicates(fitted, [])] == [True] * REPLICATES


def test_parameters_stay_within_their_bounds() -> None:
    at = next(i for i, free in enumerate(FREE) if "coulomb" in free.name)
    far = np.zeros(len(FREE))
    far[at] = -1e3
    assert shifted(model(), far).values[at] >= FREE[at].low >= 0.0


def test_a_fit_finds_the_parameters_of_runs_that_were_made_with_others() -> None:
    """The shift is that of the runs that were made: with another constant of the motor it points there."""
    runs = runs_of(RIG, ("multisine", "short_hold"), 6200)
    records = records_of(runs, RIG)
    found = fit(records, THETA, FREE, POOL.map)
    evens = [EvenRun.whole(run) for run in runs]
    noise = Noise(np.array([RIG.noise.theta_j_rad, RIG.noise.tau_w_N_m, RIG.noise.current_A]), np.zeros(3), np.zeros(3))
    how = identification.prepared(evens, [], RIG, Options(mapper=POOL.map)).how
    made = Bootstrap(RIG, noise, lambda again: records_of([even.run for even in again], RIG), how)
    at = next(i for i, free in enumerate(FREE) if free.name == "motor.torque_constant_N_m_per_A")
    deviation = float(np.sqrt(found.covariance[at, at]))
    other = shifted(found, 20.0 * deviation * np.eye(len(FREE))[at])
    assert is_stationary(found, POOL.map)
    assert not is_stationary(made.beside(other, records), POOL.map)
    shifts = [made.shift(made.beside(found, again)) for again in made.replicates(other, evens, records)]
    assert len(shifts) == REPLICATES
    assert np.mean([shift[at] for shift in shifts]) == pytest.approx(20.0 * deviation, rel=0.2)


@pytest.mark.long
@pytest.mark.parametrize("seed", [11080, 12091])
def test_what_the_filter_makes_of_fine_counts_is_no_lack_of_fit(seed: int) -> None:
    """Law P: 35 of χ² over the rate of the current where 16 are chance, and 31 in the runs held out of the second."""
    made = make(draw("none", seed, usual=True))
    fitted, held_out = even_parts(made)
    said: list[str] = []
    found = identify(fitted, held_out, made.assumed, Options(mapper=POOL.map, progress=said.append))
    assert any("simulated with the model" in each for each in said)
    assert judge(found, made.assumed).verdict == "consistent"


@pytest.mark.long
def test_estimates_of_a_drive_that_the_filter_only_nearly_has_are_bias_corrected() -> None:
    """No jaw sensor, a cascade at 4 kHz, friction of a third of the load: the stiffness was 3.3 deviations off."""
    case = make(draw("none", 31007))
    fitted, _ = even_parts(case)
    found = identify(fitted, [], case.assumed, Options(mapper=POOL.map))
    assert is_approximate(found.noise, found.records)
    truth = parameters.vector(case.true)
    best = found.found.best.fit
    assert not found.found.best.effects
    away = [
        (value - truth[free.place]) / d for free, value, d in zip(best.free, best.values, best.deviations, strict=True)
    ]
    assert np.abs(away).max() < 1.96
