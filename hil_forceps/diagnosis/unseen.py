"""What a model leaves in runs that were never used: a neighbour of the true cause is found out where motion is another.

An entry that stands in for one that the catalogue lacks takes the values that suit the runs it was fitted to. So the
model is held to them, within a fit's deviations, and what it leaves in the other runs is looked at as in the first.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.anew import courses_of
from hil_forceps.diagnosis.assemble import Setting, assemble, aware_of_load, responses_of
from hil_forceps.diagnosis.experiment import Record
from hil_forceps.diagnosis.extension import Model, Refresh
from hil_forceps.diagnosis.fit import Fit, fit_own, gram, inverse, sum_of_squares
from hil_forceps.diagnosis.leftover import Beside, Leftover, curves_along, left_by_columns, whitened
from hil_forceps.diagnosis.look import noise_of
from hil_forceps.diagnosis.problem import Outputs
from hil_forceps.diagnosis.ringing import beside_own_unknowns, deepest_valley, moved_to
from hil_forceps.diagnosis.spectrum import Flat, Whitener, transform, white_noise
from hil_forceps.model import parameters
from hil_forceps.rig import Rig
from hil_forceps.rig.catalogue import effect

Vector = NDArray[np.float64]

STEPS = 4
RINGS = 2  # the encoder's rounding as it is taken holds some of the ringing
NOISE_ROUNDS = 2
SHARES = (1.0, 0.3, 0.1)  # of a step, until it helps
SMALL_FALL = 1.0  # of χ²
DOUBT = 2.0  # times the deviations of the fit, which are of its noise alone


class Known(NamedTuple):
    """What the fitted runs say of the shared unknowns, in units of their scales."""

    centre: Vector
    covariance: NDArray[np.float64]


def left_unseen(chosen: Model, records: Sequence[Record], rig: Rig, refresh: Refresh, seed: int) -> Leftover:
    """Return what curves find in runs that a model was not fitted to, beside it.

    Where they find something, the model is first fitted to these runs, no further than its deviations allow.
    """
    setting, model, whitener = _beside(chosen, records, rig, refresh)
    count = len(chosen.problem.shared.items)
    known = Known(chosen.fit.u[:count], DOUBT**2 * chosen.fit.covariance[:count, :count])
    left = _left(known, setting, model, whitener, rig, seed)
    if not left.stands_out:
        return left
    explained = _explained(model, whitener)
    place, model = _rung(model, whitener, refresh)
    if place is not None:
        known = _apart(known, place)
    model = _within_doubt(model, known, whitener)
    return _left(known, setting, model, whitener, rig, seed)._replace(explained=explained)


def _explained(model: Model, whitener: Whitener) -> float:
    """Return by how much χ² is higher with all effects of a model off, the rest as it is."""
    problem = model.problem
    theta = problem.theta(model.fit.u)
    for name in model.effects:
        for parameter in effect(name).parameters:
            key = f"effects.{name}.{parameter.name}"
            theta[parameters.index(key)] = parameters.off_value(key)
    outputs = problem.simulate_runs(theta, problem.nuisances(model.fit.u), problem.mapper)
    without, there = problem.measured - transform(problem.layout, outputs), model.fit.residual
    return sum_of_squares(whitener.apply(without)) - sum_of_squares(whitener.apply(there))


def _left(known: Known, setting: Setting, model: Model, whitener: Whitener, rig: Rig, seed: int) -> Leftover:
    """Return what curves find beside a model, its shared unknowns held to what is known of them."""
    problem = model.problem
    responses = responses_of(setting.simulator, problem.theta(model.fit.u), rig)
    curves = curves_along(courses_of(setting, model), problem.layout, responses, problem.mapper)
    for _ in range(NOISE_ROUNDS):
        noise, _ = noise_of(model, curves.columns, whitener, setting.floor)
        whitener = problem.whitener(noise)
    white = whitener.apply(model.fit.jacobian)
    count = len(problem.shared.items)
    root = _root(known.covariance)
    fitted = np.concatenate((white[:, :count] @ root.astype(np.float32), white[:, count:]), axis=1)
    moved = np.linalg.lstsq(root, model.fit.u[:count] - known.centre, rcond=None)[0]
    u = np.concatenate((moved, model.fit.u[count:]))
    residual = whitener.apply(model.fit.residual)
    return left_by_columns(
        problem.layout, Beside(fitted, np.ones(u.size), u), residual, whitened(curves, whitener), seed
    )


def _beside(chosen: Model, records: Sequence[Record], rig: Rig, refresh: Refresh) -> tuple[Setting, Model, Whitener]:
    """Return the model beside other runs; only what belongs to each run (zeros, start) is fitted to it."""
    setting = assemble(records, rig, chosen.problem.mapper, chosen.problem.shared)
    setting = aware_of_load(setting, chosen.problem.theta(chosen.fit.u), rig)
    count = len(chosen.problem.shared.items)
    problem = replace(setting.problem, base=chosen.problem.base)
    u = np.concatenate((chosen.fit.u[:count], np.zeros(problem.nuisance_count)))
    problem = refresh(problem, u)
    whitener = problem.whitener(white_noise(problem.layout, setting.first_power))
    own = fit_own(problem, u, whitener, STEPS)
    u = np.concatenate((u[:count], own.u))
    shared = problem.shared_columns(u, own.outputs, range(count))
    columns = np.concatenate((shared, own.jacobian), axis=1)
    found = Fit(u, own.chi2, own.residual, own.outputs, columns, own.covariance, 0)
    return setting, replace(chosen, problem=problem, fit=found), whitener


def _rung(model: Model, whitener: Whitener, refresh: Refresh) -> tuple[int | None, Model]:
    """Return the place of the jaw's inertia, and the model with the inertia that these runs' ringing shows.

    None, and the model as it is, where that is no better.

    A jaw that hardly rings in the fitted runs has its inertia to some percent; where it rings for tens of periods, no
    linear step from there tells what that does.
    """
    problem, u = model.problem, model.fit.u
    valley = deepest_valley(problem, u, whitener)
    if valley is None:
        return None, model
    u = moved_to(problem, u, valley.place, valley.inertia_kg_m2)
    for _ in range(RINGS):
        problem = refresh(problem, u)
        u = beside_own_unknowns(problem, u, valley.place, whitener)
    problem = refresh(problem, u)
    outputs = problem.simulate(u)
    residual = problem.measured - transform(problem.layout, outputs)
    chi2 = sum_of_squares(whitener.apply(residual))
    if chi2 >= sum_of_squares(whitener.apply(model.fit.residual)):
        return None, model
    jacobian = problem.jacobian(u, outputs)
    found = model.fit._replace(u=u, chi2=chi2, residual=residual, outputs=outputs, jacobian=jacobian)
    return valley.place, replace(model, problem=problem, fit=found)


def _apart(known: Known, place: int) -> Known:
    """Return the same with one unknown that says nothing of the others.

    Sensitivities of a calm load know little of ringing: what they tell of the inertia and others together would drag
    these along when the inertia is put right (a friction by a quarter, 90 of χ²).
    """
    covariance = known.covariance.copy()
    covariance[place], covariance[:, place] = 0.0, 0.0
    covariance[place, place] = known.covariance[place, place]
    return known._replace(covariance=covariance)


def _within_doubt(model: Model, known: Known, whitener: Whitener) -> Model:
    """Fit all unknowns, the shared ones held to what is known of them."""
    problem, found = model.problem, model.fit
    jacobian, count = found.jacobian, len(problem.shared.items)
    precision = np.eye(found.u.size)  # of nuisances: their priors
    precision[:count, :count] = inverse(known.covariance)
    centre = np.concatenate((known.centre, np.zeros(found.u.size - count)))
    low, high = problem.bounds()

    def at(point: Vector) -> tuple[float, Flat, Outputs]:
        outputs = problem.simulate(point)
        residual = problem.measured - transform(problem.layout, outputs)
        away = point - centre
        return sum_of_squares(whitener.apply(residual)) + float(away @ precision @ away), residual, outputs

    u, (chi2, residual, outputs) = found.u, at(found.u)
    for _ in range(STEPS):
        white = whitener.apply(jacobian)
        normal = gram(white, white, problem.mapper) + precision
        slope = gram(white, whitener.apply(residual)[:, None])[:, 0] - precision @ (u - centre)
        step = inverse(normal) @ slope
        for share in SHARES:
            candidate = np.clip(u + share * step, low, high)
            after = at(candidate)
            if after[0] < chi2 - SMALL_FALL:
                break
        else:
            break
        u, (chi2, residual, outputs) = candidate, after
        jacobian = problem.jacobian(u, outputs)
    fitted = found._replace(u=u, chi2=chi2, residual=residual, outputs=outputs, jacobian=jacobian)
    return replace(model, fit=fitted)


def _root(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return L with L Lᵀ = covariance."""
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    return np.asarray(size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))
