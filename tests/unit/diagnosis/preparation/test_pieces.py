"""A run is cut at gaps that are too long to be filled, and its pieces are told."""

import numpy as np

from hil_forceps.data.run import Run
from hil_forceps.diagnosis.conclude import diagnose
from hil_forceps.diagnosis.options import Options
from tests.unit.diagnosis.simulated_runs import POOL, STICKING, runs_of


def without(run: Run, *gaps: slice) -> Run:
    kept = np.ones(len(run), dtype=np.bool_)
    for gap in gaps:
        kept[gap] = False
    return Run(run.name, {name: values[kept] for name, values in run.columns.items()})


def test_gaps_beside_friction_are_no_cause_and_are_told() -> None:
    (whole,) = runs_of(STICKING, ("hold",), 7710)
    cut = without(whole, slice(2500, 2600), slice(4000, 4300))
    told = diagnose([cut], STICKING, Options(mapper=POOL.map)).diagnosis
    assert told.verdict in {"consistent", "parameters"}
    (note,) = (finding for finding in told.data_audit if finding.kind == "pieces")
    assert note.run == whole.name
    assert "3 pieces" in note.text
