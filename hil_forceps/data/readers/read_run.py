"""`read_run`: whatever a run may be stored in, told by its first bytes, then by its suffix."""

import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from hil_forceps.data.readers import surgical_files
from hil_forceps.data.readers.bus_frames import LOG_SUFFIXES
from hil_forceps.data.readers.csv_table import Progress, read_csv
from hil_forceps.data.readers.epos_studio import MARK, read_epos_studio
from hil_forceps.data.readers.surgical_tool import COLUMN_COUNT, iter_surgical_tool, jaw_side, parse_table, to_run
from hil_forceps.data.run import Run
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError

_SNIFFED_BYTES = 4096
EPOS_STUDIO = ".epos"  # in a file that is called .csv
_MAGIC = {
    b"\x89MCAP0\r\n": ".mcap",
    b"PAR1": ".parquet",
    b"PK\x03\x04": ".zip",
    b"PK\x05\x06": ".zip",
    b"LOGG": ".blf",
    b"MATLAB 5.0 MAT-file": ".mat",
    b"\x89HDF": ".hdf5",
}
_CANDUMP = re.compile(rb"\(\d+\.\d+\)\s+\S+\s+[0-9A-Fa-f]{3,8}#")
_NEEDS_MAGIC = frozenset({".mcap", ".parquet", ".zip", ".blf", ".mat"})


def read_run(path: str | Path, progress: Progress | None = None, rig: Rig | None = None) -> list[Run]:
    """Return every run in a file or folder, at least one; with a rig, what its recordings don't say is added.

    A file is a CSV, a Parquet file, a recording of the service (MCAP), a bus log (candump, ASC, BLF, TRC), a text of
    the surgical tool or a zip of them, a recording of EPOS Studio, or an EMPS `.mat`. A folder is a data set of the
    surgical tool, or holds any of these; its bus logs are read only when nothing else in it is a run, for the service
    writes both of one run. `progress` is told bytes read and bytes in all, of each CSV. Raises UserError, with the
    place in the file where there is one, for whatever can't be used.
    """
    found = _read(Path(path), progress, rig)
    load_N_m = None if rig is None else rig.recording.constant_load_N_m
    return found if load_N_m is None else [_with_load(run, load_N_m) for run in found]


def _with_load(run: Run, load_N_m: float) -> Run:
    if "tau_w_N_m" in run.columns:
        return run
    columns = {**run.columns, "tau_w_N_m": np.full(len(run), load_N_m)}
    return Run(run.name, columns, (*run.notes, f"load: {load_N_m:g} N m throughout, as the rig says"))


def _read(path: Path, progress: Progress | None, rig: Rig | None) -> list[Run]:
    try:
        if path.is_dir():
            return _folder(path, progress, rig)
        if not path.is_file():
            raise UserError(f"{path}: {'neither file nor folder' if path.exists() else 'no such file or folder'}")
        with path.open("rb") as file:
            head = file.read(_SNIFFED_BYTES)
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: {getattr(error, 'strerror', None) or error}; check the path") from error
    if not head:
        raise UserError(f"{path}: is empty; nothing was written to it")
    kind = kind_of(path, head)
    if kind == ".csv":
        return [read_csv(path, progress)]
    if kind == EPOS_STUDIO:
        return [read_epos_studio(path, rig)]
    reader = _READERS.get(kind)
    if reader is None:
        raise UserError(f"{path}: {kind} files are not read; give CSV, Parquet, MCAP, a bus log or a MATLAB 5 file")
    return reader(path)


def kind_of(path: Path, head: bytes) -> str:
    """Tell what a file is, as a suffix, from its first bytes; UserError when its suffix claims what they are not."""
    for magic, kind in _MAGIC.items():
        if head.startswith(magic):
            return kind
    suffix = path.suffix.lower()
    if suffix in _NEEDS_MAGIC:
        raise UserError(f"{path}: no {suffix} file: it begins with {head[:8]!r}; give it the suffix of what it is")
    if suffix in LOG_SUFFIXES:
        return suffix
    if _CANDUMP.match(head):
        return ".log"
    if MARK in head:
        return EPOS_STUDIO
    return ".txt" if _is_surgical(head) else ".csv"


def _is_surgical(head: bytes) -> bool:
    lines = [line for line in head.splitlines() if line.strip()]
    data = [line for line in lines if not line.startswith(b"%")]
    if len(data) < len(lines):
        return True
    return bool(data) and data[0].count(b",") == COLUMN_COUNT - 1 and not re.search(rb"[A-Za-z_]{3}", data[0])


def _surgical_text(path: Path) -> list[Run]:
    try:
        if path.stat().st_size > surgical_files.MAX_FILE_BYTES:
            raise UserError(f"{path}: larger than {surgical_files.MAX_FILE_BYTES >> 20} MiB")
        member = surgical_files.Member(path.stem, str(path), path.read_bytes())
    except OSError as error:
        raise UserError(f"{path}: {error.strerror or error}") from error
    table = parse_table(member)
    return [to_run(member.name, table, jaw_side(table))]


def _recording(path: Path) -> list[Run]:
    from hil_forceps.data.recording.reader import read_recording  # noqa: PLC0415 - mcap and zstd, for recordings only

    return [replace(read_recording(path).to_run(), name=path.stem)]


def _parquet(path: Path) -> list[Run]:
    from hil_forceps.data.readers.parquet_table import read_parquet  # noqa: PLC0415 - as above

    return [read_parquet(path)]


def _bus_log(kind: str) -> Callable[[Path], list[Run]]:
    def read(path: Path) -> list[Run]:
        from hil_forceps.data.readers.bus_run import read_bus_log  # noqa: PLC0415 - as above

        return read_bus_log(path, kind)

    return read


def _emps(path: Path) -> list[Run]:
    from hil_forceps.data.readers.emps import read_emps  # noqa: PLC0415 - as above

    return [read_emps(path)]


_READERS: dict[str, Callable[[Path], list[Run]]] = {
    ".parquet": _parquet,
    ".mcap": _recording,
    ".zip": lambda path: list(iter_surgical_tool(path)),
    ".txt": _surgical_text,
    ".mat": _emps,
    **{kind: _bus_log(kind) for kind in LOG_SUFFIXES},
}
RUN_SUFFIXES = frozenset({".csv", *_READERS})


def _folder(path: Path, progress: Progress | None, rig: Rig | None) -> list[Run]:
    files = sorted(file for file in path.iterdir() if file.suffix.lower() in RUN_SUFFIXES and file.is_file())
    plain = [file for file in files if file.suffix.lower() not in LOG_SUFFIXES | {".txt"}]
    if plain:
        return _all(plain, progress, rig)
    logs = [file for file in files if file.suffix.lower() in LOG_SUFFIXES]
    return _all(logs, progress, rig) if logs else list(iter_surgical_tool(path))


def _all(files: Iterable[Path], progress: Progress | None, rig: Rig | None) -> list[Run]:
    runs: list[Run] = []
    problems: list[str] = []
    for file in files:
        try:
            runs += _read(file, progress, rig)
        except UserError as error:
            problems += error.problems
    if problems:
        raise UserError(problems)
    return runs
