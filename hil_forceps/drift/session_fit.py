"""The known parameters of one session: as a diagnosis fits them, in a second of one core for 12 s at 1 kHz.

Most steps of a fit are far from the optimum, where few rows tell the direction as well as all of them. So two excerpts
are fitted first, and the fit of all rows starts at their result. Noise, the load's prior and the filter's decisions are
those of a diagnosis.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.audit.audit import audit
from hil_forceps.audit.finding import Finding
from hil_forceps.data.even_rows import EvenRun
from hil_forceps.data.run import Run
from hil_forceps.diagnosis.conclude import silent
from hil_forceps.diagnosis.driven.identification import fit_driven
from hil_forceps.diagnosis.evidence import pass_all
from hil_forceps.diagnosis.identification import known_of, records_of
from hil_forceps.diagnosis.inference.fit import Fit, fit, fit_from
from hil_forceps.diagnosis.inference.load_noise import with_likeliest_load_noises
from hil_forceps.diagnosis.inference.parameters import known, unit_of
from hil_forceps.diagnosis.preparation.excerpts import excerpts
from hil_forceps.diagnosis.preparation.sensor_noise import sensor_noise
from hil_forceps.diagnosis.starting_parameters import starting_parameters
from hil_forceps.diagnosis.state_space.advance import physics_of
from hil_forceps.diagnosis.validation.conclusion import even_runs
from hil_forceps.diagnosis.validation.rows import require_rows
from hil_forceps.drift.likelihood import Measured, by_likelihood
from hil_forceps.model.parameters import PLANT_NAMES
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError

Vector = NDArray[np.float64]

START_ROWS = 1000  # of an excerpt for the start: long against all that a plant forgets
START_EXCERPTS = 2
JAW_FRICTION = "forceps.jaw_coulomb_N_m"
WITHOUT_LOAD_CELL = "without a load cell it is a load, as any"
WITHOUT_LAW = "the drive's law isn't known here: intervals are of noise alone, and too narrow"
LEAST_RATIO = 3  # of the run's rows to those of the excerpts; below it the excerpts save no time


class SessionFit(NamedTuple):
    """What one session measures."""

    parameters: tuple[Measured, ...]
    rows: int  # measured, of all runs
    rows_used: int
    method: str  # "filter": the drive's law is known; "driven": the motion drives the model
    notes: tuple[str, ...]


def fit_session(runs: Sequence[Run], rig: Rig) -> SessionFit:
    """Fit the known parameters of a rig to the runs of a session; effects of the rig are taken as they stand.

    UserError, in one line, where the runs can't be used or say nothing.
    """
    findings = audit(runs, rig)
    if wrong := [finding.text for finding in findings if finding.severity == "problem"]:
        raise UserError(f"the data can't be right as they are: {wrong[0]}")
    if reasons := silent(runs, rig):
        raise UserError(reasons[0])
    notes = tuple(dict.fromkeys(_words(finding) for finding in findings if finding.severity == "warning"))
    rows = sum(len(run) for run in runs)
    even = even_runs(runs, rig)
    if even is None:
        driven, used = fit_driven(runs, rig)
        notes = (*notes, WITHOUT_LAW)
        return SessionFit(_without_loads(by_likelihood(driven), runs, rig), rows, used, "driven", notes)
    for each in even:
        require_rows(each.name, int(np.count_nonzero(~each.lost)))
    even, left_out = excerpts(even)
    notes = (*notes, *(finding.text for finding in left_out))
    used = sum(int(np.count_nonzero(~each.lost)) for each in even)
    return SessionFit(_without_loads(by_likelihood(fit_even(even, rig)), runs, rig), rows, used, "filter", notes)


def _without_loads(measured: Sequence[Measured], runs: Sequence[Run], rig: Rig) -> tuple[Measured, ...]:
    """Return parameters without what nothing tells from a load where no run has a load cell."""
    if any("tau_w_N_m" in run.columns for run in runs):
        return tuple(measured)
    assumed = known(rig, JAW_FRICTION).value or 0.0
    untold = Measured(JAW_FRICTION, unit_of(JAW_FRICTION), assumed, np.nan, np.nan, WITHOUT_LOAD_CELL)
    others = (p for p in measured if p.name != JAW_FRICTION)
    return tuple(sorted((*others, untold), key=lambda p: PLANT_NAMES.index(p.name)))


def fit_even(even: Sequence[EvenRun], rig: Rig) -> Fit:
    """Return the fit of the known parameters to runs of a drive whose law is known."""
    noise = sensor_noise([each.run for each in even], rig)
    start = starting_parameters(even, rig)
    records, _ = records_of(even, [], rig, noise, map, start)
    parts = _parts(even)
    first = records_of(parts, [], rig, noise, map, start)[0] if parts else records
    theta = fit(first, start, known_of(rig, first), map).passes.theta
    runs = [record.with_friction_of(physics_of(theta)) for record in records]
    passes = pass_all(runs, theta, map)
    quiet = with_likeliest_load_noises(runs, passes, map)
    if any(new is not old for new, old in zip(quiet, runs, strict=True)):
        passes = pass_all(quiet, theta, map)
    decided = [run.decided_by(passed.filtered) for run, passed in zip(quiet, passes.runs, strict=True)]
    # With what it decided itself, a pass is the same again: it need not be made twice.
    same = [
        p._replace(series=p.series._replace(switching=run.series.switching))
        for run, p in zip(decided, passes.runs, strict=True)
    ]
    return fit_from(decided, passes._replace(runs=tuple(same)), known_of(rig, records), map)


def _parts(even: Sequence[EvenRun]) -> list[EvenRun]:
    """Return excerpts of the longest run to begin with; none where they would save nothing."""
    longest = max(even, key=lambda each: each.lost.size)
    rows = longest.lost.size
    if rows < LEAST_RATIO * START_EXCERPTS * START_ROWS:
        return []
    firsts = np.linspace(0, rows - START_ROWS, START_EXCERPTS + 2)[1:-1].astype(int)
    return [longest.part(int(first), int(first) + START_ROWS) for first in firsts]


def _words(finding: Finding) -> str:
    where = " ".join(word for word in (finding.run, finding.channel) if word)
    return f"{where}: {finding.text}" if where else finding.text
