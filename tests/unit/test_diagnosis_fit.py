"""Output-error fits on a toy simulator: parameters are recovered, bounds and priors kept, intervals honest."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.diagnosis import fit as fit_module
from hil_forceps.diagnosis.experiment import Record
from hil_forceps.diagnosis.extension import at_an_end
from hil_forceps.diagnosis.fit import (
    MAX_DAMPINGS,
    Fit,
    chi2_of,
    fit,
    fit_again,
    follow,
    gram,
    hold,
    hold_beside,
    hold_nuisances,
)
from hil_forceps.diagnosis.evidence import Mapper
from hil_forceps.diagnosis.problem import EDGE_SD, Nuisance, Outputs, Problem
from hil_forceps.diagnosis.spectrum import Whitener, make_layout, transform, white_noise, whitening
from hil_forceps.diagnosis.unknowns import Unknown, Unknowns

ROWS, SD = 800, 0.05
Vector = NDArray[np.float64]
TIME: Vector = np.arange(ROWS, dtype=np.float64) * 1e-2
TRUE = np.array([2.0, 1.3])


def response(theta: Vector, nuisances: Sequence[Nuisance]) -> Outputs:
    """Return a sine of unknown amplitude and frequency, in that order, and a zero."""
    return [{"theta_j_rad": theta[0] * np.sin(theta[1] * TIME) + n.theta_j_zero_rad} for n in nuisances]


class Toy(NamedTuple):
    """A simulator made of a function."""

    says: Callable[[Vector, Sequence[Nuisance]], Outputs]

    def __call__(self, theta: Vector, nuisances: Sequence[Nuisance], mapper: Mapper = map) -> Outputs:  # noqa: ARG002
        return self.says(theta, nuisances)

    def only(self, run: int) -> "Toy":
        return Toy(lambda theta, nuisances: self.says(theta, [nuisances[0]] * (run + 1))[run:])

    def coarse(self) -> "Toy":
        return self

    def calmed(self) -> "Toy":
        return self


def unknown(name: str, centre: float, scale: float, *, prior: bool, low: float = -math.inf) -> Unknown:
    return Unknown(name, "", centre, scale, low, math.inf, prior, centre)


def toy(items: tuple[Unknown, ...], seed: int, true: Vector = TRUE, zero: float = 0.0) -> tuple[Problem, Whitener]:
    layout = make_layout([("theta_j_rad",)], [np.ones(ROWS)], [1e-2])
    noise = SD * np.random.default_rng(seed).standard_normal(ROWS)
    [clean] = response(true, [Nuisance(zero, 0.0, np.empty(0))])
    measured = transform(layout, [{"theta_j_rad": clean["theta_j_rad"] + noise}])
    record = Record("a", "closed_loop", 1e-2, TIME, TIME, {}, None, np.empty(0, np.intp), np.ones(ROWS), True)
    names = ["amplitude", "frequency"]
    problem = Problem((record,), layout, measured, Toy(response), true.copy(), names.index, Unknowns(items), 0.1, 0.1)
    return problem, whitening(layout, white_noise(layout, np.full(len(layout.band_channel), SD**2)))


BOTH = (unknown("amplitude", 1.5, 0.5, prior=True), unknown("frequency", 1.32, 0.1, prior=True))


def test_parameters_are_recovered_within_their_intervals() -> None:
    inside = 0
    for seed in range(40):
        problem, whitener = toy(BOTH, seed, zero=0.05)
        found = fit(problem, np.zeros(problem.size), whitener)
        values = problem.shared.values(found.u[:2])
        sd = np.sqrt(np.diag(found.covariance)[:2]) * np.array([0.5, 0.1])
        assert values == pytest.approx(TRUE, rel=0.02)
        inside += int(np.sum(np.abs(values - TRUE) < 1.96 * sd))
    assert 68 <= inside <= 80  # 76 of 80 expected


def test_the_misfit_of_noise_alone_is_its_number_of_entries() -> None:
    problem, whitener = toy(BOTH, 1)
    found = fit(problem, np.zeros(problem.size), whitener)
    assert found.chi2 == pytest.approx(ROWS, abs=6 * math.sqrt(2 * ROWS))


def test_a_prior_pulls_and_a_tight_one_holds() -> None:
    loose, whitener = toy(BOTH, 2)
    tight, _ = toy((unknown("amplitude", 1.5, 1e-5, prior=True), BOTH[1]), 2)
    free, held = (fit(p, np.zeros(p.size), whitener) for p in (loose, tight))
    assert loose.shared.values(free.u[:2])[0] == pytest.approx(2.0, rel=0.02)
    assert tight.shared.values(held.u[:2])[0] == pytest.approx(1.5, rel=0.02)
    assert held.chi2 > free.chi2 + 1000


def test_a_prior_as_sure_as_the_data_meets_them_half_way() -> None:
    sure = SD / math.sqrt(ROWS / 2)  # deviation of a sine's amplitude
    problem, whitener = toy((unknown("amplitude", 1.9, sure, prior=True),), 2)
    found = fit(problem, np.zeros(problem.size), whitener)
    assert problem.shared.values(found.u[:1])[0] == pytest.approx(1.95, abs=0.01)


def test_a_bound_is_kept_and_the_others_are_fitted_on_it() -> None:
    bounded = (unknown("amplitude", 3.0, 0.5, prior=False, low=2.5), BOTH[1])
    problem, whitener = toy(bounded, 3)
    found = fit(problem, np.zeros(problem.size), whitener)
    amplitude, frequency = problem.shared.values(found.u[:2])
    assert amplitude == pytest.approx(2.5)
    assert frequency == pytest.approx(1.3, rel=0.01)


def test_held_sensitivities_lead_to_the_same_fit() -> None:
    problem, whitener = toy(BOTH, 4)
    first = problem.with_shared(Unknowns(BOTH[:1]))
    begun = fit(first, np.zeros(first.size), whitener)
    held = hold(begun.jacobian, 1, whitener)
    start = np.concatenate((begun.u[:1], [0.0], begun.u[1:]))
    cheap, full = fit(problem, start, whitener, held=held, steps=12), fit(problem, start, whitener)
    assert cheap.chi2 == pytest.approx(full.chi2, abs=0.5)


def test_beside_what_is_new_sensitivities_are_found_once_where_the_fit_is() -> None:
    problem, whitener = toy(BOTH, 4)
    begun = fit(problem, np.array([0.3, -0.2, *np.zeros(problem.nuisance_count)]), whitener, steps=1)
    held = hold_beside(begun, problem, whitener, 1)
    there = problem.jacobian(begun.u, problem.simulate(begun.u))
    assert held.shared == 1
    assert np.array_equal(held.columns[:, :1], there[:, :1])
    assert np.array_equal(held.columns[:, 1:], begun.jacobian[:, 2:])
    assert not np.array_equal(held.columns[:, :1], begun.jacobian[:, :1])
    calls: list[int] = []
    counted = replace(problem, simulate_runs=counting(calls))
    once = fit(counted, begun.u, whitener, held=held)
    spent = len(calls)
    again = fit(counted, begun.u, whitener, held=hold_nuisances(begun, problem, whitener))
    assert spent < len(calls) - spent
    assert once.chi2 == pytest.approx(again.chi2, abs=0.05)


def test_what_is_known_follows_an_entry_that_is_put_somewhere() -> None:
    problem, whitener = toy(BOTH, 12)
    first = problem.with_shared(Unknowns(BOTH[:1]))
    begun = fit(first, np.zeros(first.size), whitener)
    held = hold(begun.jacobian, 1, whitener)
    put = np.concatenate((begun.u[:1], [-0.05], begun.u[1:]))
    moved, said = follow(problem, put, whitener, held)
    assert moved[1] == put[1]

    def chi2(u: Vector) -> float:
        return chi2_of(problem, problem.measured - problem.predicted(u), whitener, u)

    assert said == pytest.approx(chi2(moved))
    there = fit(problem, put, whitener)  # it ends elsewhere: the entry is free there
    assert there.chi2 <= chi2(moved) < chi2(put) - 100.0
    for nudge in (-0.1, 0.1):
        assert chi2(moved) < chi2(moved + nudge * np.eye(moved.size)[0])


def test_following_keeps_to_bounds() -> None:
    bounded = (unknown("amplitude", 3.0, 0.5, prior=True, low=2.5), BOTH[1])
    problem, whitener = toy(bounded, 13)
    first = problem.with_shared(Unknowns(bounded[:1]))
    held = hold(fit(first, np.zeros(first.size), whitener).jacobian, 1, whitener)
    moved, _ = follow(problem, np.zeros(problem.size), whitener, held)
    assert problem.shared.values(moved[:2])[0] == 2.5


def test_of_what_would_cross_its_bound_only_that_is_put_there_which_is_best_there() -> None:
    normal, slope, none = np.array([[1.0, 0.9], [0.9, 1.0]]), np.array([-1.0, 1.0]), np.zeros(2)
    low, high = np.array([-1.0, -100.0]), np.array([100.0, 6.0])
    assert np.linalg.solve(normal, slope) == pytest.approx([-10.0, 10.0])  # both would cross
    step = fit_module._step(normal, slope, none, 0.0, none, low, high)
    assert step == pytest.approx([-1.0, 1.9])
    assert fit_module._expected(normal, slope, none, step) > 0.0
    # Both at their bounds would be uphill, and a fit end there.
    assert fit_module._expected(normal, slope, none, np.array([-1.0, 6.0])) < 0.0


def test_a_value_at_its_bound_is_never_beyond_it() -> None:
    rng = np.random.default_rng(14)
    for centre, scale in rng.uniform(1e-7, 1e-3, (200, 2)):
        shared = Unknowns((unknown("amplitude", centre, scale, prior=True, low=0.0),))
        assert 0.0 <= shared.values(shared.bounds()[0])[0] < 1e-15 * centre


def counting(calls: list[int]) -> Toy:
    """Return the toy, counting its simulations."""

    def says(theta: Vector, nuisances: Sequence[Nuisance]) -> Outputs:
        calls.append(1)
        return response(theta, nuisances)

    return Toy(says)


def test_sensitivities_are_kept_as_long_as_they_foretell_the_fall(monkeypatch: pytest.MonkeyPatch) -> None:
    near = (unknown("amplitude", 1.98, 0.5, prior=True), unknown("frequency", 1.299, 0.1, prior=True))

    def simulations() -> tuple[int, Fit]:
        problem, whitener = toy(near, 9)
        calls: list[int] = []
        found = fit(replace(problem, simulate_runs=counting(calls)), np.zeros(problem.size), whitener)
        return len(calls), found

    kept, found = simulations()
    monkeypatch.setattr(fit_module, "TRUSTED", -1.0)  # never
    anew, other = simulations()
    assert kept < anew
    assert found.chi2 == pytest.approx(other.chi2, abs=0.01)


def test_fitting_again_takes_no_new_sensitivities() -> None:
    problem, whitener = toy(BOTH, 10)
    found = fit(problem, np.zeros(problem.size), whitener)
    louder = whitening(problem.layout, white_noise(problem.layout, np.full(len(problem.layout.band_channel), 0.01)))
    calls: list[int] = []
    again = fit_again(replace(problem, simulate_runs=counting(calls)), found, louder)
    assert len(calls) <= 1 + again.steps * MAX_DAMPINGS
    assert again.chi2 == pytest.approx(fit(problem, found.u, louder).chi2, abs=0.05)


def test_an_amplitude_that_is_off_is_at_no_bound_unless_it_is_the_only_one() -> None:
    off = Unknown("effects.a.stiffness", "", 0.5, 0.5, 0.0, 1.0, False, 0.0)
    other = Unknown("effects.a.torque", "", 0.0, 0.5, -1.0, 1.0, False, 0.0)
    for items, u, expected in (
        ((off, other), (-1.0, 0.3), False),
        ((off, other), (-1.0, 2.0), True),
        ((off, other), (1.0, 0.3), True),
        ((off,), (-1.0,), True),
    ):
        problem, whitener = toy((*BOTH, *items), 11)
        found = fit(toy(BOTH, 11)[0], np.zeros(4), whitener)._replace(u=np.array([0.0, 0.0, *u, 0.0, 0.0]))
        assert at_an_end(problem, found, "a") is expected


def test_a_direction_that_only_the_prior_knows_keeps_the_prior_s_deviation() -> None:
    """Two parameters of which the data see the product: together they are as uncertain as before."""

    def product(theta: Vector, nuisances: Sequence[Nuisance]) -> Outputs:
        return [{"theta_j_rad": 1e4 * theta[0] * theta[1] * np.sin(TIME)} for _ in nuisances]

    items = (unknown("amplitude", 1.0, 0.1, prior=True), unknown("frequency", 1.0, 0.1, prior=True))
    problem, whitener = toy(items, 5, np.ones(2))
    exact = transform(problem.layout, product(np.ones(2), [Nuisance(0.0, 0.0, np.empty(0))]))
    problem = Problem(
        problem.records, problem.layout, exact, Toy(product), np.ones(2), problem.index_of, problem.shared, 0.1, 0.1
    )
    found = fit(problem, np.zeros(problem.size), whitener)
    sd = np.sqrt(np.diag(found.covariance)[:2])
    assert sd == pytest.approx([math.sqrt(0.5)] * 2, rel=0.1)


def test_gram_keeps_small_entries() -> None:
    left = np.random.default_rng(6).standard_normal((200_000, 2)).astype(np.float32)
    assert gram(left, left) == pytest.approx(left.astype(float).T @ left.astype(float), rel=1e-4, abs=1.0)


def jumping(theta: Vector, nuisances: Sequence[Nuisance]) -> Outputs:
    """Return a sine and two pulses, each the higher the earlier in its row it begins."""
    late = [np.where((TIME > 1.0) & (TIME < 1.1), 1.0 - n.edge_fractions[0], 0.0) for n in nuisances]
    later = [np.where((TIME > 5.0) & (TIME < 5.1), 1.0 - n.edge_fractions[1], 0.0) for n in nuisances]
    sines = response(theta, nuisances)
    return [{"theta_j_rad": s["theta_j_rad"] + a + b} for s, a, b in zip(sines, late, later, strict=True)]


@pytest.mark.parametrize(
    "fractions", [(1.0, 0.4), (0.0, 0.995)], ids=["at the upper end", "at the lower, near the upper"]
)
def test_a_jump_at_an_end_of_its_row_is_felt_and_does_not_end_a_fit(fractions: tuple[float, float]) -> None:
    items = (unknown("amplitude", 1.9, 1.0, prior=False), unknown("frequency", 1.3, 0.1, prior=False))
    problem, whitener = toy(items, 3)
    edges = np.array([100, 500], dtype=np.intp)
    [clean] = jumping(TRUE, [Nuisance(0.0, 0.0, np.array(fractions))])
    noise = SD * np.random.default_rng(3).standard_normal(ROWS)
    measured = transform(problem.layout, [{"theta_j_rad": clean["theta_j_rad"] + noise}])
    records = (problem.records[0]._replace(edge_rows=edges),)
    problem = replace(problem, records=records, measured=measured, simulate_runs=Toy(jumping))
    _, high = problem.bounds()
    at_end = np.r_[0.0, 0.0, 0.0, 0.0, np.minimum(high[4:], (np.array(fractions) - 0.5) / EDGE_SD)]
    columns = whitener.apply(problem.jacobian(at_end, problem.simulate(at_end)))[:, 4:]
    middle = at_end.copy()
    middle[4:] = 0.0
    usual = whitener.apply(problem.jacobian(middle, problem.simulate(middle)))[:, 4:]
    np.testing.assert_allclose(np.linalg.norm(columns, axis=0), np.linalg.norm(usual, axis=0), rtol=0.05)
    fitted = fit(problem, at_end, whitener)
    np.testing.assert_allclose(problem.nuisances(fitted.u)[0].edge_fractions, fractions, atol=0.06)
    assert problem.shared.values(fitted.u[:2])[0] == pytest.approx(TRUE[0], abs=0.01)
