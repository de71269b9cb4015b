"""`hil-forceps simulate`: the rig's simulation of a measured run, compared with it."""

import csv
import re
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.box import SIMPLE_HEAD
from rich.progress import Progress
from rich.table import Table

from hil_forceps.api.simulation import Simulation
from hil_forceps.api.simulation import simulate as simulate_run
from hil_forceps.cli.arguments.files import file_name, make_folder
from hil_forceps.cli.arguments.reading import bar, read_sources
from hil_forceps.cli.kernels import telling_when_compiling
from hil_forceps.cli.terminal.tables import FILE_COLUMNS, print_table
from hil_forceps.data.readers.format import Choice
from hil_forceps.data.readers.tables.mapping import read_map
from hil_forceps.report.overlay import SHOWN, beside_figure
from hil_forceps.report.save import save_figure
from hil_forceps.rig import load_rig
from hil_forceps.rig.errors import UserError


def simulate(
    rig: Path,
    *,
    like: Path,
    out: Path | None = None,
    bus: str | None = None,
    node: int | None = None,
    map_: Annotated[tuple[str, ...], Parameter(name="--map")] = (),
) -> int:
    """Simulate a measured run with its reference and load and the values of the rig file; print the errors.

    The simulation is in closed loop if the rig has the section `drive:` and the run has a reference. Otherwise the
    measured motion is its input, and the predicted current, motor torque, jaw angle or load is compared.

    Parameters
    ----------
    rig
        Rig file.
    like
        Run to simulate: a file or folder that `import` reads.
    out
        Folder for a CSV file and a figure of each run.
    bus
        Bus to read, if a bus log has drives on several: the interface in candump's format, the channel in others.
    node
        Node to read, if a bus log has several drives.
    map_
        Column of a table for a quantity of a run, with its unit, such as theta_m_rad=pos:deg; or a YAML file of such
        lines (docs/measured-data.md).
    """
    known = load_rig(rig)
    if out is not None:
        make_folder(out)
    with telling_when_compiling(), bar() as progress:
        runs = [run for _, run in read_sources([like], progress, None, Choice(bus, node), read_map(map_))]
        task = progress.add_task("simulating", total=len(runs))
        results = []
        for run in runs:
            result = simulate_run(known, run)
            if not result.measured:
                raise UserError(
                    f"run {run.name}: no simulated channel was measured; add a column of it (docs/measured-data.md)"
                )
            results.append(result)
            progress.advance(task)
        if out is not None:
            _write(results, out, progress)
    _print(results)
    if out is not None:
        sys.stdout.write(f"a CSV file and a figure of each run are in {out}/\n")
    return 0


def _write(results: list[Simulation], out: Path, progress: Progress) -> None:
    task = progress.add_task("writing", total=len(results))
    for result in results:
        name = file_name(re.sub(r"[^\w.-]", "_", result.name))
        columns = {"time_s": result["time_s"]}
        for channel in result.measured:
            columns[channel] = result.measured[channel]
            columns[f"simulated_{channel}"] = result[channel]
        with (out / f"{name}.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(columns)
            writer.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))
        save_figure(beside_figure(result["time_s"], result.measured, result.columns), out, name)
        progress.advance(task)


def _print(results: list[Simulation]) -> None:
    table = Table(title="Simulated less measured", title_justify="left", box=SIMPLE_HEAD)
    table.add_column("run")
    table.add_column("channel")
    for header in ("RMSE", "without its mean", "of the channel's spread", "unit"):
        table.add_column(header, justify="left" if header == "unit" else "right")
    for result in results:
        for channel, measured in result.measured.items():
            shown = SHOWN[channel]
            spread = float(measured.std())
            share = f"{100 * result.scatter(channel) / spread:.3g} %" if spread > 0.0 else "-"
            errors = [f"{shown.error_scale * error:.4g}" for error in (result.rmse(channel), result.scatter(channel))]
            table.add_row(result.name, channel, *errors, share, shown.error_unit)
    print_table(table, FILE_COLUMNS)
    loops = {"in closed loop" if result.is_closed_loop else "with the measured motion as input" for result in results}
    sys.stdout.write(f"simulated: {', '.join(sorted(loops))}\n")
    for result in results:
        for note in result.notes:
            sys.stdout.write(f"{result.name}: {note}\n")
