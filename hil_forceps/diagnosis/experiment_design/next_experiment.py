"""Which experiment to make next, and how well it would tell apart what is still tied.

A motion of the menu is simulated with one model and filtered with the rival. With e the whitened innovations, J their
answers to the rival's parameters and H what the runs so far know of these,

    d² = eᵀe − eᵀJ (H + JᵀJ)⁻¹ Jᵀe,

which is what χ² of the rival's refit is expected to rise above that of the truth.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.control.trajectories import Trajectory
from hil_forceps.data.even_rows import EvenRun
from hil_forceps.data.run import Run
from hil_forceps.diagnosis.evidence import Mapper, gram, pass_all
from hil_forceps.diagnosis.experiment_design.menu import Experiment, bounds_of, menu, trajectory_of
from hil_forceps.diagnosis.identified import GAUGES, Identified
from hil_forceps.diagnosis.inference.fit import Fit, Posterior, directions_of, fit_from, inverted, penalised
from hil_forceps.diagnosis.inference.parameters import start_of, with_effect
from hil_forceps.diagnosis.preparation.records import Record, record_of
from hil_forceps.diagnosis.result import Detectable, NextExperiment
from hil_forceps.diagnosis.state_space.advance import steps_in_row
from hil_forceps.model import closed_loop, parameters
from hil_forceps.model.closed_loop import Inputs
from hil_forceps.model.drive_law import law_vector
from hil_forceps.rig import Rig
from hil_forceps.rig.catalogue import EFFECTS, effect

Vector = NDArray[np.float64]

MOST_RIVALS = 3  # the best ones; each is filtered on the whole menu
MOST_TARGETS = 4  # effects that are looked at where nothing is tied
VISIBLE = 4.0  # d from which on an effect would be found more often than not


class Proposal(NamedTuple):
    """The next experiment, and the motion that `hil-forceps run --trajectory` gives it."""

    result: NextExperiment
    trajectory: Trajectory


class Design(NamedTuple):
    """What experiments are foretold with."""

    rig: Rig
    found: Identified
    offered: tuple[Experiment, ...]
    mapper: Mapper


def propose(
    found: Identified, rig: Rig, runs: Sequence[Run], least: Mapping[str, Detectable], mapper: Mapper
) -> Proposal:
    """Return the experiment that tells most; `least`: the smallest size of each effect that the runs would show."""
    angles = [run.columns["theta_m_rad"] for run in runs]
    bounds = bounds_of(rig, min(float(a.min()) for a in angles), max(float(a.max()) for a in angles))
    measured = all("tau_w_N_m" in run.columns for run in runs)
    offered = tuple(e for e in menu(bounds) if measured or not e.loaded)
    design = Design(rig, found, offered, mapper)
    tied = [model for model in found.found.rivals if model.effects][:MOST_RIVALS]
    return _to_separate(design, [m.fit for m in tied]) if len(tied) > 1 else _to_see(design, least)


def _to_separate(design: Design, fits: Sequence[Fit]) -> Proposal:
    """Choose what separates the best of the tied models from that which it separates worst."""
    truth, *others = fits
    pairs = [pair for other in others for pair in ((truth, other), (other, truth))]

    def separation(experiment: Experiment) -> float:
        return min(expected(design, experiment, one.passes.theta, rival) for one, rival in pairs)

    best = most_telling(design.offered, list(design.mapper(separation, design.offered)))
    experiment = design.offered[best]

    def refitted(pair: tuple[Fit, Fit]) -> float:
        return refitted_separation(design, experiment, pair[0].passes.theta, pair[1])

    tied = tuple(model.effects for model in design.found.found.rivals[:MOST_RIVALS] if model.effects)
    said = f"{experiment.instruction} It excites {experiment.excites}."
    result = NextExperiment(experiment.name, tied, min(design.mapper(refitted, pairs)), said)
    return Proposal(result, trajectory_of(experiment, design.rig))


def _to_see(design: Design, least: Mapping[str, Detectable]) -> Proposal:
    """Choose what shows best the effect that the runs show least, of those that any experiment would show."""
    fitted = design.found.found.best.fit
    best: tuple[float, Experiment, str] | None = None
    for effect_id in least_visible(least, (*design.found.found.best.effects, *GAUGES))[:MOST_TARGETS]:
        typical = start_of(effect_id, {p.name: p.typical for p in effect(effect_id).parameters})
        truth = with_effect(fitted.passes.theta, effect_id, typical)
        reached = list(design.mapper(_against(design, truth, fitted), design.offered))
        k = most_telling(design.offered, reached)
        if best is None or reached[k] > best[0]:
            best = (reached[k], design.offered[k], effect_id)
        if best[0] >= VISIBLE:
            break
    if best is None:
        raise ValueError("every effect of the catalogue is named")
    d, experiment, effect_id = best
    said = (
        f"{experiment.instruction} It excites {experiment.excites}. Nothing is tied; of what these data show least, "
        f"{effect_id} of the usual size would show there."
    )
    return Proposal(NextExperiment(experiment.name, (), d, said), trajectory_of(experiment, design.rig))


def _against(design: Design, truth: Vector, rival: Fit) -> Callable[[Experiment], float]:
    return lambda experiment: expected(design, experiment, truth, rival)


def most_telling(offered: Sequence[Experiment], reached: Sequence[float]) -> int:
    """Return which experiment tells most for its time: d² grows with the time, and any motion can be repeated."""
    return int(np.argmax([d / math.sqrt(float(e.time_s[-1])) for e, d in zip(offered, reached, strict=True)]))


def least_visible(least: Mapping[str, Detectable], named: Sequence[str]) -> list[str]:
    """Return the entries in order of the least size that shows, over the usual one; those that never show first."""
    sizes: dict[str, float] = {}
    for entry in EFFECTS:
        amplitudes = {p.name: p.typical for p in entry.parameters if p.neutral is not None}
        if entry.id in named or not amplitudes:
            continue
        shown = least.get(entry.id)
        sizes[entry.id] = math.inf if shown is None else shown.value / abs(amplitudes[shown.parameter])
    return sorted(sizes, key=lambda effect_id: -sizes[effect_id])


def _told(design: Design, experiment: Experiment, truth: Vector, rival: Fit) -> tuple[Record, Vector, Vector] | None:
    """Return what an experiment would show, the truth in it and the rival's parameters; None if it diverges."""
    theta = rival.passes.theta
    if experiment.turned_over:
        truth, theta = turned_over(truth), turned_over(theta)
    run = foretold(experiment, design.rig, truth, design.found.records[0])
    if not all(np.isfinite(values).all() for values in run.columns.values()):
        return None
    record = record_of(EvenRun.whole(run), design.rig, design.found.noise)
    return record.with_friction_of(rival.passes.plant), truth, theta


