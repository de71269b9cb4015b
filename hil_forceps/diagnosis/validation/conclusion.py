"""From runs of a drive whose law is known to the whole result, by the filter."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hil_forceps.control.trajectories import Trajectory
from hil_forceps.data.run import Run
from hil_forceps.diagnosis.experiment_design.next_experiment import propose
from hil_forceps.diagnosis.identification import Identified, identify
from hil_forceps.diagnosis.options import Options, split_runs
from hil_forceps.diagnosis.preparation.command import samples_in_a_row
from hil_forceps.diagnosis.preparation.even_rows import MAX_GAP_ROWS, MIN_ROWS, EvenRun, even_pieces
from hil_forceps.diagnosis.preparation.excerpts import excerpts
from hil_forceps.diagnosis.result import AuditFinding, Diagnosis, Gain, RunEvidence
from hil_forceps.diagnosis.validation.estimates import estimate_gains
from hil_forceps.diagnosis.validation.heldout import Played, evidence, gains
from hil_forceps.diagnosis.validation.rows import require_rows
from hil_forceps.diagnosis.validation.simulation import Measured, measured, play, unknown_load_rms
from hil_forceps.diagnosis.validation.strokes import Strokes, floors_with_strokes
from hil_forceps.diagnosis.validation.told import Beside, diagnosis_of
from hil_forceps.diagnosis.validation.verdict import Judgement, detectable, judge
from hil_forceps.model import parameters
from hil_forceps.rig import Rig

Vector = NDArray[np.float64]


def even_runs(runs: Sequence[Run], rig: Rig) -> list[EvenRun] | None:
    """Return runs as the filter takes them; None where it doesn't.

    It takes runs with a known law, its references and currents, and rows that are equally spaced.
    """
    needed = {"theta_m_ref_rad", "theta_m_rad", "current_A"}
    if rig.drive is None or not all(needed <= run.columns.keys() for run in runs):
        return None
    found: list[EvenRun] = []
    for run in runs:
        pieces = even_pieces(run, rig)
        if not pieces or any(samples_in_a_row(piece.run, rig) == 0 for piece in pieces):
            return None
        found += pieces
    return found


def conclude(
    runs: Sequence[EvenRun], rig: Rig, findings: Sequence[AuditFinding], options: Options
) -> tuple[Diagnosis, Rig, Trajectory | None]:
    """Return the diagnosis, the rig as extended by it, and the motion of the next experiment.

    `findings`: of the audit. UserError for a run of too few rows.
    """
    for even in runs:
        require_rows(even.name, int(np.count_nonzero(~even.lost)))
    cut = _cut_at_gaps(runs)
    runs, left_out = excerpts(runs)
    findings = (*findings, *cut, *left_out)
    wanted = set(options.hold_out)
    held = tuple(even.name for even in runs if even.of in wanted)
    fitted, held_out = split_runs(runs, (*held, *sorted(wanted - {even.of for even in runs})))
    found = identify(
        fitted,
        held_out,
        rig,
        mapper=options.mapper,
        without=options.without,
        seed=options.seed,
        progress=options.progress,
        spent=options.spent,
    )
    verdict = judge(found, rig)
    least = detectable(found.found.steps[0]) if found.found.steps else {}
    options.progress("simulating the runs with each model")
    diagnosis, extended = _told(fitted, held_out, rig, findings, found, verdict, options)
    if options.spent():
        return diagnosis, extended, None
    options.progress("choosing the next experiment")
    proposal = propose(found, rig, [even.run for even in fitted], least, options.mapper)
    return replace(diagnosis, next_experiment=proposal.result), extended, proposal.trajectory


def _cut_at_gaps(runs: Sequence[EvenRun]) -> list[AuditFinding]:
    pieces = Counter(even.of for even in runs if even.of)
    said = f" (cut at gaps of more than {MAX_GAP_ROWS} rows); pieces of fewer than {MIN_ROWS} rows are left out"
    return [AuditFinding("pieces", "note", name, "", f"{n} pieces are used{said}") for name, n in pieces.items()]


def _told(
    fitted: Sequence[EvenRun],
    held_out: Sequence[EvenRun],
    rig: Rig,
    findings: Sequence[AuditFinding],
    found: Identified,
    verdict: Judgement,
    options: Options,
) -> tuple[Diagnosis, Rig]:
    best, baseline = found.found.best.fit, found.found.baseline
    before, nominal = baseline.passes.theta, parameters.vector(rig)
    after = best.passes.theta if verdict.verdict == "effects" else before
    told = nominal if verdict.verdict == "consistent" else after
    named = [*rig.effects, *(effect.id for effect in verdict.effects)]
    extended = parameters.rig_with(rig, told, named)
    rigs = (parameters.rig_with(rig, before, list(rig.effects)), parameters.rig_with(rig, after, named))
    evidences: list[RunEvidence] = []
    gained: dict[str, Gain] = {}
    floors: dict[str, float] = {}
    repeated: tuple[Strokes, ...] = ()
    for raw, records, held in ((fitted, found.records, False), (held_out, found.held_out, True)):
        if not raw:
            continue
        runs = [measured(run, record) for run, record in zip(raw, records, strict=True)]
        played = _played(runs, rig, (nominal, before, after), options)
        noise = _floors(runs, rig, before, found, options)
        rows = [m.rows for m in runs]
        own, strokes = floors_with_strokes(rows, noise)
        repeated += strokes
        floors = floors or own
        estimated, estimate_gain = estimate_gains(rows, rigs, played[2].channels, own, options.seed)
        evidences += evidence(rows, held, *played, estimated)
        if held:
            gained = gains(rows, played[1], played[2], own, options.seed) | estimate_gain
    beside = Beside(evidences, gained, floors, repeated)
    diagnosis = diagnosis_of(found, verdict, beside, findings, verdict.shifts)
    options.to_draw(diagnosis)
    return diagnosis, extended


def _played(
    runs: Sequence[Measured], rig: Rig, thetas: tuple[Vector, Vector, Vector], options: Options
) -> tuple[Played, Played, Played]:
    nominal, before = (play(runs, rig, theta, options.mapper) for theta in thetas[:2])
    after = before if thetas[2] is thetas[1] else play(runs, rig, thetas[2], options.mapper)
    return nominal, before, after


def _floors(runs: Sequence[Measured], rig: Rig, theta: Vector, found: Identified, options: Options) -> dict[str, float]:
    """Return the rms of each channel's noise: its sensor's, and what the load cell's does to a simulation."""
    count = runs[0].record.series.count_rad
    own = {
        "theta_m_rad": count / np.sqrt(12.0),
        "current_A": float(found.noise.deviation[2]),
        "theta_j_rad": float(found.noise.deviation[0]),
    }
    by_load = unknown_load_rms(runs, rig, theta, found.noise, options.seed)
    present = [name for name in own if any(name in m.rows.channels for m in runs)]
    return {name: float(np.hypot(own[name], by_load.get(name, 0.0))) for name in present}
