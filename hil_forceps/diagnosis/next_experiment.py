"""Which experiment to make next, and how well it would tell apart what is still tied.

Both models are simulated on each experiment of the menu. Their difference D, whitened with the noise measured so far,
counts only where the rival can't follow it by refitting: with J the rival's sensitivities there and H what the runs so
far know of its parameters (inverse covariance; priors for nuisances of the new run),

    d² = DᵀD − DᵀJ (H + JᵀJ)⁻¹ JᵀD,

which is what χ² of the rival's refit is expected to rise above that of the truth. The truth's own parameters are known
as far as the runs tell: d is what is reached or exceeded for `SURE` of the values that they leave possible.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.assemble import responses_of
from hil_forceps.diagnosis.diagnose import Findings
from hil_forceps.diagnosis.experiment import BURN_IN_S, Record, jumps
from hil_forceps.diagnosis.experiment_design.next_experiment import (
    MOST_RIVALS,
    MOST_TARGETS,
    VISIBLE,
    Proposal,
    least_visible,
    most_telling,
    turned_over,
)
from hil_forceps.diagnosis.extension import Model
from hil_forceps.diagnosis.fit import gram
from hil_forceps.diagnosis.load_course import load_course
from hil_forceps.diagnosis.load_errors import with_load_errors
from hil_forceps.diagnosis.mapper import Mapper
from hil_forceps.diagnosis.menu import Bounds, Experiment, bounds_of, menu, trajectory_of
from hil_forceps.diagnosis.predict import ClosedLoop
from hil_forceps.diagnosis.problem import Matrix, Nuisance, Outputs, Problem
from hil_forceps.diagnosis.result import Detectable, NextExperiment
from hil_forceps.diagnosis.smoothing import drawn_noise
from hil_forceps.diagnosis.spectrum import Flat, Layout, Noise, Whitener, make_layout, transform
from hil_forceps.model import closed_loop, parameters
from hil_forceps.rig.catalogue import EFFECTS

Vector = NDArray[np.float64]

DRAWS = 400
SURE = 0.8


class Stage(NamedTuple):
    """An experiment seen by one model: where it is linear, and what it says there."""

    problem: Problem
    whitener: Whitener
    said: Flat
    white: Matrix  # its sensitivities, whitened
    known: NDArray[np.float64]  # H


def propose(found: Findings, least: dict[str, Detectable]) -> Proposal | None:
    """Return the experiment that tells most; None where the menu holds none that would tell anything.

    `least`: the smallest size of each effect that the runs would show, as the result has it.
    """
    if not isinstance(found.setting.simulator, ClosedLoop):
        return None  # without the drive's law no motion can be foretold
    offered = _offered(found)
    tied = tuple(dict.fromkeys(rival.model.effects for rival in found.choice.rivals if rival.model.effects))
    if len(tied) > 1:
        return _to_separate(found, offered)
    return _to_see(found, offered, least)


def _offered(found: Findings) -> list[Experiment]:
    angles = [record.channels["theta_m_rad"] for record in found.records]
    bounds: Bounds = bounds_of(found.rig, min(float(a.min()) for a in angles), max(float(a.max()) for a in angles))
    measured = all(record.tau_w_N_m is not None for record in found.records)
    return [e for e in menu(bounds) if measured or not e.loaded]


def _to_separate(found: Findings, offered: Sequence[Experiment]) -> Proposal | None:
    """Choose what separates the best of the tied models from that which it separates worst."""
    truth, *others = [_alone(rival.model) for rival in found.choice.rivals[:MOST_RIVALS]]

    def separated(experiment: Experiment) -> float:
        return min(separation(found, experiment, truth, other) for other in others)

    reached = list(found.choice.model.problem.mapper(separated, offered))
    best = most_telling(offered, reached)
    if reached[best] <= 0.0:
        return None
    experiment = offered[best]
    pairs = tuple(tuple(m.effects) for m in (truth, *others))
    said = f"{experiment.instruction} It excites {experiment.excites}."
    result = NextExperiment(experiment.name, pairs, reached[best], said)
    return Proposal(result, trajectory_of(experiment, found.rig))


def _to_see(found: Findings, offered: Sequence[Experiment], least: dict[str, Detectable]) -> Proposal | None:
    """Choose what shows best the effect that the runs show least, of those that any experiment would show."""
    model = found.choice.model
    alone, mapper = _alone(model), model.problem.mapper
    stages = list(mapper(lambda e: stage_of(found, e, alone), offered))
    best: tuple[float, Experiment, str] | None = None
    for effect_id in least_visible(least, model.effects)[:MOST_TARGETS]:
        other = _theta_with(model, effect_id)
        reached = list(mapper(partial(_difference, other), stages))
        k = most_telling(offered, reached)
        if best is None or reached[k] > best[0]:
            best = (reached[k], offered[k], effect_id)
        if best[0] >= VISIBLE:
            break
    if best is None or best[0] <= 0.0:
        return None
    d, experiment, effect_id = best
    said = (
        f"{experiment.instruction} It excites {experiment.excites}. Nothing is tied; of what these data show least, "
        f"{effect_id} of the usual size would show there."
    )
    return Proposal(NextExperiment(experiment.name, (), d, said), trajectory_of(experiment, found.rig))


def _alone(model: Model) -> Model:
    """Return a model that maps nothing: the experiments share the cores, not its parts."""
    return replace(model, problem=replace(model.problem, mapper=map))


def _theta_with(model: Model, effect_id: str) -> Vector:
    theta = model.problem.theta(model.fit.u)
    entry = next(e for e in EFFECTS if e.id == effect_id)
    for p in entry.parameters:
        theta[parameters.index(f"effects.{effect_id}.{p.name}")] = p.typical
    return theta


def separation(found: Findings, experiment: Experiment, one: Model, other: Model) -> float:
    """Return d: how far the refit of either stays from what the other does in an experiment, in standard deviations."""
    a, b = stage_of(found, experiment, one), stage_of(found, experiment, other)
    return min(_reached(a, b), _reached(b, a))


def _reached(truth: Stage, rival: Stage) -> float:
    """Return the d that is reached for `SURE` of the truth's possible parameters."""
    apart = rival.whitener.apply(truth.said - rival.said)
    count = len(truth.problem.shared.items)
    left = _left(rival, np.column_stack((apart, truth.white[:, :count])))
    covariance = np.linalg.pinv(truth.known[:count, :count], hermitian=True)
    values, vectors = np.linalg.eigh(covariance)
    scatter = np.random.default_rng(0).standard_normal((DRAWS, count)) * np.sqrt(np.maximum(values, 0.0))
    draws = np.column_stack((np.ones(DRAWS), scatter @ vectors.T))
    squares = np.einsum("ki,ij,kj->k", draws, left, draws)
    return math.sqrt(max(float(np.quantile(squares, 1.0 - SURE)), 0.0)) if np.isfinite(squares).all() else 0.0


