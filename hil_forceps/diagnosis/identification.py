"""Identify a forceps from runs in closed loop: known parameters, effects of the catalogue, and what neither explains.

noise    = of the sensors: from differences, then by likelihood where these don't tell   preparation/, inference/
start    = parameters that the first fit begins with                            starting_parameters
records  = commands, load's prior, contact, regimes of friction              preparation/
baseline = known parameters by prediction errors of an extended Kalman filter   state_space/, inference/
found    = entries of the catalogue that join by score test and refit           hypotheses/
left     = curves without physics in them, through the same filter              lack_of_fit/
unseen   = the same beside the found model in runs that it has never seen
again    = fit and tests of runs simulated with the found model                 bootstrap
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.data.even_rows import EvenRun
from hil_forceps.diagnosis.bootstrap import Bootstrap, bias_corrected, corrected_replicates
from hil_forceps.diagnosis.error_rates import STEP_ERROR_SHARE
from hil_forceps.diagnosis.evidence import Mapper, pass_all
from hil_forceps.diagnosis.hypotheses.candidate import Adapt, Search
from hil_forceps.diagnosis.hypotheses.score_test import Prior
from hil_forceps.diagnosis.identified import GAUGED, GAUGES, LIKE_A_LOAD, Identified, searched
from hil_forceps.diagnosis.inference.dispersion import Weigh, by_student_t, over_dispersion
from hil_forceps.diagnosis.inference.fit import Fit, Posterior, fit, fit_from, is_stationary
from hil_forceps.diagnosis.inference.likeliest_noise import likeliest_noise
from hil_forceps.diagnosis.inference.load_noise import with_likeliest_load_noises
from hil_forceps.diagnosis.inference.parameters import Free, known_parameters
from hil_forceps.diagnosis.lack_of_fit.omnibus_test import LackOfFit, omnibus_test
from hil_forceps.diagnosis.options import Options
from hil_forceps.diagnosis.preparation.records import Record, record_of
from hil_forceps.diagnosis.preparation.reference_timing import reference_timing
from hil_forceps.diagnosis.preparation.sensor_noise import least_deviations, sensor_noise
from hil_forceps.diagnosis.starting_parameters import starting_parameters
from hil_forceps.diagnosis.state_space.advance import physics_of
from hil_forceps.diagnosis.state_space.filter_pass import empty_filtered, filter_run
from hil_forceps.diagnosis.state_space.forcing_pass import forced
from hil_forceps.diagnosis.state_space.layout import CHANNELS, Noise, Series
from hil_forceps.diagnosis.state_space.response_pass import response_run
from hil_forceps.diagnosis.validation.estimates import ready_estimator
from hil_forceps.model.composition import Physics
from hil_forceps.rig import Rig

Vector = NDArray[np.float64]


MOST_EFFECTS = 6
TIMING_ROUNDS = 3  # the first tells hosts that are always alike, two more those that aren't: shares then move by < 1 %


def identify(runs: Sequence[EvenRun], held_out: Sequence[EvenRun], rig: Rig, options: Options) -> Identified:
    """Return what equally spaced runs of a drive whose law is known say of a rig.

    Effects that the rig holds are taken as they stand: they are neither fitted nor named.
    """
    how, noise, unseen_records, theta = prepared(runs, held_out, rig, options)
    found, before, after = searched(how, theta)
    best, mapper = found.best.fit, how.mapper

    def records_again(again: Sequence[EvenRun]) -> Sequence[Record]:
        return records_of(again, (), rig, noise, mapper, best.passes.theta)[0]

    bootstrap = Bootstrap(rig, noise, records_again, how)
    shifts: list[Vector] = []
    left: list[LackOfFit] = []
    corrects = is_approximate(noise, how.runs) and is_stationary(best, mapper)
    if (corrects or after.significant) and not options.spent():
        options.progress("fitting and testing runs simulated with the model")
        for again in bootstrap.replicates(best, runs, how.runs):
            beside = bootstrap.beside(best, again)
            if corrects:
                shifts.append(bootstrap.shift(beside))
            if after.significant:
                left.append(omnibus_test(beside, mapper, how.seed, how.weigh))
    after = after.calibrated(left) if left else after
    corrected = bias_corrected(best, shifts) if shifts else best
    unseen = left_unseen(corrected, unseen_records, mapper, how.seed, how.weigh) if held_out else None
    if unseen is not None and unseen.significant and not after.significant and not options.spent():
        options.progress("testing held-out runs simulated with the model")
        replicates = bootstrap.replicates(best, held_out, unseen_records)
        pairs = zip(corrected_replicates(best, shifts), replicates, strict=True)
        unseen = unseen.calibrated([left_unseen(one, again, mapper, how.seed, how.weigh) for one, again in pairs])
    found = found._replace(best=found.best._replace(fit=corrected))
    found = found if found.best.effects else found._replace(baseline=corrected)
    return Identified(noise, tuple(how.runs), unseen_records, found, before, after, unseen)


class Prepared(NamedTuple):
    """Runs ready for a search."""

    how: Search
    noise: Noise
    held_out: tuple[Record, ...]
    theta: Vector  # parameters of a first fit


def prepared(runs: Sequence[EvenRun], held_out: Sequence[EvenRun], rig: Rig, options: Options) -> Prepared:
    """Return runs as records, with the noise that is likeliest beside a first fit of the known parameters."""
    mapper = options.mapper
    options.progress("estimating noise, commands and loads")
    recorded = [even.run for even in runs]
    noise = sensor_noise(recorded, rig)
    start = starting_parameters(runs, rig)
    records, unseen_records = records_of(runs, held_out, rig, noise, mapper, start)
    compile_side_by_side(records[0].series, physics_of(start), rig, mapper)
    known = known_of(rig, records)
    options.progress("fitting the known parameters a first time")
    first = fit(records, start, known, mapper)
    likeliest = likeliest_noise(noise, least_deviations(recorded), records, first, mapper)
    if likeliest is not noise:
        noise = likeliest
        options.progress("preparing the runs with the noise that is likeliest beside the parameters")
        records, unseen_records = records_of(runs, held_out, rig, noise, mapper, first.passes.theta)
    without = options.without | frozenset(rig.effects) | (frozenset() if load_measured(records) else LIKE_A_LOAD)
    without |= GAUGES if {free.name for free in known} >= GAUGED else frozenset()
    how = Search(
        records,
        known,
        mapper,
        without,
        options.seed,
        options.progress,
        options.spent,
        adapting(mapper),
        STEP_ERROR_SHARE,
        tied_share=0.0,
        geared=False,
        friction_decides=True,
        most_effects=MOST_EFFECTS,
        weigh=by_student_t if is_approximate(noise, records) else over_dispersion,
    )
    return Prepared(how, noise, unseen_records, first.passes.theta)


def compile_side_by_side(d: Series, plant: Physics, rig: Rig, mapper: Mapper) -> None:
    """Call all kernels once: what the first diagnosis on a machine has to compile is compiled side by side.

    What the calls return is of no interest.
    """
    torques, errors = np.zeros((d.encoder_rad.size, 1)), np.zeros((d.encoder_rad.size, CHANNELS, 1))
    calls = (
        partial(filter_run, plant, d),
        partial(ready_estimator, rig, d.period_s),
        partial(response_run, plant, plant, d, empty_filtered(d), 1.0),
        partial(forced, plant, d, empty_filtered(d), torques, torques, errors),
    )
    list(mapper(lambda call: call(), calls))


def is_approximate(noise: Noise, records: Sequence[Record]) -> bool:
    """Tell whether the filter takes these runs for something that they are not quite.

    Coloured noise, commands decoded between rows, and a load or a jaw's angle that no sensor tells.
    """
    coloured = bool(np.any(noise.correlation != 0.0))
    between = any(record.series.samples > 1 for record in records)
    return coloured or between or not all(record.load_measured and record.jaw_measured for record in records)


def records_of(
    runs: Sequence[EvenRun], held_out: Sequence[EvenRun], rig: Rig, noise: Noise, mapper: Mapper, theta: Vector
) -> tuple[tuple[Record, ...], tuple[Record, ...]]:
    """Return runs as records, and those held out.

    Which references a drive follows between rows is told by the currents, with the parameters `theta`.
    """
    plant = physics_of(theta)

    def prepared(run: EvenRun) -> Record:
        record = record_of(run, rig, noise).with_friction_of(plant)
        for turn in range(TIMING_ROUNDS if record.series.samples > 1 else 0):
            record = record.with_timing(reference_timing(record.passed(theta, plant), first=turn == 0))
        return record

    records = tuple(mapper(prepared, (*runs, *held_out)))
    return records[: len(runs)], records[len(runs) :]


def adapting(mapper: Mapper) -> Adapt:
    """Return what gives records friction and switching of a model."""

    def adapt(runs: Sequence[Record], model: Fit, *, first: bool) -> list[Record]:
        theta, plant = model.passes.theta, model.passes.plant
        runs = [run.with_friction_of(plant) for run in runs]
        passes = pass_all(runs, theta, mapper)
        if first:
            runs = with_likeliest_load_noises(runs, passes, mapper)
            passes = pass_all(runs, theta, mapper)
        return [run.decided_by(passed.filtered) for run, passed in zip(runs, passes.runs, strict=True)]

    return adapt


def load_measured(records: Sequence[Record]) -> bool:
    """Tell whether any run has a load cell."""
    return any(record.load_measured for record in records)


def known_of(rig: Rig, records: Sequence[Record]) -> tuple[Free, ...]:
    """Return the rig's parameters that are fitted to records."""
    torque_N_m = rig.plant().torque_constant_N_m_per_A * max(record.command_span_A for record in records)
    jaw_measured = any(record.jaw_measured for record in records)
    return known_parameters(rig, torque_N_m, jaw_measured=jaw_measured, torque_measured=load_measured(records))


def left_unseen(fitted: Fit, held_out: Sequence[Record], mapper: Mapper, seed: int, weigh: Weigh | None) -> LackOfFit:
    """Return what a fit leaves in runs that it has never seen; its parameters are known as the fitted runs tell."""
    plant = fitted.passes.plant
    runs = [run.with_friction_of(plant) for run in held_out]
    passes = pass_all(runs, fitted.passes.theta, mapper)
    runs = with_likeliest_load_noises(runs, passes, mapper)
    # The parameters are known to their deviations only, over which the answer of these runs need not be linear.
    known = Posterior.of(fitted)
    updated = fit_from(runs, pass_all(runs, fitted.passes.theta, mapper), fitted.free, mapper, known)
    prior = Prior.by_fit(known, fitted.free, updated.passes.theta)
    return omnibus_test(updated, mapper, seed, weigh, prior)
