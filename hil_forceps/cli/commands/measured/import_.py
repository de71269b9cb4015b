"""`hil-forceps import`: conversion of measured runs to the project's format."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from hil_forceps.audit.audit import audit
from hil_forceps.cli.arguments.files import file_name, make_folder
from hil_forceps.cli.arguments.map_file import leaving_map
from hil_forceps.cli.arguments.reading import bar, read_sources, show_audit
from hil_forceps.cli.kernels import telling_when_compiling
from hil_forceps.data.readers.csv_table import write_csv
from hil_forceps.data.readers.format import Choice
from hil_forceps.data.readers.parquet_table import require_parquet, write_parquet
from hil_forceps.data.readers.tables.mapping import read_map
from hil_forceps.data.run import Run
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
    """Convert runs to the project's format, one file each, with SI units in the column names; audit the data.

    Reads text tables (CSV), Parquet, Excel, MATLAB, HDF5, MDF (.mf4), recordings (.mcap), bus logs (.log .asc .blf
    .trc), the surgical-tool text format (folder, zip or text) and text exported by EPOS Studio. The format is detected
    from the content.

    Parameters
    ----------
    source
        Files or folders.
    out
        Folder for the runs.
    form
        csv, or parquet (needs pyarrow).
    rig
        Rig file for the audit; without it only checks that need no rig are made. Its section `recording:` has values
        that a file does not contain, such as the rated torque or a constant load.
    bus
        Bus to read, if a bus log has drives on several: the interface in candump's format, the channel in others.
    node
        Node to read, if a bus log has several drives.
    map_
        Column of a table for a quantity of a run, with its unit, such as theta_m_rad=pos:deg; or a YAML file of such
        lines (docs/measured-data.md).
    write_map
        File for the column mapping that was used, or for a proposal, in the format of --map; --out is not needed then.
    """
    if out is None and write_map is None:
        raise UserError("--out: missing; name the folder for the runs")
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
    """Name the files by run, or by source and run if runs share a name; UserError if a source would be overwritten."""
    names = [run.name for _, run in found]
    if len(set(names)) < len(names):
        names = [run.name if source.stem == run.name else f"{source.stem}-{run.name}" for source, run in found]
    paths = [out / f"{file_name(name)}.{form}" for name in names]
    twice = sorted({path.name for path in paths if paths.count(path) > 1})
    if twice:
        raise UserError(
            [f"--out {out}: two runs would have the file name {name}; import them separately" for name in twice]
        )
    sources = {source.resolve() for source, _ in found}
    if own := [path for path in paths if path.resolve() in sources]:
        raise UserError([f"{path}: is also a source, and would be overwritten; name another folder" for path in own])
    return paths
