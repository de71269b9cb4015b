"""A run is cut at gaps that are too long to be filled, and its pieces are told."""

import numpy as np

from hil_forceps.data.run import Run
from hil_forceps.diagnosis.conclude import diagnose
from hil_forceps.diagnosis.options import Options
from hil_forceps.diagnosis.preparation.even_rows import MAX_GAP_ROWS, MIN_ROWS, even_pieces
from tests.unit.diagnosis.simulated_runs import POOL, STICKING, runs_of


def without(run: Run, *gaps: slice) -> Run:
    kept = np.ones(len(run), dtype=np.bool_)
    for gap in gaps:
        kept[gap] = False
    return Run(run.name, {name: values[kept] for name, values in run.columns.items()})


def test_pieces_begin_behind_long_gaps_only() -> None:
    (run,) = runs_of(STICKING, ("multisine",), 7700)
    filled = without(run, slice(100, 99 + MAX_GAP_ROWS))
    (whole,) = even_pieces(filled, STICKING)
    assert (whole.name, whole.of, whole.begin_s) == (run.name, "", 0.0)
    assert whole.lost.sum() == MAX_GAP_ROWS - 1
    short = MIN_ROWS - 1
    cut = without(run, slice(1000, 1100), slice(1100 + short, 3000))
    first, second = even_pieces(cut, STICKING)
    assert (first.of, second.of) == (run.name, run.name)
    assert first.name != second.name
    assert (len(first.run), len(second.run)) == (1000, len(run) - 3000)
    assert second.begin_s == run.columns["time_s"][3000] - run.columns["time_s"][0]
    # What a cut gives is what the whole run had there.
    expected = run.columns["theta_m_rad"][3000:]
    np.testing.assert_allclose(second.run.columns["theta_m_rad"], expected, rtol=0.0, atol=1e-12)


def test_a_piece_with_stamps_that_vary_makes_the_whole_run_uneven() -> None:
    (run,) = runs_of(STICKING, ("multisine",), 7700)
    cut = without(run, slice(1000, 1100))
    time_s = cut.columns["time_s"].copy()
    time_s[2000:2500] += 1e-4 * np.random.default_rng(0).uniform(-1.0, 1.0, 500)
    assert even_pieces(Run(cut.name, {**cut.columns, "time_s": time_s}), STICKING) == []


def test_gaps_beside_friction_are_no_cause_and_are_told() -> None:
    (whole,) = runs_of(STICKING, ("hold",), 7710)
    cut = without(whole, slice(2500, 2600), slice(4000, 4300))
    told = diagnose([cut], STICKING, Options(mapper=POOL.map)).diagnosis
    assert told.verdict in {"consistent", "parameters"}
    (note,) = (finding for finding in told.data_audit if finding.kind == "pieces")
    assert note.run == whole.name
    assert "3 pieces" in note.text
