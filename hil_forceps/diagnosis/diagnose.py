"""From runs and a rig to a diagnosis: audit, baseline, noise, choice, what is left, gain on runs never used."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.anew import courses_of, refresher
from hil_forceps.diagnosis.assemble import Setting, assemble, aware_of_load, responses_of
from hil_forceps.diagnosis.audit import Finding, audit
from hil_forceps.diagnosis.choice import Choice, Chooser
from hil_forceps.diagnosis.experiment import Record, mode_of, prepare, with_load_course, with_raw_load
from hil_forceps.diagnosis.experiment_driven import prepare_driven, row_noise
from hil_forceps.diagnosis.extension import Model
from hil_forceps.diagnosis.fit import fit, fit_again, hold_nuisances
from hil_forceps.diagnosis.jaw_zero import without_jaw_zero
from hil_forceps.diagnosis.leftover import OVER_CHANCE, Leftover, curves_along, leftover, whitened
from hil_forceps.diagnosis.linear import Response
from hil_forceps.diagnosis.load_noise import beside_straight, load_noise, load_noise_driven, louder
from hil_forceps.diagnosis.look import Looker, no_columns, noise_of
from hil_forceps.diagnosis.mapper import Mapper
from hil_forceps.diagnosis.predict import ClosedLoop
from hil_forceps.diagnosis.predict_driven import Driven
from hil_forceps.diagnosis.problem import Problem
from hil_forceps.diagnosis.result import Diagnosis
from hil_forceps.diagnosis.ringing import in_deepest_valley
from hil_forceps.diagnosis.scene import HARMONICS, fine_harmonics, scene_of
from hil_forceps.diagnosis.smoothing import LoadNoise
from hil_forceps.diagnosis.spectrum import Flat, Layout, Noise, Whitener, white_noise
from hil_forceps.diagnosis.starting import completed, unknown_names
from hil_forceps.diagnosis.trust import CONTRADICTED, DOUBTED, at_their_word, trusted, trusting
from hil_forceps.diagnosis.unknowns import Unknowns
from hil_forceps.diagnosis.unseen import left_unseen
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError
from hil_forceps.runs.table import Run

Vector = NDArray[np.float64]
Progress = Callable[[str], None]

HELD_OUT_SHARE = 3  # one run in three is held out
BASELINE_STEPS = 10
COURSES = 3  # of the load after the first, at most, each with the noise that the one before leaves
ANOTHER_NOISE = 0.25  # of the logarithm of its power
REFRESHES = 3  # of the encoder's rounding, which hangs on the fit that it changes


def no_progress(_: str) -> None:
    """Say nothing."""


def never() -> bool:
    """Say no."""
    return False


def not_drawn(_: Diagnosis) -> None:
    """Draw nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class Options:
    """How to diagnose; the defaults are what the published figures were made with."""

    without: frozenset[str] = frozenset()  # entries of the catalogue that are left out
    hold_out: tuple[str, ...] = ()  # names of runs to hold out; none: chosen here
    seed: int = 0
    mapper: Mapper = map
    progress: Progress = no_progress
    # Told all that figures show, while the next experiment is still looked for; may come from a thread of its own.
    to_draw: Callable[[Diagnosis], None] = not_drawn
    spent: Callable[[], bool] = never  # whether the time that was allowed is spent


class Findings(NamedTuple):
    """Everything that the steps found, before it is put into words and numbers for the user."""

    rig: Rig
    findings: tuple[Finding, ...]
    notes: tuple[str, ...]
    records: tuple[Record, ...]
    held_out: tuple[Record, ...]
    setting: Setting
    nominal: Model
    baseline: Model
    choice: Choice
    before: Leftover  # beside the baseline
    after: Leftover  # beside the chosen model
    unseen: Leftover | None  # beside it in the runs held out; None: nothing named, or none held out
    unseen_of_rivals: Mapping[tuple[str, ...], Leftover]  # beside those tied with it; told where something is left
    first_whitener: Whitener


