"""The files of one surgical-tool data set, out of a folder or a zip, with bounds on what is read."""

import re
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import NamedTuple, TypeVar

from hil_forceps.rig.errors import UserError

MAX_FILE_BYTES = 16 << 20  # a run of 20 s has 1.2 MB
MAX_FILES = 100  # two digits
MAX_ZIP_ENTRIES = 10_000
_SHOWN_CHARACTERS = 200

_COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_Home = TypeVar("_Home", Path, str)
_RUN_FILE = re.compile(r"[0-9]{2}\.txt", re.IGNORECASE)


class Member(NamedTuple):
    """One run's text as it came."""

    name: str  # "23"
    label: str  # path for messages, inside its zip where it came from one
    data: bytes


def open_data_set(path: str | Path) -> Iterator[Member]:
    """Yield the members `XY.TXT` of the folder or zip at `path`, sorted by name; other files are passed over.

    Raises UserError when there is no such path, it is neither folder nor zip, holds no run or several data sets, a
    member is larger than `MAX_FILE_BYTES` (whatever the zip's directory claims), or the zip is damaged.
    """
    path = Path(path)
    try:
        yield from _folder(path) if path.is_dir() else _zip(path)
    except OSError as error:
        raise UserError(f"{path}: {error.strerror or error}") from error


def _folder(path: Path) -> Iterator[Member]:
    # One level down as well: the zips hold a folder of their own name.
    homes = [home for home in (path, *sorted(d for d in path.iterdir() if d.is_dir())) if _runs_in(home)]
    for file in _runs_in(_only(path, homes)):
        if file.stat().st_size > MAX_FILE_BYTES:
            raise _too_large(str(file))
        yield Member(file.stem, str(file), file.read_bytes())


def _runs_in(folder: Path) -> list[Path]:
    return sorted(file for file in folder.iterdir() if _RUN_FILE.fullmatch(file.name) and file.is_file())


def _zip(path: Path) -> Iterator[Member]:
    with _archive(path) as archive:
        entries = archive.infolist()
        if len(entries) > MAX_ZIP_ENTRIES:
            raise UserError(f"{path}: {len(entries)} entries; a data set has at most {MAX_FILES} runs")
        runs = [entry for entry in entries if _RUN_FILE.fullmatch(PurePosixPath(entry.filename).name)]
        home = _only(path, sorted({str(PurePosixPath(entry.filename).parent) for entry in runs}))
        if len(runs) > MAX_FILES:
            raise UserError(f"{path}: {len(runs)} runs in {home}; a data set has at most {MAX_FILES}")
        for entry in sorted(runs, key=lambda entry: entry.filename):
            label = f"{path}!{entry.filename}"
            yield Member(PurePosixPath(entry.filename).stem, label, _bounded(archive, entry, label))


def _archive(path: Path) -> zipfile.ZipFile:
    try:
        return zipfile.ZipFile(path)
    except (zipfile.BadZipFile, NotImplementedError, ValueError) as error:
        raise UserError(f"{path}: neither a folder nor a valid zip file: {str(error)[:_SHOWN_CHARACTERS]}") from error


def _bounded(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, label: str) -> bytes:
    if entry.compress_type not in _COMPRESSIONS:
        raise UserError(f"{label}: compressed by method {entry.compress_type}; only stored and deflated are read")
    try:
        with archive.open(entry) as file:
            data = file.read(MAX_FILE_BYTES + 1)  # the size in the zip's directory may lie
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError) as error:
        raise UserError(f"{label}: can't be unpacked: {str(error)[:_SHOWN_CHARACTERS]}") from error
    if len(data) > MAX_FILE_BYTES:
        raise _too_large(label)
    return data


def _only(path: Path, homes: list[_Home]) -> _Home:
    if not homes:
        raise UserError(
            f"{path}: contains no run; name files, or a folder of files (CSV, .mcap, XY.TXT of the surgical tool)"
        )
    if len(homes) > 1:
        raise UserError(f"{path}: contains several data sets ({', '.join(map(str, homes[:4]))}); name one of them")
    return homes[0]


def _too_large(label: str) -> UserError:
    return UserError(f"{label}: larger than {MAX_FILE_BYTES >> 20} MiB")
