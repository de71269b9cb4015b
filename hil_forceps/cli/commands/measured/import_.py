"""`hil-forceps import`: runs of any known format into the project's own."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from hil_forceps.cli.arguments.files import file_name, make_folder
from hil_forceps.cli.arguments.map_file import leaving_map
from hil_forceps.cli.arguments.reading import bar, read_sources, show_audit
from hil_forceps.cli.kernels import telling_when_compiling
from hil_forceps.data.readers.csv_table import write_csv
from hil_forceps.data.readers.format import Choice
from hil_forceps.data.readers.parquet_table import require_parquet, write_parquet
from hil_forceps.data.readers.tables.mapping import read_map
from hil_forceps.data.run import Run
from hil_forceps.diagnosis.audit.audit import audit
from hil_forceps.rig import load_rig
from hil_forceps.rig.errors import UserError


def import_(
    *source: Path,
    out: Path | None = None,
    form: Annotated[Literal["csv", "parquet"], Parameter(name="--format")] = "csv",
    rig: Path | None = None,
    bus: str | None = None,
    node: int | None = None,
    map_: Annotated[tuple[str, ...], Parameter(name="--map")] = (),
    write_map: Path | None = None,
) -> int:
    """Write runs in the project's own format, one file each, SI units in the columns' names; audit them.

    Reads text of any layout (CSV), Parquet, Excel, MATLAB, HDF5, MDF (.mf4), recordings (.mcap), bus logs (.log .asc
    .blf .trc), the surgical-tool text format (folder, zip or text) and EPOS Studio's text, told by content.

    Parameters
    ----------
    source
        Files or folders.
    out
        Folder for the runs.
    form
        CSV, or Parquet (needs pyarrow).
    rig
        Rig file to audit against; without it only what needs no rig is looked at. Its section `recording:` says what a
        file doesn't hold: the rated torque, a constant load.
    bus
        Of a bus log with drives on several buses, the one to read: candump's interface, the channel of the others.
    node
        Of a bus log with several drives, the one to read.
    map_
        Which column of a table is which of a run, and its unit: theta_m_rad=pos:deg; or a YAML of such lines
        (docs/measured-data.md).
    write_map
        File for the mapping that was used, or that may be meant, as `--map` takes it; --out is not needed then.
    """
    if out is None and write_map is None:
        raise UserError("import: --out DIR is missing; name the folder for the runs")
    known = None if rig is None else load_rig(rig)
    if form == "parquet":
        require_parquet()
    with telling_when_compiling(), bar() as progress:
        with leaving_map(write_map) as on_columns:
            found = read_sources(source, progress, known, Choice(bus, node), read_map(map_), on_columns)
        if out is None:
            return 0
        make_folder(out)
        paths = _paths(found, out, form)
        task = progress.add_task("writing", total=len(found))
        for (_, run), path in zip(found, paths, strict=True):
            (write_csv if form == "csv" else write_parquet)(run, path)
            progress.advance(task)
        progress.update(task, description="audit", total=None)
        runs = [Run(path.stem, run.columns, run.notes) for (_, run), path in zip(found, paths, strict=True)]
        findings = audit(runs, known)
    show_audit(findings)
    rows = sum(len(run) for run in runs)
    sys.stdout.write(f"{len(runs)} run{'s' if len(runs) > 1 else ''}, {rows} samples, written to {out}/\n")
    return 0


def _paths(found: Sequence[tuple[Path, Run]], out: Path, form: str) -> list[Path]:
    """Name the files by run; where sources share a name, by source and run. Never a file that is being read."""
    names = [run.name for _, run in found]
    if len(set(names)) < len(names):
        names = [run.name if source.stem == run.name else f"{source.stem}-{run.name}" for source, run in found]
    paths = [out / f"{file_name(name)}.{form}" for name in names]
    twice = sorted({path.name for path in paths if paths.count(path) > 1})
    if twice:
        raise UserError(
            [f"import: two of the runs would be written as {name}; import them one by one" for name in twice]
        )
    sources = {source.resolve() for source, _ in found}
    if own := [path for path in paths if path.resolve() in sources]:
        raise UserError([f"{path}: would overwrite what is being read; name another folder" for path in own])
    return paths