class Named(Protocol):
    """What has a name."""

    @property
    def name(self) -> str:
        """The name."""


AnyRun = TypeVar("AnyRun", bound=Named)  # as measured, or on equally spaced rows


def split_runs(runs: Sequence[AnyRun], wanted: Sequence[str]) -> tuple[list[AnyRun], list[AnyRun]]:
    """Return the runs to fit and those to hold out: those wanted, else the last third, but none of a single run."""
    names = [run.name for run in runs]
    if unknown := [name for name in wanted if name not in names]:
        raise UserError(f"--hold-out {unknown[0]}: no such run; the runs are {', '.join(names)}")
    if wanted:
        held = [run for run in runs if run.name in wanted]
        fitted = [run for run in runs if run.name not in wanted]
        if not fitted:
            raise UserError("--hold-out: every run is held out; leave one at least to fit")
        return fitted, held
    count = len(runs) // HELD_OUT_SHARE if len(runs) > 2 else len(runs) - 1
    split = len(runs) - max(count, 0)
    return list(runs[:split]), list(runs[split:])


def investigate(runs: Sequence[Run], rig: Rig, options: Options) -> Findings:
    """Run all steps."""
    options.progress("auditing the data")
    findings = tuple(audit(runs, rig))
    fitted, held = split_runs(runs, options.hold_out)
    if mode_of(runs, rig) == "driven":
        records, notes = prepare_driven(fitted)
        unknown = unknown_names(rig)
        noise = driven_load_noise(fitted, records, rig, options)
        records, notes = prepare_driven(fitted, noise)
        held_records, held_notes = prepare_driven(held, noise)
        records, held_records, zeros = without_jaw_zero(records, held_records)
        notes = [*notes, *zeros]
        rig = completed(records, rig)
    else:
        unknown = ()
        records, notes = prepare(fitted, rig)
        held_records, held_notes = prepare(held, rig)
        records, held_records = without_load_noise(records, held_records, rig, options)
        notes = [*notes, *_bent_too_often(records)]
    told = _Told(rig, findings, (*notes, *held_notes), tuple(records), tuple(held_records))
    options.progress("fitting the known parameters")
    first = fit_baseline(records, rig, options, unknown)
    found = _chosen(told, first, options)
    doubtful = not found.choice.model.effects and found.after.stands_out
    if doubtful and records[0].mode == "closed_loop":
        options.progress("doubting the rig's word for friction")
        other = fit_baseline(records, rig, options, unknown, contradicted=DOUBTED)
        if trusted(other.baseline.problem.shared) != trusted(first.baseline.problem.shared):
            again = _chosen(told, other, options)
            if not again.choice.model.effects and again.after.gain <= again.after.threshold:
                return again
    return found


class Baseline(NamedTuple):
    """The known parameters as assumed and as fitted, no effect beside them, and what they were fitted with."""

    setting: Setting
    nominal: Model
    baseline: Model
    whitener: Whitener


class _Told(NamedTuple):
    """What is known before anything is fitted: the first of `Findings`."""

    rig: Rig
    findings: tuple[Finding, ...]
    notes: tuple[str, ...]
    records: tuple[Record, ...]
    held_out: tuple[Record, ...]


