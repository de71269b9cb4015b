"""Equally spaced rows: lost ones are filled, and a run is cut at gaps that are too long for that."""

import numpy as np
import pytest

from hil_forceps.data.even_rows import MAX_GAP_ROWS, MIN_ROWS, even_pieces, even_rows
from hil_forceps.data.run import Run
from tests.hidden_effects.generator import make_case
from tests.unit.diagnosis.simulated_runs import STICKING, runs_of


def without(run: Run, *gaps: slice) -> Run:
    kept = np.ones(len(run), dtype=np.bool_)
    for gap in gaps:
        kept[gap] = False
    return Run(run.name, {name: values[kept] for name, values in run.columns.items()})


def test_a_lost_row_is_filled_and_a_long_gap_is_not() -> None:
    case = make_case({}, 78, scenarios=(("multisine",), ()), rig=STICKING)
    columns = case.fit[0].columns
    kept = np.ones(columns["time_s"].size, dtype=np.bool_)
    kept[[400, 401, 900]] = False
    even = even_rows(Run("lost", {name: values[kept] for name, values in columns.items()}), STICKING)
    assert even is not None
    assert np.flatnonzero(even.lost).tolist() == [400, 401, 900]
    assert even.run.columns["time_s"] == pytest.approx(columns["time_s"], abs=1e-12)
    count = 2.0 * np.pi / 16384
    off = (even.run.columns["theta_m_rad"] - columns["theta_m_rad"]) / count
    assert np.max(np.abs(off - np.rint(off))) < 1e-6  # the law sees counts
    kept[2000:2050] = False
    assert even_rows(Run("gap", {name: values[kept] for name, values in columns.items()}), STICKING) is None
    jittered = columns["time_s"] + 1e-4 * np.random.default_rng(0).uniform(-1.0, 1.0, columns["time_s"].size)
    assert even_rows(Run("jitter", {**columns, "time_s": jittered}), STICKING) is None


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
