"""Tables that hold their columns by name, as Parquet, Excel, MATLAB, HDF5 and MF4 do, as runs."""

from collections.abc import Callable, Sequence
from pathlib import Path

from hil_forceps.data.readers.tables.assemble import MAX_SAMPLES, assemble
from hil_forceps.data.readers.tables.columns import Header, OnColumns, Use, choose_columns, require_columns
from hil_forceps.data.readers.tables.mapping import ColumnMap
from hil_forceps.data.run import Column, Run
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError

Get = Callable[[Sequence[Use]], list[Column]]  # the columns in use, NaN where a cell is empty


def read_named(
    path: Path | str,
    name: str,
    header: Header,
    get: Get,
    rig: Rig | None,
    mapping: ColumnMap,
    on_columns: OnColumns | None = None,
    row: str = "row",
    first: int = 1,
) -> Run:
    """Choose the columns, get them, and make the run; `first` is the number of the first row, in messages.

    UserError where columns are missing or too long, and as `assemble`.
    """
    found = choose_columns(header, mapping)
    if on_columns is not None:
        on_columns(header, found)
    require_columns(found, header, mapped=bool(mapping))
    columns = {use.name: values for use, values in zip(found.uses, get(found.uses), strict=True)}
    if max(map(len, columns.values())) > MAX_SAMPLES:
        raise UserError(f"{header.place}: more than {MAX_SAMPLES} samples; cut it")
    run = assemble(path, name, columns, found.uses, rig, lambda at: f"{header.place}: {row} {at + first}")
    return Run(run.name, run.columns, (*found.notes, *run.notes))