def _left(stage: Stage, columns: Matrix) -> NDArray[np.float64]:
    """Return the Gram matrix of whitened columns, less what refitting the stage's model takes up."""
    cross = gram(stage.white, columns)
    solved = np.linalg.lstsq(stage.known + gram(stage.white, stage.white), cross, rcond=1e-12)[0]
    return gram(columns, columns) - cross.T @ solved


def stage_of(found: Findings, experiment: Experiment, model: Model) -> Stage:
    """Put a fitted model on an experiment."""
    problem = _problem(found, experiment, model)
    count = len(problem.shared.items)
    u = np.concatenate((model.fit.u[:count], np.zeros(problem.nuisance_count)))
    outputs = problem.simulate(u)
    whitener = problem.whitener(noise_on(problem.layout, found.choice.model.problem.layout, found.choice.noise))
    known = np.eye(problem.size)
    covariance = model.fit.covariance[:count, :count]
    known[:count, :count] = np.linalg.pinv(covariance, hermitian=True) if count else covariance
    white = whitener.apply(problem.jacobian(u, outputs))
    return Stage(problem, whitener, transform(problem.layout, outputs), white, known)


def _difference(theta: Vector, stage: Stage) -> float:
    problem = stage.problem
    nuisances = problem.nuisances(np.zeros(problem.size))
    said = transform(problem.layout, problem.simulate_runs(theta, nuisances))
    apart = stage.whitener.apply(said - stage.said)
    if not np.isfinite(apart).all():
        return 0.0
    return math.sqrt(max(float(_left(stage, apart[:, None])[0, 0]), 0.0))


