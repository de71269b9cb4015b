"""`read_run`: whatever a run may be stored in, told by its first bytes, then by its suffix."""

from collections.abc import Iterable
from os import PathLike
from pathlib import Path
from types import MappingProxyType

import numpy as np

from hil_forceps.data.readers import csv_table, epos_studio, parquet_table, recording_file
from hil_forceps.data.readers.bus_logs import frames as bus_frames
from hil_forceps.data.readers.containers import formats as containers
from hil_forceps.data.readers.format import Choice, Format, Progress, Request
from hil_forceps.data.readers.matlab import mat_table
from hil_forceps.data.readers.no_run import NoRunError
from hil_forceps.data.readers.surgical_tool import reader as surgical
from hil_forceps.data.readers.tables.columns import OnColumns
from hil_forceps.data.readers.tables.mapping import ColumnMap
from hil_forceps.data.readers.tables.packed import inner_name, is_packed, unpacked_head
from hil_forceps.data.run import Run
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError

# What is asked first comes first; what no format claims is taken for the last.
FORMATS: tuple[Format, ...] = (
    recording_file.FORMAT,
    parquet_table.FORMAT,
    containers.HDF5,
    containers.MF4,
    containers.EXCEL,
    surgical.ZIP,
    bus_frames.BLF,
    bus_frames.CANDUMP,
    bus_frames.ASC,
    bus_frames.TRC,
    mat_table.FORMAT,
    epos_studio.FORMAT,
    surgical.TEXT,
    csv_table.FORMAT,
)
_SNIFFED_BYTES = 4096


def read_run(
    path: str | PathLike[str],
    progress: Progress | None = None,
    rig: Rig | None = None,
    choice: Choice = Choice(),  # noqa: B008 - a constant
    mapping: ColumnMap = MappingProxyType({}),
    on_columns: OnColumns | None = None,
) -> list[Run]:
    """Return every run in a file or folder, at least one; with a rig, what its recordings don't say is added.

    A file has one of `FORMATS`. A folder is a data set of the surgical tool, or holds files of any format; its bus logs
    are read only when nothing else in it is a run, for the service writes both of one run. `progress` is told bytes
    read and bytes in all, of each CSV. `choice` is of bus logs; other files have one bus. `mapping` names the columns
    of tables, and `on_columns` is told what came of each header. Raises UserError, with the place in the file where
    there is one, for whatever can't be used.
    """
    found = _read(Request(Path(path), progress, rig, choice, mapping, on_columns))
    return [with_known_load(run, rig) for run in found]


def format_of(path: Path, head: bytes) -> Format:
    """Tell a file's format from its first bytes and its suffix; UserError when its suffix claims what it isn't."""
    suffix = _suffix(path)
    for each in FORMATS:
        if any(head.startswith(magic) for magic in each.magic) and (each.looks_like is None or each.looks_like(head)):
            return each
    for each in FORMATS:
        if suffix in each.suffixes and each.magic:
            raise UserError(f"{path}: not a {suffix} file: it begins with {head[:8]!r}; correct its suffix")
        if suffix in each.suffixes and each.by_suffix:
            return each
    claims = (each for each in FORMATS if not each.magic and each.looks_like is not None and each.looks_like(head))
    return next(claims, FORMATS[-1])


def with_known_load(run: Run, rig: Rig | None) -> Run:
    """Add the load that the rig says was there throughout, where it says so and the run has none."""
    load_N_m = None if rig is None else rig.recording.constant_load_N_m
    if load_N_m is None or "tau_w_N_m" in run.columns:
        return run
    columns = {**run.columns, "tau_w_N_m": np.full(len(run), load_N_m)}
    return Run(run.name, columns, (*run.notes, f"load: {load_N_m:g} N m throughout, from the rig file"))


def _read(request: Request) -> list[Run]:
    path = request.path
    try:
        if path.is_dir():
            return _folder(request)
        if not path.is_file():
            raise UserError(f"{path}: {'neither file nor folder' if path.exists() else 'no such file or folder'}")
        with path.open("rb") as file:
            head = file.read(_SNIFFED_BYTES)
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: {getattr(error, 'strerror', None) or error}; check the path") from error
    if not head:
        raise UserError(f"{path}: is empty; record or export it again")
    packed = is_packed(head)
    found = format_of(path, unpacked_head(path, _SNIFFED_BYTES) if packed else head)
    if packed and not found.may_be_packed:
        raise UserError(f"{path}: {found.name} can't be read compressed; decompress it first (gunzip, zstd -d)")
    runs = found.read(request)
    if request.mapping and not found.is_table:
        told = f"--map was not used: {found.name} has fixed columns"
        return [Run(run.name, run.columns, (*run.notes, told)) for run in runs]
    return runs


def _suffix(path: Path) -> str:
    return Path(inner_name(path)).suffix.lower()


def _folder(request: Request) -> list[Run]:
    suffixes = {suffix: each.in_folder for each in FORMATS for suffix in each.suffixes}
    files = sorted(file for file in request.path.iterdir() if _suffix(file) in suffixes and file.is_file())
    seen = [file for file in files if not file.name.startswith(".")]
    # macOS puts a ._ file beside each file on a disk of another system; none of them is anybody's run.
    hidden = tuple(f"{file.name} was left out: a hidden file" for file in files if file.name.startswith("."))
    for turn in ("each", "otherwise"):
        chosen = [file for file in seen if suffixes[_suffix(file)] == turn]
        if chosen:
            return _all(chosen, request, hidden)
    return list(surgical.iter_surgical_tool(request.path))


def _all(files: Iterable[Path], request: Request, notes: tuple[str, ...]) -> list[Run]:
    runs: list[Run] = []
    problems: list[str] = []
    strange: list[str] = []
    for file in files:
        try:
            runs += _read(request._replace(path=file))
        except NoRunError as error:
            strange += error.problems
            notes += (f"{file.name} was left out: it has no column of a run",)
        except UserError as error:
            problems += error.problems
    if problems or not runs:
        raise UserError([*problems, *strange])
    return [Run(run.name, run.columns, (*run.notes, *notes)) for run in runs] if notes else runs
