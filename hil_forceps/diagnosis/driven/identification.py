"""Identify a forceps from runs whose drive isn't known, driven by the motion as measured."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hil_forceps.audit.finding import Finding
from hil_forceps.data.run import Run
from hil_forceps.diagnosis.driven.jaw_zero import without_jaw_zero
from hil_forceps.diagnosis.driven.noise import Adapting, noise_of_strokes
from hil_forceps.diagnosis.driven.passed import DrivenRun, driven_runs
from hil_forceps.diagnosis.driven.rows import driven_rows
from hil_forceps.diagnosis.driven.starting_values import K_T, completed
from hil_forceps.diagnosis.evidence import Mapper, pass_all
from hil_forceps.diagnosis.hypotheses.candidate import Search
from hil_forceps.diagnosis.hypotheses.score_test import Prior
from hil_forceps.diagnosis.hypotheses.search import fit_known
from hil_forceps.diagnosis.identified import GAUGES, LIKE_A_LOAD, Identified, searched
from hil_forceps.diagnosis.inference.dispersion import Weigh
from hil_forceps.diagnosis.inference.fit import Fit, Posterior
from hil_forceps.diagnosis.inference.parameters import Free, known, known_parameters
from hil_forceps.diagnosis.lack_of_fit.omnibus_test import LackOfFit, omnibus_test
from hil_forceps.diagnosis.options import Options
from hil_forceps.diagnosis.state_space.layout import Noise
from hil_forceps.model import parameters
from hil_forceps.rig import Rig

# What is left of other causes is no noise, and some entry follows a little of it (0.7 % by a weight on an axis that
# lies flat, for the worse in the runs held out).
LEAST_SHARE = 0.01  # of what is explained, that a further entry must gain
MOST_EFFECTS = 8  # a real instrument has many


class DrivenIdentified(NamedTuple):
    """What the runs say."""

    found: Identified
    rig: Rig  # with a starting value for all that it doesn't know
    notes: tuple[Finding, ...]


class Prepared(NamedTuple):
    """Runs ready for a search."""

    search: Search
    rig: Rig  # with a starting value for all that it doesn't know
    held_out: list[DrivenRun]
    notes: tuple[Finding, ...]


def prepared(runs: Sequence[Run], held_out: Sequence[Run], rig: Rig, options: Options) -> Prepared:
    """Smooth runs and put a search over them together; UserError as `identify_driven`."""
    options.progress("smoothing the runs")
    rows, notes = driven_rows(runs)
    held, more = driven_rows(held_out)
    rows, held, zeros = without_jaw_zero(rows, held)
    notes += [*more, *(Finding("preparation", "note", "", "", zero) for zero in zeros)]
    rig = completed(rows, rig)
    fitted, mapper = driven_runs(rows), options.mapper
    without = options.without | frozenset(rig.effects) | GAUGES
    without |= frozenset() if any(run.load_measured for run in fitted) else LIKE_A_LOAD
    how = Search(
        fitted,
        known_of(rig, fitted),
        mapper,
        without,
        options.seed,
        options.progress,
        options.spent,
        Adapting(without, mapper, noise_of_strokes(fitted)),
        LEAST_SHARE,
        tied_share=LEAST_SHARE,  # a further parameter is to gain no less than a further entry
        geared=True,
        friction_decides=False,
        most_effects=MOST_EFFECTS,
        weigh=None,
    )
    return Prepared(how, rig, driven_runs(held) if held else [], tuple(notes))


def identify_driven(runs: Sequence[Run], held_out: Sequence[Run], rig: Rig, options: Options) -> DrivenIdentified:
    """Return what runs say of a rig; UserError where a run can't serve, or nothing bounds an unknown parameter."""
    how, rig, unused, notes = prepared(runs, held_out, rig, options)
    found, before, after = searched(how, parameters.vector(rig))
    unseen = left_unseen(found.best.fit, unused, how.mapper, how.seed, how.weigh) if unused else None
    runs_of_best = tuple(passed.run for passed in found.best.fit.passes.runs)
    nothing = Noise(np.zeros(3), np.zeros(3), np.zeros(3))  # of the filter's sensors: there is no filter
    whole = Identified(nothing, runs_of_best, tuple(unused), found, before, after, unseen)
    return DrivenIdentified(whole, rig, notes)


def fit_driven(runs: Sequence[Run], rig: Rig) -> tuple[Fit, int]:
    """Return the fit of the known parameters alone, and how many rows it used; UserError where a run can't serve."""
    how, rig, _, _ = prepared(runs, [], rig, Options())
    return fit_known(how, parameters.vector(rig)), sum(int(run.mask.sum()) for run in how.runs)


def known_of(rig: Rig, runs: Sequence[DrivenRun]) -> tuple[Free, ...]:
    """Return the rig's parameters that are fitted: those that it doesn't know exactly, and that a channel shows."""
    channel = runs[0].model.rows.torque_channel
    seen = max(float(np.sqrt(np.mean(run.rows.channels[channel] ** 2))) for run in runs)
    seen *= float(rig.plant().torque_constant_N_m_per_A) if channel == "current_A" else 1.0
    jaw_measured = all(run.jaw_measured for run in runs)
    every = known_parameters(rig, seen, jaw_measured=jaw_measured, torque_measured=True)
    # Without a wire, friction of the jaw is friction of the motor: what has no deviation is held.
    told = [free for free in every if known(rig, free.name).sd != 0.0]
    return tuple(free for free in told if channel == "current_A" or free.name != K_T)


def left_unseen(
    fitted: Fit, held_out: Sequence[DrivenRun], mapper: Mapper, seed: int, weigh: Weigh | None
) -> LackOfFit:
    """Return what a fit leaves in runs that it has never seen, beside noise as in those that it was fitted to."""
    theta, white = fitted.passes.theta, fitted.passes.runs[0].run.white
    runs = list(mapper(lambda run: run.adapted(theta, white), held_out))
    passes = pass_all(runs, theta, mapper)
    prior = Prior.by_fit(Posterior.of(fitted), fitted.free, theta)
    return omnibus_test(fitted._replace(passes=passes), mapper, seed, weigh, prior)
