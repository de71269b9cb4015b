"""MATLAB files of version 5 to 7: EMPS as published, or any with a vector for each column of a run."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil_forceps.data.readers.containers.content import vector, vectors, without_group
from hil_forceps.data.readers.format import Format, Request
from hil_forceps.data.readers.matlab import emps
from hil_forceps.data.readers.matlab.mat_file import MAGIC, parse_mat
from hil_forceps.data.readers.tables.columns import Header, Use
from hil_forceps.data.readers.tables.mapping import map_beside
from hil_forceps.data.readers.tables.named_columns import read_named
from hil_forceps.data.run import Column, Run
from hil_forceps.rig.errors import UserError

MAX_FILE_BYTES = 256 << 20
_SCALAR = 1


def read_mat(request: Request) -> list[Run]:
    """Read one file; UserError when it can't be read, is damaged, or has no columns of a run."""
    path = request.path
    variables = _variables(path)
    if emps.is_emps(variables) and not request.mapping:
        return [emps.to_run(path, variables)]
    found = {name: values for name, values in variables.items() if values.size > _SCALAR}
    places = [(name, number) for name, values in found.items() for number in range(len(vectors(name, values.shape)))]
    group, names = without_group([column for name, values in found.items() for column in vectors(name, values.shape)])

    def get(uses: Sequence[Use]) -> list[Column]:
        return [vector(found[places[use.position][0]], places[use.position][1]) for use in uses]

    kept, note = map_beside(path)
    mapping = {**kept, **request.mapping}
    run = read_named(
        path, path.stem, Header(names, (), str(path), group), get, request.rig, mapping, request.on_columns, "sample"
    )
    return [Run(run.name, run.columns, (*run.notes, note)) if note else run]


def _variables(path: Path) -> dict[str, NDArray[np.float64]]:
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise UserError(f"{path}: larger than {MAX_FILE_BYTES >> 20} MiB; save it as version 7.3, or as CSV")
        return parse_mat(path.read_bytes())
    except OSError as error:
        raise UserError(f"{path}: {error.strerror or error}") from error
    except ValueError as error:
        raise UserError(f"{path}: not a valid MATLAB file of version 5 to 7: {error}; save it again") from error


FORMAT = Format("MATLAB 5", (".mat",), read_mat, magic=(MAGIC,), is_table=True)