def _chosen(told: _Told, start: Baseline, options: Options) -> Findings:
    """Return all findings from a baseline on."""
    rig, records = told.rig, told.records
    setting, nominal, baseline, whitener = start
    responses = responses_of(setting.simulator, baseline.problem.theta(baseline.fit.u), rig)
    courses = courses_of(setting, baseline)
    harmonics = fine_harmonics(courses) if records[0].mode == "driven" else HARMONICS
    scene = scene_of(courses, baseline, whitener, responses, harmonics)
    refresh = refresher(rig)
    looker = Looker(scene, options.without, setting.floor, options.seed)
    chooser = Chooser(looker, options.progress, refresh, driven=records[0].mode == "driven")
    choice = chooser.choose(baseline, whitener)
    options.progress("looking at what is left")

    def unseen_beside(model: Model) -> Leftover | None:
        if not model.effects or not told.held_out:
            return None
        return left_unseen(model, told.held_out, rig, refresh, options.seed)

    baseline, before, after, unseen = _left(setting, baseline, choice, responses, options, unseen_beside)
    for times, again in ((1.0, chooser.further), (OVER_CHANCE, chooser.instead)):
        if after.gain <= times * after.threshold or records[0].mode == "driven":
            break
        found = again(choice)
        if found is not choice:
            choice = found
            baseline, before, after, unseen = _left(setting, baseline, choice, responses, options, unseen_beside)
    tied: dict[tuple[str, ...], Leftover] = {}
    if unseen is not None and unseen.stands_out and records[0].mode == "closed_loop":
        for rival in choice.rivals:
            if set(rival.model.effects) != set(choice.model.effects) and (left := unseen_beside(rival.model)):
                tied[rival.model.effects] = left
    nominal = replace(nominal, fit=fit_again(nominal.problem, nominal.fit, choice.whitener))
    return Findings(*told, setting, nominal, baseline, choice, before, after, unseen, tied, whitener)


def _left(
    setting: Setting,
    baseline: Model,
    choice: Choice,
    responses: Sequence[Response] | None,
    options: Options,
    unseen_beside: Callable[[Model], Leftover | None],
) -> tuple[Model, Leftover, Leftover, Leftover | None]:
    """Return the baseline with the noise as known in the end, and what is left beside it, the choice, and unseen."""
    curves = whitened(
        curves_along(courses_of(setting, choice.model), choice.model.problem.layout, responses, options.mapper),
        choice.whitener,
    )
    baseline = replace(baseline, fit=fit_again(baseline.problem, baseline.fit, choice.whitener))

    def beside(model: Model) -> Leftover:
        return leftover(model, choice.whitener, curves, options.seed)

    looks: list[Callable[[], Leftover | None]] = [lambda: unseen_beside(choice.model), lambda: beside(choice.model)]
    if choice.model.effects:  # without any both are one
        looks.append(lambda: beside(baseline))
    unseen, after, *before = options.mapper(lambda look: look(), looks)
    assert after is not None
    return baseline, (before or [after])[0], after, unseen


def without_load_noise(
    records: list[Record], held_out: list[Record], rig: Rig, options: Options
) -> tuple[list[Record], list[Record]]:
    """Return records whose load is smoothed by its noise, with the colour that the rig as assumed shows it to have."""
    if any(record.raw_load_N_m is None for record in (*records, *held_out)):
        return records, held_out
    options.progress("looking at the load cell's noise")
    raw = with_raw_load(records)
    noise = load_noise(*_left_by_assumed(raw, rig, options), raw)

    def with_courses(noise: LoadNoise) -> list[Record]:
        return list(options.mapper(lambda record: with_load_course(record, noise), (*records, *held_out)))

    loud = louder(noise)
    found = with_courses(loud)
    if any(record.straight for record in found):
        noise = loud
    else:
        found = with_courses(noise)
    for _ in range(COURSES):
        better = beside_straight(found, noise)
        if better is noise or np.all(np.abs(np.log(better.power / noise.power)) < ANOTHER_NOISE):
            break
        found, noise = with_courses(better), better
    return found[: len(records)], found[len(records) :]


def _bent_too_often(records: Sequence[Record]) -> list[str]:
    said = "its load bends too often for its noise to be told instant by instant; weak causes show in shorter runs"
    return [f"{r.name}: {said}" for r in records if r.load_noise is not None and r.load_error is None]


def driven_load_noise(runs: Sequence[Run], records: list[Record], rig: Rig, options: Options) -> LoadNoise | None:
    """Return the noise of the load cell of runs that are driven by their motion; None where no load was measured."""
    if any("tau_w_N_m" not in run.columns for run in runs):
        return None
    records, _, _ = without_jaw_zero(records, ())
    rig = completed(records, rig)
    period_s = float(np.median(np.concatenate([np.diff(run.columns["time_s"]) for run in runs])))
    high = row_noise([run.columns["tau_w_N_m"] for run in runs], period_s)
    return load_noise_driven(*_left_by_assumed(records, rig, options), records, high, period_s)