def expected(design: Design, experiment: Experiment, truth: Vector, rival: Fit) -> float:
    """Return d: how far the rival's refit stays from what the truth does in an experiment, in standard deviations.

    The refit is linear, of a model whose parameters are known as they are now.
    """
    told = _told(design, experiment, truth, rival)
    if told is None:
        return 0.0
    record, truth, theta = told
    passes = pass_all([record], theta, map)
    # Both pass the same counts and holds: what the rival's innovations have beyond the truth's own is what tells.
    own = pass_all([record], truth, map).runs[0]
    apart = np.where(passes.runs[0].counts & own.counts, passes.runs[0].residual - own.residual, 0.0)
    runs = (passes.runs[0]._replace(filtered=passes.runs[0].filtered._replace(residual=apart)),)
    answers = gram(passes._replace(runs=runs), directions_of(rival.free, theta), map)
    taken = answers.score @ inverted(inverted(rival.covariance) + answers.information) @ answers.score
    left = float(np.sum(apart**2)) - float(taken)
    return math.sqrt(left) if math.isfinite(left) and left > 0.0 else 0.0


def refitted_separation(design: Design, experiment: Experiment, truth: Vector, rival: Fit) -> float:
    """Return d by a refit to what the experiment would show, prior: what the rival's fit knows.

    The linear refit of `expected` overstates it: a count that is far off tells more than one that a refit comes near.
    """
    told = _told(design, experiment, truth, rival)
    if told is None:
        return 0.0
    record, truth, theta = told
    known = Posterior(theta, inverted(rival.covariance))
    found = fit_from([record], pass_all([record], theta, map), rival.free, map, known)
    own = pass_all([record], truth, map)
    left = 2.0 * (penalised(own, (), found.passes) - penalised(found.passes, rival.free, own, known))
    return math.sqrt(left) if math.isfinite(left) and left > 0.0 else 0.0


def foretold(experiment: Experiment, rig: Rig, theta: Vector, like: Record) -> Run:
    """Return the rows that an experiment would give without noise, with channels and period of a run that was made."""
    series, law = like.series, law_vector(rig.require_drive())
    count, samples = round(float(experiment.time_s[-1]) / series.period_s), series.samples
    time_s = series.period_s * np.arange(count, dtype=np.float64)
    every = series.period_s / samples * np.arange(count * samples, dtype=np.float64)
    reference = np.interp(every, experiment.time_s, experiment.theta_m_rad)
    load = np.interp(time_s, experiment.time_s, experiment.load_N_m)
    inputs = Inputs(time_s, reference, load, np.empty(0, dtype=np.int64), np.empty(0))
    start = closed_loop.rest(theta, float(reference[0]))
    steps = steps_in_row(series.period_s) * samples
    shown = closed_loop.simulate(theta, law, series.count_rad, inputs, start, steps, samples)
    columns = {
        "time_s": time_s,
        "theta_m_ref_rad": reference[::samples],
        "theta_m_rad": shown.theta_m_rad,
        "current_A": shown.current_A,
    }
    if math.isfinite(series.jaw_rad[0]):
        columns["theta_j_rad"] = shown.theta_j_rad
    if math.isfinite(series.load_N_m[0]):
        columns["tau_w_N_m"] = load
    return Run(experiment.name, columns)


def turned_over(theta: Vector) -> Vector:
    """Return the parameters of the forceps on its other side: the weight pulls the other way."""
    turned = theta.copy()
    for name in ("cosine_N_m", "sine_N_m"):
        turned[parameters.index(f"effects.jaw_gravity.{name}")] *= -1.0
    return turned
