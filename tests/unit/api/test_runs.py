"""`read_runs`: tables in memory give the runs that files give, and are refused in the same words."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import polars
import pyarrow
import pytest

import hil_forceps as hf
from hil_forceps.data.readers.csv_table import write_csv
from hil_forceps.data.run import Column

ROOT = Path(__file__).parents[3]
ROWS = 6
COLUMNS: dict[str, Column] = {
    "time_s": np.linspace(0.0, 5e-3, ROWS),
    "theta_m_rad": np.linspace(0.0, 0.5, ROWS),
    "current_A": np.linspace(0.1, 0.2, ROWS),
}


def structured(columns: dict[str, Any]) -> Any:
    array = np.zeros(ROWS, [(name, np.asarray(values).dtype) for name, values in columns.items()])
    for name, values in columns.items():
        array[name] = values
    return array


KINDS: dict[str, Callable[[dict[str, Any]], Any]] = {
    "dict": dict,
    "pandas": pandas.DataFrame,
    "polars": polars.DataFrame,
    "pyarrow": pyarrow.table,
    "structured array": structured,
    "lists": lambda columns: {name: list(values) for name, values in columns.items()},
}


@pytest.fixture(params=KINDS, ids=lambda kind: kind.replace(" ", "_"))
def table(request: pytest.FixtureRequest) -> Callable[[dict[str, Any]], Any]:
    return KINDS[request.param]


def test_any_table_gives_the_run(table: Any) -> None:
    (run,) = hf.read_runs(table(COLUMNS | {"temperature": np.full(ROWS, 20.0)}))
    assert run.name == "table0"
    assert list(run.columns) == list(COLUMNS)
    for name, values in COLUMNS.items():
        np.testing.assert_array_equal(run[name], values)
    assert run.notes == ("column 'temperature' is not a column of a run and was left out",)


def test_whole_numbers_and_single_precision_are_numbers(table: Any) -> None:
    (run,) = hf.read_runs(table(COLUMNS | {"current_A": np.arange(ROWS), "voltage_V": np.ones(ROWS, np.float32)}))
    np.testing.assert_array_equal(run["current_A"], np.arange(ROWS, dtype=float))
    assert run["voltage_V"].dtype == np.float64


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"theta_m_rad": None}, "table0: column theta_m_rad is missing"),
        ({"theta_m_rad": None, "theta_m": np.zeros(ROWS)}, "table0: column theta_m_rad is missing; if 'theta_m' is it"),
        ({"current_A": None}, "table0: neither current_A nor tau_m_N_m is there"),
        ({"current_A": np.array([0, np.nan, np.nan] * 2)}, "table0: row 1: current_A is empty or NaN in 4 of 6 rows"),
        ({"current_A": np.array([0, 0, np.inf, 0, 0, 0])}, "table0: row 2: current_A is not a finite number"),
        ({"time_s": np.array([0, 1, 2, 1, 3, 4]) * 1e-3}, "table0: row 3: time_s: 0.001 does not come after 0.002"),
        ({"time_s": np.arange(ROWS, dtype=float)}, "table0: time_s: rows are 1 s apart"),
        ({"current_A": np.array(list("abcdef"))}, "table0: column current_A holds"),
        ({"current_A": np.zeros(ROWS, dtype=bool)}, "table0: column current_A holds bool, not numbers"),
    ],
    ids=[
        "missing",
        "without a unit",
        "nothing drives",
        "NaN",
        "infinite",
        "back in time",
        "seldom",
        "text",
        "bool",
    ],
)
def test_what_is_no_run_is_refused_by_name_and_column(table: Any, change: dict[str, Any], said: str) -> None:
    columns = {name: values for name, values in {**COLUMNS, **change}.items() if values is not None}
    with pytest.raises(hf.UserError) as refused:
        hf.read_runs(table(columns))
    assert str(refused.value).startswith(said)
    assert len(refused.value.problems) == 1


def test_units_in_names_a_mapping_and_gaps(table: Any) -> None:
    degrees = np.linspace(0.0, 90.0, ROWS)
    columns = {"time_ms": np.arange(ROWS), "Position": degrees, "current_A": np.array([0, 0, np.nan, 0, 0, 0])}
    (run,) = hf.read_runs(table(columns), columns=["theta_m_rad=Position:deg"])
    np.testing.assert_array_equal(run["theta_m_rad"], np.delete(degrees, 2) * (np.pi / 180.0))
    assert "1 row with empty or NaN cells became gaps (current_A 1)" in run.notes


def test_a_table_is_refused_in_the_words_of_a_file(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time_s,theta_m,current_A\n0,0,0\n0.001,0,0\n")
    with pytest.raises(hf.UserError) as of_file:
        hf.read_runs(path)
    with pytest.raises(hf.UserError) as of_table:
        hf.read_runs({"time_s": [0, 1e-3], "theta_m": [0.0, 0.0], "current_A": [0.0, 0.0]})
    assert str(of_file.value).removeprefix(f"{path}:1: ") == str(of_table.value).removeprefix("table0: ")


def test_columns_of_unequal_length_and_of_two_dimensions() -> None:
    with pytest.raises(hf.UserError, match=r"table0: column current_A has shape \(2,\), time_s has 6 samples"):
        hf.read_runs(COLUMNS | {"current_A": np.zeros(2)})
    with pytest.raises(hf.UserError, match=r"column current_A has shape \(6, 2\)"):
        hf.read_runs(COLUMNS | {"current_A": np.zeros((ROWS, 2))})


def test_a_data_frame_with_a_name_twice() -> None:
    frame = pandas.DataFrame(COLUMNS)
    frame.insert(3, "current_A", frame["current_A"], allow_duplicates=True)
    with pytest.raises(hf.UserError, match="table0: column 'current_A' is there twice"):
        hf.read_runs(frame)


def test_sources_of_all_kinds_in_their_order_under_names_that_differ(tmp_path: Path) -> None:
    run = hf.Run("a", COLUMNS)
    write_csv(run, tmp_path / "a.csv")
    write_csv(run, tmp_path / "b.csv")
    read = hf.read_runs(str(tmp_path / "a.csv"), COLUMNS, run, tmp_path)
    assert [each.name for each in read] == ["a#1", "table1", "a#2", "a#3", "b"]
    named = hf.read_runs(run, COLUMNS, names=["first", "second"])
    assert [each.name for each in named] == ["first", "second"]
    with pytest.raises(ValueError, match="2 runs need as many names that differ"):
        hf.read_runs(run, COLUMNS, names=["first"])
    with pytest.raises(ValueError, match="names that differ"):
        hf.read_runs(run, COLUMNS, names=["first", "first"])


def test_what_is_no_source() -> None:
    with pytest.raises(hf.UserError, match="no runs were given; add at least one"):
        hf.read_runs()
    with pytest.raises(hf.UserError, match=r"nowhere\.csv: no such file"):
        hf.read_runs("nowhere.csv")
    for strange in (3, np.zeros((3, 2)), None):
        with pytest.raises(TypeError, match="no runs can be read from "):
            hf.read_runs(strange)  # type: ignore[arg-type]


def test_a_load_that_the_rig_knows_joins_a_table() -> None:
    rig = hf.load_rig(ROOT / "configs" / "realistic.yaml").with_changes({"recording.constant_load_N_m": 1e-3})
    (run,) = hf.read_runs(COLUMNS, rig=rig)
    np.testing.assert_array_equal(run["tau_w_N_m"], np.full(ROWS, 1e-3))
    assert "tau_w_N_m" not in hf.read_runs(COLUMNS)[0].columns


def test_a_run_as_a_data_frame_and_in_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    run = hf.Run("a", COLUMNS)
    frame = run.to_pandas()
    pandas.testing.assert_frame_equal(frame, pandas.DataFrame(COLUMNS))
    frame["current_A"] = 0.0
    np.testing.assert_array_equal(run["current_A"], COLUMNS["current_A"])
    assert repr(run) == "<Run 'a': 6 samples over 0.005 s; time_s, theta_m_rad, current_A>"
    monkeypatch.setitem(__import__("sys").modules, "pandas", None)
    with pytest.raises(hf.UserError, match="pip install pandas"):
        run.to_pandas()
