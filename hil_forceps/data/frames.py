"""Runs out of tables in memory: pandas, polars, pyarrow, dicts of arrays. None of these libraries is imported."""

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hil_forceps.data.readers.tables.columns import Header, Use
from hil_forceps.data.readers.tables.mapping import ColumnMap
from hil_forceps.data.readers.tables.named_columns import read_named
from hil_forceps.data.run import Column, Run
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


def read_table(table: Table, name: str, mapping: ColumnMap = MappingProxyType({})) -> Run:
    """Return one run; the rules of `read_csv` hold, with rows counted from 0 in place of lines.

    UserError naming the run and the column for whatever can't be used. TypeError for what is no table.
    """
    names = _names(table)
    if names is None:
        raise TypeError(f"a {type(table).__name__} is no table: it has no named columns")

    def get(uses: Sequence[Use]) -> list[Column]:
        return _numbers(table, names, uses, name)

    return read_named(name, name, Header(tuple(names), place=name), get, None, mapping, first=0)


def _numbers(table: Table, names: Sequence[str], uses: Sequence[Use], name: str) -> list[Column]:
    columns, errors = [], []
    for use in uses:
        array = np.asarray(table[names[use.position]])
        if array.dtype.kind in "fiu":
            columns.append(array.astype(np.float64))
        else:
            errors.append(f"{name}: column {use.name} holds {array.dtype}, not numbers; convert it to float64")
    if errors:
        raise UserError(errors)
    return columns


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
