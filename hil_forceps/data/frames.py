"""Runs out of tables in memory: pandas, polars, pyarrow, dicts of arrays. None of these libraries is imported."""

from collections.abc import Iterable, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hil_forceps.data.column_names import name_problems
from hil_forceps.data.run import KNOWN_COLUMNS, Column, Run, columns_problem
from hil_forceps.data.time_order import check_time_unit, drop_repeats
from hil_forceps.rig.errors import UserError


class Frame(Protocol):
    """A table with named columns, as DataFrames of pandas and polars are."""

    @property
    def columns(self) -> Iterable[Any]:
        """Names of the columns."""

    def __getitem__(self, name: Any, /) -> Any:
        """Return a column."""


Table = Frame | Mapping[str, ArrayLike] | NDArray[np.void]  # the last: a structured array


def is_table(source: object) -> bool:
    """Tell whether `read_table` takes it."""
    return _names(source) is not None


def read_table(table: Table, name: str) -> Run:
    """Return one run; the rules of `read_csv` hold, with rows counted from 0 in place of lines.

    UserError naming the run and the column for whatever can't be used. TypeError for what is no table.
    """
    names = _names(table)
    if names is None:
        raise TypeError(f"a {type(table).__name__} is no table: it has no named columns")
    errors, notes = name_problems(names)
    columns: dict[str, Column] = {}
    for known in (each for each in names if each in KNOWN_COLUMNS and names.count(each) == 1):
        array = np.asarray(table[known])
        if array.dtype.kind in "fiu":
            columns[known] = array.astype(np.float64)
        else:
            errors.append(f"column {known} holds {array.dtype}, not numbers; convert it to float64")
    if errors:
        raise UserError([f"{name}: {error}" for error in errors])
    problem = columns_problem(columns)
    if problem:
        raise UserError(f"{name}: {'; '.join([problem, *notes])}")
    columns, more = drop_repeats(columns, name, lambda row: f"{name}: row {row}")
    check_time_unit(columns["time_s"], name)
    return Run(name, columns, (*notes, *more))


def _names(table: Any) -> list[str] | None:
    """Return the names of columns; None where there are none."""
    if isinstance(table, Mapping):
        return [str(name) for name in table]
    if isinstance(table, np.ndarray):
        return None if table.dtype.names is None else list(table.dtype.names)
    # pyarrow's `columns` are the columns themselves.
    names = getattr(table, "column_names", None) or getattr(table, "columns", None)
    if names is None or not hasattr(table, "__getitem__"):
        return None
    return [str(name) for name in names]
