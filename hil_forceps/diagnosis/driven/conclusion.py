"""From runs whose drive isn't known to the whole result."""

from collections.abc import Sequence

import numpy as np

from hil_forceps.audit.finding import Finding
from hil_forceps.data.run import Run
from hil_forceps.diagnosis.driven.gauge import with_scale
from hil_forceps.diagnosis.driven.identification import identify_driven
from hil_forceps.diagnosis.driven.ladder import ladder
from hil_forceps.diagnosis.driven.passed import DrivenRun, play
from hil_forceps.diagnosis.error_rates import UNEXPLAINED_SHARE_DRIVEN, UNSEEN_SHARE_DRIVEN
from hil_forceps.diagnosis.options import Options, split_runs
from hil_forceps.diagnosis.result import Diagnosis, Rung
from hil_forceps.diagnosis.validation.heldout import Played
from hil_forceps.diagnosis.validation.told import Models, Shown, beside, diagnosis_of, models_of
from hil_forceps.diagnosis.validation.verdict import judge, parameter_shifts
from hil_forceps.rig import Rig


def conclude_driven(
    runs: Sequence[Run], rig: Rig, findings: Sequence[Finding], options: Options
) -> tuple[Diagnosis, Rig]:
    """Return the diagnosis, and the rig as extended by it. `findings`: of the audit.

    Without the drive's law no motion can be foretold: there is no next experiment.
    """
    fitted, held_out = split_runs(runs, options.hold_out)
    identified = identify_driven(fitted, held_out, rig, options)
    found, best = identified.found, identified.found.found.best
    verdict = judge(found, rig, (UNEXPLAINED_SHARE_DRIVEN, UNSEEN_SHARE_DRIVEN))
    options.progress("simulating the runs with each model")
    models = models_of(found, verdict, identified.rig)
    shown = _shown(found.records, models, options)
    unseen = _shown(found.held_out, models, options) if found.held_out else None
    told = beside(shown, unseen, options.seed, None)
    rungs: tuple[Rung, ...] = ()
    if not options.spent():
        options.progress("refitting the steps of the ladder")
        values = {effect.id: effect.parameters for effect in verdict.effects}
        rungs = ladder(best, found.records, found.held_out or found.records, values, told.floors, options.mapper)
    # What the extended rig holds, then, where nothing is named.
    shifts = parameter_shifts(found.found.baseline, rig) if verdict.verdict == "unnamed" else verdict.shifts
    shifts, scale = with_scale(shifts, identified.rig)
    diagnosis = diagnosis_of(found, verdict, told, (*findings, *identified.notes), shifts, scale, rungs)
    options.to_draw(diagnosis)
    return diagnosis, models.extended


def _shown(runs: Sequence[DrivenRun], models: Models, options: Options) -> Shown:
    """Return the models beside runs."""
    nominal, before, after = (
        play(runs, theta, options.mapper) for theta in (models.nominal, models.before, models.after)
    )
    return Shown([run.rows for run in runs], (nominal, before, after), _noise(runs, after))


def _noise(runs: Sequence[DrivenRun], played: Played) -> dict[str, float]:
    """Return the rms of each channel's noise: its sensor's behind the low pass, no more than a model leaves."""
    found: dict[str, float] = {}
    for name in dict.fromkeys(name for run in runs for name in run.rows.channels):
        there = [(run, shown) for run, shown in zip(runs, played.channels, strict=True) if name in shown]
        sensor = float(np.sqrt(np.mean([run.model.rows.noise[name] ** 2 for run, _ in there])))
        left = [np.mean((run.rows.channels[name] - shown[name])[run.mask] ** 2) for run, shown in there]
        found[name] = min(sensor, float(np.sqrt(np.mean(left))))
    return found
