"""Runs: what a table must satisfy, and CSV in and out with errors that say where."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from hil_forceps.data.readers.csv_table import read_csv, write_csv
from hil_forceps.data.run import Run
from hil_forceps.rig import UserError

FINITE = st.floats(allow_nan=False, allow_infinity=False, width=64)


def columns(count: int = 5) -> dict[str, NDArray[np.float64]]:
    time_s = np.arange(count) * 1e-3
    return {"time_s": time_s, "theta_m_rad": np.sin(time_s), "current_A": np.zeros(count)}


def test_a_run_is_read_only_and_keeps_its_own_copy() -> None:
    given_columns = columns()
    run = Run("a", given_columns)
    given_columns["theta_m_rad"][0] = 99.0
    assert run.columns["theta_m_rad"][0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        run.columns["theta_m_rad"][0] = 1.0
    assert len(run) == 5
    assert run.notes == ()
    assert run.time_ns.tolist() == [0, 1_000_000, 2_000_000, 3_000_000, 4_000_000]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"time_s": None}, "time_s is missing"),
        ({"theta_m_rad": None}, "theta_m_rad is missing"),
        ({"current_A": None}, "neither current_A nor tau_m_N_m"),
        ({"theta_j_deg": np.zeros(5)}, "'theta_j_deg' is not one of"),
        ({"tau_w_N_m": np.zeros(4)}, "tau_w_N_m has shape"),
        ({"tau_w_N_m": np.zeros((5, 1))}, "tau_w_N_m has shape"),
        ({"tau_w_N_m": np.array([0, 0, np.nan, 0, 0])}, r"tau_w_N_m\[2\]"),
        ({"time_s": np.array([0, 1, 1, 2, 3.0])}, r"time_s\[2\]"),
        ({"time_s": np.array([0, 1, 2, np.inf, 3.0])}, r"time_s\[3\]"),
    ],
)
def test_a_wrong_run_is_refused(change: dict[str, NDArray[np.float64] | None], message: str) -> None:
    merged = columns() | change
    with pytest.raises(ValueError, match=message):
        Run("a", {name: values for name, values in merged.items() if values is not None})


def test_one_sample_is_too_few() -> None:
    with pytest.raises(ValueError, match="at least 2"):
        Run("a", columns(1))


def test_gaps_and_jitter_are_reported_not_refused() -> None:
    whole = columns(1000)
    kept = np.r_[0:400, 407:900, 902:1000]
    gappy = Run("a", {name: values[kept] for name, values in whole.items()}, ("mine",))
    assert gappy.notes[0] == "mine"
    assert gappy.notes[1].startswith("2 gaps in time, about 9 samples missing; longest 0.008 s after 0.399 s")
    shaken = dict(whole)
    shaken["time_s"] = whole["time_s"] + np.random.default_rng(0).uniform(0, 2e-4, 1000)
    (note,) = Run("b", shaken).notes
    assert note.startswith("jitter of the sample interval: 8")
    again = Run("a", gappy.columns, gappy.notes)
    assert again.notes == gappy.notes


@given(values=st.lists(st.tuples(FINITE, FINITE), min_size=2, max_size=20))
def test_csv_gives_back_the_same_bits(
    values: list[tuple[float, float]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    table = np.array(values)
    run = Run("r", {"time_s": np.arange(len(values)) / 30, "theta_m_rad": table[:, 0], "tau_m_N_m": table[:, 1]})
    path = tmp_path_factory.mktemp("csv") / "r.csv"
    write_csv(run, path)
    again = read_csv(path)
    assert again.name == "r"
    assert {name: column.tobytes() for name, column in again.columns.items()} == {
        name: column.tobytes() for name, column in run.columns.items()
    }


def test_csv_may_have_comments_blank_lines_a_mark_and_foreign_columns(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_bytes(
        b"\xef\xbb\xbf# bench 3\r\ntime_s, theta_m_rad,current_A,theta_j_rads,room\r\n\r\n"
        b"0,1,2,3,cold\r\n# pause\r\n0.001,1.5,2,3,cold\r\n"
    )
    run = read_csv(path)
    assert run.columns["theta_m_rad"].tolist() == [1.0, 1.5]
    assert sorted(run.columns) == ["current_A", "theta_m_rad", "time_s"]
    assert run.notes == (
        "column 'theta_j_rads' is not a column of a run and was left out (did you mean theta_j_rad?)",
        "column 'room' is not a column of a run and was left out",
    )


HEAD = "time_s,theta_m_rad,current_A\n"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", ":1: no header"),
        ("a,b,c\n1,2,3\n", ":1: none of the columns"),
        ("time_s,time_s,theta_m_rad\n", ":1: column 'time_s' is there twice"),
        ("time_s,theta_m_rad\n0,1\n1,1\n", ":1: neither current_A nor tau_m_N_m"),
        (HEAD, ":1: 0 samples are too few"),
        (HEAD + "0,1,2\n1,1\n", ":3: 2 cells, but the header has 3 columns"),
        (HEAD + "0,1,2\n1,1,2,3\n", ":3: 4 cells"),
        (HEAD + "0,1,2\n\n1,x,2\n", ":4: column 2 (theta_m_rad): 'x' is not a finite number"),
        (HEAD + "0,1,2\n1,1,\n", ":3: current_A is empty or NaN in 1 of 2 rows"),
        (HEAD + "0,1,2\n1,1,nan\n", ":3: current_A is empty or NaN in 1 of 2 rows"),
        (HEAD + "0,1,2\n# gap\n2,1,2\n1,1,2\n", ":5: time_s: 1 does not come after 2"),
        (HEAD + '0,1,2\n1,"1\n', "not a CSV file"),
        (HEAD + "0,1,\udcff\n", "not a text file"),
    ],
)
def test_a_bad_csv_is_refused_with_its_line(content: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.csv"
    path.write_bytes(content.encode(errors="surrogateescape"))
    with pytest.raises(UserError) as caught:
        read_csv(path)
    (problem,) = caught.value.problems
    assert problem.startswith(str(path))
    assert message in problem


def test_a_csv_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="No such file"):
        read_csv(tmp_path / "none.csv")
    with pytest.raises(UserError, match="directory"):
        read_csv(tmp_path)