def _left_by_assumed(records: Sequence[Record], rig: Rig, options: Options) -> tuple[Layout, Flat, list[Response]]:
    """Return what no parameter near the rig as assumed explains of the runs, and what a load does to them."""
    setting = assemble(records, rig, options.mapper)
    problem = setting.problem
    whitener = problem.whitener(white_noise(problem.layout, setting.first_power))
    assumed, _, left = assumed_noise(problem, whitener, setting.floor)
    return problem.layout, left, responses_of(setting.simulator, problem.theta(assumed.fit.u), rig)


def assumed_noise(problem: Problem, whitener: Whitener, floor: Vector) -> tuple[Model, Noise, Flat]:
    """Return the rig as assumed beside the data, and the noise that no parameter near it explains, with its course."""
    assumed = Model((), problem, fit(problem, np.zeros(problem.size), whitener, steps=0))
    noise, course = noise_of(assumed, no_columns(problem), whitener, floor)
    return assumed, noise, course


def fit_baseline(
    records: Sequence[Record],
    rig: Rig,
    options: Options,
    unknown: Sequence[str] = (),
    *,
    contradicted: float = CONTRADICTED,
) -> Baseline:
    """Fit the known parameters, first with guessed noise, then with what that leaves; also the rig as it is given.

    `unknown`: parameters of which the rig says no value; nothing was assumed of them. `contradicted`: at what cost of
    χ² the rig isn't taken at its word for friction.
    """
    setting = assemble(records, rig, options.mapper)
    setting = aware_of_load(setting, setting.problem.base, rig)
    items = setting.problem.shared.items
    shared = Unknowns(tuple(item._replace(assumed=None) if item.name in unknown else item for item in items))
    problem = setting.problem.with_shared(shared)
    whitener = problem.whitener(white_noise(problem.layout, setting.first_power))
    # The rounding makes the wire ring, which is no misfit of the parameters.
    refresh = refresher(rig)
    problem = refresh(problem, np.zeros(problem.size))
    # What the load cell's noise does is many times the encoder's: taken for signal, it would bend every parameter.
    _, noise, _ = assumed_noise(problem, whitener, setting.floor)
    whitener = problem.whitener(noise)
    rough = fit(problem, np.zeros(problem.size), whitener, steps=BASELINE_STEPS)
    found, u = in_deepest_valley(problem, rough.u, whitener)
    if found is not problem:
        problem, rough = found, fit(found, u, whitener, steps=BASELINE_STEPS)
    # Near the true plant now: what errors of the load do is known better, too.
    setting = aware_of_load(setting._replace(problem=problem), problem.theta(rough.u), rig)
    problem = setting.problem
    whitener = problem.whitener(noise)
    noise, _ = noise_of(Model((), problem, rough), no_columns(problem), whitener, setting.floor)
    whitener = problem.whitener(noise)
    best, u = rough, rough.u
    for number in range(REFRESHES):
        problem = refresh(problem, u)
        best = fit(problem, u, whitener, held=hold_nuisances(best, problem, whitener), steps=4)
        u = best.u
        if number == 0:
            problem = problem.with_shared(trusting(problem.shared, best, contradicted))
            u = at_their_word(problem, u, whitener)
    assert isinstance(problem.simulate_runs, ClosedLoop | Driven)
    setting = setting._replace(problem=problem, simulator=problem.simulate_runs)
    baseline = Model((), problem, best)
    bare = problem.with_shared(Unknowns(()))
    count = len(problem.shared.items)
    nominal = Model((), bare, fit(bare, baseline.fit.u[count:], whitener, steps=4))
    return Baseline(setting, nominal, baseline, whitener)


__all__ = ["Findings", "Options", "fit_baseline", "investigate", "split_runs"]
