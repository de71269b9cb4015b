"""The result of a diagnosis, put together from what a search found and what its models leave beside the runs."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.audit.finding import Finding
from hil_forceps.diagnosis.identified import Identified
from hil_forceps.diagnosis.result import Diagnosis, Gain, RunEvidence, Rung, Shift
from hil_forceps.diagnosis.validation.estimates import estimate_gains
from hil_forceps.diagnosis.validation.heldout import Played, evidence, gains
from hil_forceps.diagnosis.validation.numbers import balances, detectable, trends
from hil_forceps.diagnosis.validation.rows import Rows
from hil_forceps.diagnosis.validation.strokes import Strokes, floors_with_strokes, repetition
from hil_forceps.diagnosis.validation.verdict import Judgement, candidates
from hil_forceps.model import parameters
from hil_forceps.rig import Rig

Vector = NDArray[np.float64]


class Models(NamedTuple):
    """The models that runs are held against, by their parameters, and the rig as extended by a diagnosis."""

    nominal: Vector  # the rig as given
    before: Vector  # with its parameters refitted
    after: Vector  # and with the effects named
    named: tuple[str, ...]  # the rig's effects and those that were named
    extended: Rig


class Shown(NamedTuple):
    """Models beside a set of runs."""

    rows: Sequence[Rows]
    played: tuple[Played, Played, Played]  # by the models of `Models`
    noise: Mapping[str, float]  # of each channel [rms]


class Beside(NamedTuple):
    """What models are beside the runs."""

    runs: Sequence[RunEvidence]
    gain: Mapping[str, Gain]  # of the extension, in runs that were held out
    floors: dict[str, float]  # of each channel [rms]
    strokes: Sequence[Strokes]  # runs that repeat themselves


def models_of(found: Identified, verdict: Judgement, rig: Rig) -> Models:
    """Return the models that the runs are held against."""
    nominal, before = parameters.vector(rig), found.found.baseline.passes.theta
    after = found.found.best.fit.passes.theta if verdict.verdict == "effects" else before
    named = (*rig.effects, *(effect.id for effect in verdict.effects))
    told = nominal if verdict.verdict == "consistent" else after
    return Models(nominal, before, after, named, parameters.rig_with(rig, told, named))


def beside(fitted: Shown, held_out: Shown | None, seed: int, rigs: tuple[Rig, Rig] | None) -> Beside:
    """Return what models are beside the runs that were fitted, and beside those held out.

    `rigs`: before and after, with which estimators run; None: without estimates.
    """
    runs: list[RunEvidence] = []
    gain: dict[str, Gain] = {}
    floors: dict[str, float] = {}
    strokes: tuple[Strokes, ...] = ()
    for shown, held in ((fitted, False), (held_out, True)):
        if shown is None:
            continue
        rows, (nominal, before, after) = shown.rows, shown.played
        own, repeated = floors_with_strokes(rows, shown.noise)
        strokes += repeated
        floors = floors or own
        estimated: list[dict[str, Vector]] = [{} for _ in rows]
        estimate_gain: dict[str, Gain] = {}
        if rigs is not None:
            estimated, estimate_gain = estimate_gains(rows, rigs, after.channels, own, seed)
        runs += evidence(rows, held, nominal, before, after, estimated)
        if held:
            gain = gains(rows, before, after, own, seed) | estimate_gain
    return Beside(runs, gain, floors, strokes)


def diagnosis_of(
    found: Identified,
    verdict: Judgement,
    shown: Beside,
    findings: Sequence[Finding],
    shifts: Mapping[str, Shift],
    reasons: Sequence[str] = (),
    ladder: tuple[Rung, ...] = (),
) -> Diagnosis:
    """Return the result but for the next experiment; `reasons`: beside those of the verdict."""
    return Diagnosis(
        verdict.verdict,
        verdict.sentence,
        verdict.effects,
        verdict.sets,
        dict(shifts),
        dict(shown.gain),
        tuple(run.name for run in found.held_out),
        (*findings, *map(repetition, shown.strokes)),
        detectable(found.found.steps[0]) if found.found.steps else {},
        None,
        verdict.varies_over,
        (*verdict.reasons, *reasons),
        candidates(found),
        balances(found.before, found.after),
        trends(tuple(shown.floors), found.before, found.after),
        shown.floors,
        tuple(shown.runs),
        ladder,
    )
