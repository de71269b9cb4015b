"""What a reader says of its format: how a file of it is told, and how it is read."""

from collections.abc import Callable
from pathlib import Path
from types import MappingProxyType
from typing import Literal, NamedTuple

from hil_forceps.data.readers.tables.columns import OnColumns
from hil_forceps.data.readers.tables.mapping import ColumnMap
from hil_forceps.data.run import Run
from hil_forceps.rig import Rig

Progress = Callable[[int, int], None]  # bytes read, bytes in all


class Choice(NamedTuple):
    """What of a bus log is wanted; None where it may be all."""

    bus: str | None = None  # an interface of candump, a channel of the others
    node: int | None = None


class Request(NamedTuple):
    """One file to be read."""

    path: Path
    progress: Progress | None = None
    rig: Rig | None = None  # what a recording of this format doesn't say may stand there
    choice: Choice = Choice()
    mapping: ColumnMap = MappingProxyType({})  # of a table's columns, as the user told; a file beside it may say more
    on_columns: OnColumns | None = None


class Format(NamedTuple):
    """A format that runs may be stored in.

    A file has it when it begins with one of `magic` (and `looks_like` doesn't deny it), else when its suffix is one of
    `suffixes` and `by_suffix` is set, else when `looks_like` says so of its first 4096 bytes. A suffix of a format with
    `magic` whose bytes are others is refused. `read` returns at least one run and raises UserError, with path, line and
    remedy, for what it can't use.
    """

    name: str
    suffixes: tuple[str, ...]  # lower case, with the dot
    read: Callable[[Request], list[Run]]
    magic: tuple[bytes, ...] = ()
    by_suffix: bool = False
    looks_like: Callable[[bytes], bool] | None = None
    # In a folder: each file is a run; or is read only where nothing else there is a run; or is part of a data set.
    in_folder: Literal["each", "otherwise", "part"] = "each"
    is_table: bool = False  # its columns may be mapped
    may_be_packed: bool = False  # as gzip or zstd; `looks_like` gets what is inside
