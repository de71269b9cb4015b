"""From runs of a drive whose law is known to the whole result, by the filter."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hil_forceps.audit.finding import Finding
from hil_forceps.control.trajectories import Trajectory
from hil_forceps.data.even_rows import MAX_GAP_ROWS, MIN_ROWS, EvenRun, even_pieces
from hil_forceps.data.run import Run
from hil_forceps.diagnosis.experiment_design.next_experiment import propose
from hil_forceps.diagnosis.identification import identify
from hil_forceps.diagnosis.identified import Identified
from hil_forceps.diagnosis.options import Options, split_runs
from hil_forceps.diagnosis.preparation.command import samples_in_a_row
from hil_forceps.diagnosis.preparation.excerpts import excerpts
from hil_forceps.diagnosis.preparation.records import Record
from hil_forceps.diagnosis.result import Diagnosis
from hil_forceps.diagnosis.validation.rows import require_rows
from hil_forceps.diagnosis.validation.simulation import Measured, measured, play, unknown_load_rms
from hil_forceps.diagnosis.validation.told import Models, Shown, beside, diagnosis_of, models_of
from hil_forceps.diagnosis.validation.verdict import judge
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
    runs: Sequence[EvenRun], rig: Rig, findings: Sequence[Finding], options: Options
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
    found = identify(fitted, held_out, rig, options)
    verdict = judge(found, rig)
    models = models_of(found, verdict, rig)
    options.progress("simulating the runs with each model")
    rigs = (parameters.rig_with(rig, models.before, rig.effects), parameters.rig_with(rig, models.after, models.named))
    shown = _shown(fitted, found.records, rig, models, found, options)
    unseen = _shown(held_out, found.held_out, rig, models, found, options) if held_out else None
    diagnosis = diagnosis_of(found, verdict, beside(shown, unseen, options.seed, rigs), findings, verdict.shifts)
    options.to_draw(diagnosis)
    if options.spent():
        return diagnosis, models.extended, None
    options.progress("choosing the next experiment")
    made = [even.run for even in fitted]
    proposal = propose(found, rig, made, diagnosis.minimum_detectable, options.mapper)
    return replace(diagnosis, next_experiment=proposal.result), models.extended, proposal.trajectory


def _cut_at_gaps(runs: Sequence[EvenRun]) -> list[Finding]:
    pieces = Counter(even.of for even in runs if even.of)
    said = f" (cut at gaps of more than {MAX_GAP_ROWS} rows); pieces of fewer than {MIN_ROWS} rows are left out"
    return [Finding("pieces", "note", name, "", f"{n} pieces are used{said}") for name, n in pieces.items()]


def _shown(
    runs: Sequence[EvenRun], records: Sequence[Record], rig: Rig, models: Models, found: Identified, options: Options
) -> Shown:
    """Return the models beside runs."""
    made = [measured(run, record) for run, record in zip(runs, records, strict=True)]
    nominal, before = (play(made, rig, theta, options.mapper) for theta in (models.nominal, models.before))
    after = before if models.after is models.before else play(made, rig, models.after, options.mapper)
    noise = _floors(made, rig, models.before, found, options)
    return Shown([m.rows for m in made], (nominal, before, after), noise)


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
