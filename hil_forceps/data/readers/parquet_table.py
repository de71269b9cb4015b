"""Runs as Parquet: the same columns as in CSV, as numbers, without their text."""

import importlib
from pathlib import Path
from typing import Any

import numpy as np

from hil_forceps.data.column_names import name_problems
from hil_forceps.data.readers.format import Format
from hil_forceps.data.run import KNOWN_COLUMNS, Column, Run, columns_problem
from hil_forceps.data.time_order import check_time_unit, drop_repeats
from hil_forceps.rig.errors import UserError

MAGIC = b"PAR1"
MAX_SAMPLES = 50_000_000
_BATCH_ROWS = 1 << 17


def read_parquet(path: str | Path) -> Run:
    """Read one run; the rules of `read_csv` hold, with row numbers (from 1) in place of lines.

    Raises UserError for whatever can't be used, also where pyarrow is not installed.
    """
    path = Path(path)
    arrow, parquet = _pyarrow("pyarrow"), _pyarrow("pyarrow.parquet")
    try:
        with parquet.ParquetFile(path) as file:
            columns, notes = _columns(path, arrow, file)
    except OSError as error:
        raise UserError(f"{path}: {error.strerror or _first_line(error)}") from error
    except (arrow.ArrowException, ValueError, MemoryError) as error:
        raise UserError(f"{path}: not a sound Parquet file: {_first_line(error)}; export it again") from error
    problem = columns_problem(columns)
    if problem:
        raise UserError(f"{path}: {problem}")
    columns, more = drop_repeats(columns, str(path), lambda row: f"{path}: row {row + 1}")
    check_time_unit(columns["time_s"], str(path))
    return Run(path.stem, columns, (*notes, *more))


def write_parquet(run: Run, path: str | Path) -> None:
    """Write `run` so that `read_parquet` gives the same numbers back; raises OSError as the disk does."""
    arrow, parquet = _pyarrow("pyarrow"), _pyarrow("pyarrow.parquet")
    names = [name for name in KNOWN_COLUMNS if name in run.columns]
    parquet.write_table(arrow.table({name: run.columns[name] for name in names}), path, compression="zstd")


def require_parquet() -> None:
    """UserError where pyarrow is missing."""
    _pyarrow("pyarrow.parquet")


def _columns(path: Path, arrow: Any, file: Any) -> tuple[dict[str, Column], list[str]]:
    names = list(file.schema_arrow.names)
    errors, notes = name_problems(names)
    for name in names:
        kind = None if name not in KNOWN_COLUMNS or names.count(name) > 1 else file.schema_arrow.field(name).type
        if kind is not None and not (arrow.types.is_floating(kind) or arrow.types.is_integer(kind)):
            errors.append(f"column {name} holds {kind}, not numbers; convert it to float64")
    if errors:
        raise UserError([f"{path}: {error}" for error in errors])
    count = int(file.metadata.num_rows)
    if not 0 <= count <= MAX_SAMPLES:
        raise UserError(f"{path}: {count} samples; at most {MAX_SAMPLES} are read: cut it")
    wanted = [name for name in names if name in KNOWN_COLUMNS]
    # No array of the stated length in advance: a damaged file may state any.
    parts: dict[str, list[Column]] = {name: [] for name in wanted}
    for batch in file.iter_batches(batch_size=_BATCH_ROWS, columns=wanted):
        for name in wanted:
            column = batch.column(batch.schema.get_field_index(name)).cast(arrow.float64(), safe=False)
            parts[name].append(np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64))
    return {name: np.concatenate(parts.pop(name)) if parts[name] else np.empty(0) for name in wanted}, notes


def _pyarrow(module: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise UserError(f"Parquet needs pyarrow, which can't be imported ({error}): pip install pyarrow") from error


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:200]


FORMAT = Format("Parquet", (".parquet",), lambda request: [read_parquet(request.path)], magic=(MAGIC,))
