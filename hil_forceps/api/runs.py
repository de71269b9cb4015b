"""`read_runs`: measured runs from files, DataFrames and arrays."""

from collections import Counter
from collections.abc import Sequence
from os import PathLike

from hil_forceps.api.arguments import check_text, check_texts, check_whole, kind
from hil_forceps.data.frames import Table, is_table, read_table
from hil_forceps.data.readers.format import Choice
from hil_forceps.data.readers.read_run import read_run, with_known_load
from hil_forceps.data.readers.tables.mapping import read_map
from hil_forceps.data.run import Run
from hil_forceps.rig import Rig, load_rig
from hil_forceps.rig.errors import UserError

Source = str | PathLike[str] | Run | Table
RigSource = Rig | str | PathLike[str]


def read_runs(
    *sources: Source,
    rig: RigSource | None = None,
    names: Sequence[str] | None = None,
    bus: str | None = None,
    node: int | None = None,
    columns: Sequence[str] = (),
) -> list[Run]:
    """Return all runs of all sources, in their order, with unique names.

    A source is a file or a folder of any format that `hil-forceps import` reads, a DataFrame of pandas or polars, a
    pyarrow table, a mapping of arrays, a structured array, or a `Run`. Columns are named and in units as in a CSV:
    `time_s`, `theta_m_rad`, and `current_A` or `tau_m_N_m` at least; other names are left out and noted.

    `rig`: has values that recordings do not contain (`recording:`). `names`: of all runs; by default files name theirs,
    and a table is `table0`, `table1`, ... by its place among the sources. `bus`, `node`: those to read of a bus log.
    `columns`: map from columns of a file or table to those of a run, as for `--map` ("theta_m_rad=pos:deg"). UserError
    names file or run, the place in it and the remedy; TypeError for other types.
    """
    known = None if rig is None else as_rig(rig)
    _check(names, bus, node, columns)
    mapping = read_map(columns)
    found: list[Run] = []
    for place, source in enumerate(sources):
        if isinstance(source, Run):
            found.append(source)
        elif isinstance(source, str | PathLike):
            found += read_run(source, rig=known, choice=Choice(bus, node), mapping=mapping)
        elif is_table(source):
            found.append(with_known_load(read_table(source, f"table{place}", mapping), known))
        else:
            several = "; give each as an argument of its own, read_runs(*sources)" if _is_several(source) else ""
            told = f"no runs can be read from {kind(source)}{several}"
            raise TypeError(f"source {place + 1}: {told}: it must be a file, a table or a Run")
    if not found:
        raise UserError("no runs were given; add at least one")
    if names is None:
        return _with_own_names(found)
    if len(names) != len(found) or len(set(names)) < len(names):
        raise ValueError(f"names: {len(found)} runs need as many names that differ, not {list(names)}")
    return [Run(name, run.columns, run.notes) for name, run in zip(names, found, strict=True)]


def as_rig(rig: RigSource) -> Rig:
    """Return a rig, read from a file if a path is given; UserError as of `load_rig`, TypeError for other types."""
    if isinstance(rig, Rig):
        return rig
    if not isinstance(rig, str | PathLike):
        raise TypeError(f"rig: must be a Rig or the path of a rig file, not {kind(rig)}; hf.load_rig reads one")
    return load_rig(str(rig))


def _check(names: object, bus: object, node: object, columns: object) -> None:
    check_texts("columns", columns)
    if names is not None:
        check_texts("names", names)
    if bus is not None:
        check_text("bus", bus)
    if node is not None:
        check_whole("node", node)


def _is_several(source: object) -> bool:
    """Return whether a value is a sequence of sources."""
    return isinstance(source, list | tuple) and all(
        isinstance(each, str | PathLike | Run) or is_table(each) for each in source
    )


def _with_own_names(runs: Sequence[Run]) -> list[Run]:
    """Number runs that have the same name."""
    count = Counter(run.name for run in runs)
    met: Counter[str] = Counter()
    result = []
    for run in runs:
        met[run.name] += 1
        own = run if count[run.name] == 1 else Run(f"{run.name}#{met[run.name]}", run.columns, run.notes)
        result.append(own)
    return result
