"""Runs as Parquet: the same columns as in CSV, as numbers, without their text."""

import importlib
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hil_forceps.data.readers.format import Format
from hil_forceps.data.readers.tables.columns import Header, OnColumns, Use
from hil_forceps.data.readers.tables.mapping import ColumnMap, map_beside
from hil_forceps.data.readers.tables.named_columns import read_named
from hil_forceps.data.run import KNOWN_COLUMNS, Column, Run
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError

MAGIC = b"PAR1"
MAX_SAMPLES = 50_000_000
_BATCH_ROWS = 1 << 17


def read_parquet(
    path: str | Path,
    rig: Rig | None = None,
    mapping: ColumnMap | None = None,
    on_columns: OnColumns | None = None,
) -> Run:
    """Read one run; the rules of `read_csv` hold, with row numbers (from 1) in place of lines.

    Raises UserError for whatever can't be used, also where pyarrow is not installed.
    """
    path = Path(path)
    arrow, parquet = _pyarrow("pyarrow"), _pyarrow("pyarrow.parquet")
    kept, note = map_beside(path)
    try:
        with parquet.ParquetFile(path) as file:
            names = tuple(file.schema_arrow.names)
            header = Header(names, place=str(path))
            get = partial(_columns, path, arrow, file)
            run = read_named(path, path.stem, header, get, rig, {**kept, **(mapping or {})}, on_columns)
    except OSError as error:
        raise UserError(f"{path}: {error.strerror or _first_line(error)}") from error
    except (arrow.ArrowException, ValueError, MemoryError) as error:
        raise UserError(f"{path}: not a valid Parquet file: {_first_line(error)}; export it again") from error
    return Run(run.name, run.columns, (*run.notes, note)) if note else run


def write_parquet(run: Run, path: str | Path) -> None:
    """Write `run` so that `read_parquet` gives the same numbers back; raises OSError as the disk does."""
    arrow, parquet = _pyarrow("pyarrow"), _pyarrow("pyarrow.parquet")
    names = [name for name in KNOWN_COLUMNS if name in run.columns]
    parquet.write_table(arrow.table({name: run.columns[name] for name in names}), path, compression="zstd")


def require_parquet() -> None:
    """UserError where pyarrow is missing."""
    _pyarrow("pyarrow.parquet")


def _columns(path: Path, arrow: Any, file: Any, uses: Sequence[Use]) -> list[Column]:
    errors = []
    for use in uses:
        kind = file.schema_arrow.field(use.position).type
        if not (arrow.types.is_floating(kind) or arrow.types.is_integer(kind)):
            errors.append(f"{path}: column {use.name} contains {kind}, not numbers; convert it to float64")
    if errors:
        raise UserError(errors)
    count = int(file.metadata.num_rows)
    if not 0 <= count <= MAX_SAMPLES:
        raise UserError(f"{path}: {count} samples; at most {MAX_SAMPLES} are read: cut it")
    names = [file.schema_arrow.field(use.position).name for use in uses]
    # No array of the stated length in advance: a damaged file may state any.
    parts: list[list[Column]] = [[] for _ in uses]
    for batch in file.iter_batches(batch_size=_BATCH_ROWS, columns=sorted(set(names))):
        for part, name in zip(parts, names, strict=True):
            column = batch.column(batch.schema.get_field_index(name)).cast(arrow.float64(), safe=False)
            part.append(np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64))
    return [np.concatenate(part) if part else np.empty(0) for part in parts]


def _pyarrow(module: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise UserError(f"Parquet needs pyarrow, which can't be imported ({error}); pip install pyarrow") from error


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:200]


FORMAT = Format(
    "Parquet",
    (".parquet",),
    lambda request: [read_parquet(request.path, request.rig, request.mapping, request.on_columns)],
    magic=(MAGIC,),
    is_table=True,
)
