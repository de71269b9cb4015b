"""The known parameters of a session whose drive isn't known: its motion as measured drives the model."""

from collections.abc import Sequence

from hil_forceps.data.run import Run
from hil_forceps.diagnosis.driven.identification import GAUGES, known_of
from hil_forceps.diagnosis.driven.jaw_zero import without_jaw_zero
from hil_forceps.diagnosis.driven.noise import Adapting, noise_of_strokes
from hil_forceps.diagnosis.driven.rows import driven_rows
from hil_forceps.diagnosis.driven.runs import driven_runs
from hil_forceps.diagnosis.driven.starting_values import completed
from hil_forceps.diagnosis.hypotheses.search import Search, fit_known
from hil_forceps.diagnosis.identification import LIKE_A_LOAD
from hil_forceps.diagnosis.inference.fit import Fit
from hil_forceps.model import parameters
from hil_forceps.rig import Rig


def fit_driven(runs: Sequence[Run], rig: Rig) -> tuple[Fit, int]:
    """Return the fit, and how many rows it used; UserError where a run can't serve."""
    rows, _ = driven_rows(runs)
    rows, _, _ = without_jaw_zero(rows, [])
    rig = completed(rows, rig)
    fitted = driven_runs(rows)
    without = frozenset(rig.effects) | GAUGES
    without |= frozenset() if any(run.load_measured for run in fitted) else LIKE_A_LOAD
    how = Search(
        fitted,
        known_of(rig, fitted),
        map,
        without,
        0,
        lambda _: None,
        lambda: False,
        Adapting(without, map, noise_of_strokes(fitted)),
        0.0,
        tied_share=0.0,
        geared=False,
        most_effects=0,
        weigh=None,
    )
    return fit_known(how, parameters.vector(rig)), sum(int(run.mask.sum()) for run in fitted)
