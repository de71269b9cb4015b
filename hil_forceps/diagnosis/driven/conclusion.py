"""From runs whose drive isn't known to the whole result."""

from collections.abc import Sequence

import numpy as np

from hil_forceps.data.run import Run
from hil_forceps.diagnosis.driven.gauge import with_scale
from hil_forceps.diagnosis.driven.identification import DrivenIdentified, identify_driven
from hil_forceps.diagnosis.driven.ladder import ladder
from hil_forceps.diagnosis.driven.passed import DrivenRun
from hil_forceps.diagnosis.driven.play import play
from hil_forceps.diagnosis.error_rates import UNEXPLAINED_SHARE_DRIVEN, UNSEEN_SHARE_DRIVEN
from hil_forceps.diagnosis.options import Options, split_runs
from hil_forceps.diagnosis.result import AuditFinding, Diagnosis, Gain, RunEvidence, Rung
from hil_forceps.diagnosis.validation.heldout import Played, evidence, gains
from hil_forceps.diagnosis.validation.strokes import Strokes, floors_with_strokes
from hil_forceps.diagnosis.validation.told import Beside, diagnosis_of
from hil_forceps.diagnosis.validation.verdict import Judgement, judge, parameter_shifts
from hil_forceps.model import parameters
from hil_forceps.rig import Rig


def conclude_driven(
    runs: Sequence[Run], rig: Rig, findings: Sequence[AuditFinding], options: Options
) -> tuple[Diagnosis, Rig]:
    """Return the diagnosis, and the rig as extended by it. `findings`: of the audit.

    Without the drive's law no motion can be foretold: there is no next experiment.
    """
    fitted, held_out = split_runs(runs, options.hold_out)
    identified = identify_driven(
        fitted,
        held_out,
        rig,
        mapper=options.mapper,
        without=options.without,
        seed=options.seed,
        progress=options.progress,
        spent=options.spent,
    )
    verdict = judge(identified.found, rig, (UNEXPLAINED_SHARE_DRIVEN, UNSEEN_SHARE_DRIVEN))
    options.progress("simulating the runs with each model")
    return _told(identified, rig, findings, verdict, options)


def _told(
    identified: DrivenIdentified, rig: Rig, findings: Sequence[AuditFinding], verdict: Judgement, options: Options
) -> tuple[Diagnosis, Rig]:
    found, mapper = identified.found, options.mapper
    best, baseline = found.found.best, found.found.baseline
    before, nominal = baseline.passes.theta, parameters.vector(identified.rig)
    after = best.fit.passes.theta if verdict.verdict == "effects" else before
    told = nominal if verdict.verdict == "consistent" else after
    named = [*rig.effects, *(effect.id for effect in verdict.effects)]
    extended = parameters.rig_with(identified.rig, told, named)
    evidences: list[RunEvidence] = []
    gained: dict[str, Gain] = {}
    floors: dict[str, float] = {}
    repeated: tuple[Strokes, ...] = ()
    for runs, held in ((found.records, False), (found.held_out, True)):
        if not runs:
            continue
        played = [play(runs, theta, mapper) for theta in (nominal, before, after)]
        rows = [run.rows for run in runs]
        own, strokes = floors_with_strokes(rows, _noise(runs, played[2]))
        repeated += strokes
        floors = floors or own
        evidences += evidence(rows, held, played[0], played[1], played[2], [{} for _ in rows])
        if held:
            gained = gains(rows, played[1], played[2], own, options.seed)
    rungs: tuple[Rung, ...] = ()
    if not options.spent():
        options.progress("refitting the steps of the ladder")
        values = {effect.id: effect.parameters for effect in verdict.effects}
        rungs = ladder(best, found.records, found.held_out or found.records, values, floors, mapper)
    # What the extended rig holds, then, where nothing is named.
    shifts = parameter_shifts(baseline, rig) if verdict.verdict == "unnamed" else verdict.shifts
    shifts, scale = with_scale(shifts, identified.rig)
    beside = Beside(evidences, gained, floors, repeated)
    told_of = (*findings, *identified.notes)
    diagnosis = diagnosis_of(found, verdict, beside, told_of, shifts, scale, rungs)
    options.to_draw(diagnosis)
    return diagnosis, extended


def _noise(runs: Sequence[DrivenRun], played: Played) -> dict[str, float]:
    """Return the rms of each channel's noise: its sensor's behind the low pass, no more than a model leaves."""
    found: dict[str, float] = {}
    for name in dict.fromkeys(name for run in runs for name in run.rows.channels):
        there = [(run, shown) for run, shown in zip(runs, played.channels, strict=True) if name in shown]
        sensor = float(np.sqrt(np.mean([run.model.rows.noise[name] ** 2 for run, _ in there])))
        left = [np.mean((run.rows.channels[name] - shown[name])[run.mask] ** 2) for run, shown in there]
        found[name] = min(sensor, float(np.sqrt(np.mean(left))))
    return found
