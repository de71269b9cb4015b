"""The result of a diagnosis, put together from what a search found and what its models leave beside the runs."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from hil_forceps.diagnosis.identification import Identified
from hil_forceps.diagnosis.result import AuditFinding, Diagnosis, Gain, RunEvidence, Rung, Shift
from hil_forceps.diagnosis.validation.numbers import balances, trends
from hil_forceps.diagnosis.validation.strokes import Strokes, repetition
from hil_forceps.diagnosis.validation.verdict import Judgement, candidates, detectable


class Beside(NamedTuple):
    """What models are beside the runs."""

    runs: Sequence[RunEvidence]
    gain: Mapping[str, Gain]  # of the extension, in runs that were held out
    floors: dict[str, float]  # of each channel [rms]
    strokes: Sequence[Strokes]  # runs that repeat themselves


def diagnosis_of(
    found: Identified,
    verdict: Judgement,
    beside: Beside,
    findings: Sequence[AuditFinding],
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
        dict(beside.gain),
        tuple(run.name for run in found.held_out),
        (*findings, *map(repetition, beside.strokes)),
        detectable(found.found.steps[0]) if found.found.steps else {},
        None,
        verdict.varies_over,
        (*verdict.reasons, *reasons),
        candidates(found),
        balances(found.before, found.after),
        trends(tuple(beside.floors), found.before, found.after),
        beside.floors,
        tuple(beside.runs),
        ladder,
    )
