"""HDF5, and MATLAB 7.3 which is HDF5: numeric datasets by their path, through h5py.

Only what the file itself holds is read: no links to other files, no external or virtual storage, no objects.
"""

import importlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hil_forceps.data.readers.containers.content import (
    MAX_NAMES,
    MAX_SAMPLES,
    Array,
    ContentError,
    Table,
    vector,
    vectors,
    without_group,
)

_MAX_DEPTH = 16
_MAX_CHUNK_BYTES = 256 << 20
_PACKED_RATIO = 1032  # of deflate, at best
_MATLABS_OWN = "#"  # groups of references begin so
_UNIT_ATTRIBUTES = ("unit", "units", "Unit", "Units")

_Place = tuple[str, str, int]  # dataset, field of a compound ("" for none), column


def tables(path: Path) -> list[Table]:
    """Return the one table of a file: a column for each vector, and for each column of a matrix."""
    h5py: Any = importlib.import_module("h5py")
    file = h5py.File(path, "r", locking=False)
    names: list[str] = []
    units: list[str] = []
    places: list[_Place] = []
    for name, dataset in _datasets(h5py, file, "", set(), 0):
        for column, place in _columns(name, dataset):
            names.append(column)
            units.append(_unit(dataset))
            places.append(place)
            if len(names) > MAX_NAMES:
                raise ContentError(f"more than {MAX_NAMES} columns; write those of the run to a separate file")
    if not names:
        raise ContentError("contains no numeric vector; write one for each column")

    def get(positions: Sequence[int], base: int | None) -> list[Array]:
        del base
        return [_read(file, places[position]) for position in positions]

    group, short = without_group(names)
    return [Table("", short, tuple(units), get, group)]


def _datasets(h5py: Any, group: Any, path: str, seen: set[Any], depth: int) -> Iterator[tuple[str, Any]]:
    if depth > _MAX_DEPTH or len(seen) > MAX_NAMES:
        raise ContentError(f"groups deeper than {_MAX_DEPTH}, or more than {MAX_NAMES} of them")
    for name in group:
        if name.startswith(_MATLABS_OWN) or not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue
        found = group[name]
        address = h5py.h5o.get_info(found.id).addr
        if address in seen:
            continue
        seen.add(address)
        if isinstance(found, h5py.Group):
            yield from _datasets(h5py, found, f"{path}{name}/", seen, depth + 1)
        elif isinstance(found, h5py.Dataset) and not found.is_virtual and found.external is None:
            yield f"{path}{name}", found


def _columns(name: str, dataset: Any) -> Iterator[tuple[str, _Place]]:
    kind = dataset.dtype
    if kind.fields is not None:
        fields = [field for field in kind.names if kind[field].kind in "fiu" and kind[field].shape == ()]
        for field in fields if dataset.ndim == 1 else ():
            yield f"{name}/{field}", (dataset.name, field, 0)
    elif kind.kind in "fiu" and dataset.size >= 2:
        for number, column in enumerate(vectors(name, dataset.shape)):
            yield column, (dataset.name, "", number)


def _unit(dataset: Any) -> str:
    for name in _UNIT_ATTRIBUTES:
        if name in dataset.attrs:
            value = dataset.attrs[name]
            text = value.decode(errors="replace") if isinstance(value, bytes) else value
            return text[:40] if isinstance(text, str) else ""
    return ""


def _read(file: Any, place: _Place) -> Array:
    name, field, number = place
    dataset = file[name]
    size = dataset.size * dataset.dtype.itemsize
    chunk = int(np.prod(dataset.chunks)) * dataset.dtype.itemsize if dataset.chunks else 0
    if dataset.size > MAX_SAMPLES or chunk > _MAX_CHUNK_BYTES or dataset.id.get_storage_size() * _PACKED_RATIO < size:
        raise ContentError(
            f"{name}: {dataset.size} numbers in {dataset.id.get_storage_size()} bytes; cut it or write it again"
        )
    values = dataset[field] if field else dataset[()]
    return vector(np.asarray(values), number)