class _TurnedOver(NamedTuple):
    """Simulates with the weight pulling the other way."""

    upright: ClosedLoop

    def __call__(self, theta: Vector, nuisances: Sequence[Nuisance], mapper: Mapper = map) -> Outputs:
        """Return the transformed channels of each run."""
        return self.upright(turned_over(theta), nuisances, mapper)

    def only(self, run: int) -> "_TurnedOver":
        """Return the same of one run."""
        return _TurnedOver(self.upright.only(run))

    def coarse(self) -> "_TurnedOver":
        """Return the same in longer steps."""
        return _TurnedOver(self.upright.coarse())

    def calmed(self) -> "_TurnedOver":
        """Return the same without what is quick in the load."""
        return _TurnedOver(self.upright.calmed())


def _problem(found: Findings, experiment: Experiment, model: Model) -> Problem:
    """Return the problem of fitting a model to the experiment alone."""
    simulator = found.setting.simulator
    record = record_of(experiment, found.records[0])
    theta = model.problem.theta(model.fit.u)
    start = closed_loop.rest(theta, float(record.reference_rad[0]))
    if not isinstance(simulator, ClosedLoop):
        raise TypeError("an experiment is foretold in closed loop only")
    staged = ClosedLoop((record,), simulator.law, (start,), (np.empty(0),), reference=simulator.reference).coarse()
    layout = make_layout([list(record.channels)], [record.weights], [record.period_s])
    sensors = dict(zip(found.setting.problem.layout.band_channel, found.setting.first_power, strict=True))
    power = np.array([sensors[name] for name in layout.band_channel])
    layout = with_load_errors(layout, (record,), responses_of(staged, theta, found.rig), power)
    return replace(
        model.problem,
        records=(record,),
        layout=layout,
        measured=np.zeros(layout.size, dtype=np.float32),
        simulate_runs=_TurnedOver(staged) if experiment.turned_over else staged,
    )


def record_of(experiment: Experiment, like: Record) -> Record:
    """Return the rows that an experiment would give, with the channels and the period of a run that was made."""
    period = like.period_s
    rows = round(float(experiment.time_s[-1]) / period)  # without the last instant: 12 000 are far sooner transformed
    time: Vector = period * np.arange(rows, dtype=np.float64)
    load = np.interp(time, experiment.time_s, experiment.load_N_m)
    weights = np.ones(rows)
    weights[: max(1, round(BURN_IN_S / period))] = 0.0
    error = None
    if like.load_noise is not None:
        noise = drawn_noise(np.random.default_rng(rows), rows, period, like.load_noise)
        error = load_course(load + noise, jumps(load), period, like.load_noise).error
    return Record(
        experiment.name,
        "closed_loop",
        period,
        time,
        np.interp(time, experiment.time_s, experiment.theta_m_rad),
        {name: np.zeros(rows) for name in like.channels},
        load if like.tau_w_N_m is not None else None,
        jumps(load),
        weights,
        like.evenly_logged,
        load_error=error,
    )


def noise_on(layout: Layout, measured_on: Layout, noise: Noise) -> Noise:
    """Return the noise that was measured on other runs, for the bands of this layout: the nearest in frequency."""
    channels = np.array(measured_on.band_channel)
    power, mix = [], []
    for name, middle in zip(layout.band_channel, layout.band_Hz, strict=True):
        away = np.where(channels == name, np.abs(np.log(measured_on.band_Hz / middle)), np.inf)
        nearest = np.flatnonzero(away <= away.min() + 1e-9)  # one of each run
        power.append(noise.power[nearest].mean())
        mix.append(noise.mix[nearest].mean())
    return Noise(np.array(power), np.array(mix))
