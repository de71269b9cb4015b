"""`hil-forceps replay` with runs of an axis: a model fitted to the first run and tested on the others."""

import os
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from rich.progress import Progress

from hil_forceps.api.threads import over_threads
from hil_forceps.cli.arguments.files import make_folder
from hil_forceps.cli.kernels import telling_when_compiling
from hil_forceps.cli.terminal.notes import note_console
from hil_forceps.cli.terminal.tables import print_cells
from hil_forceps.data.readers.tables.mapping import ColumnMap
from hil_forceps.identification.axis.axis import read_axis
from hil_forceps.identification.axis.comparison import compare_axis
from hil_forceps.identification.axis.files import axis_tables, write_axis
from hil_forceps.identification.axis.network_fit import SEEDS, fit_networks
from hil_forceps.report.identification.axis import write_axis_figures
from hil_forceps.rig import load_rig


def replay_axis(
    sources: Sequence[Path],
    rig_path: Path,
    out: Path,
    mapping: ColumnMap,
    *,
    with_networks: bool = False,
    as_json: bool = False,
) -> int:
    """Compare, print the tables, write files and figures; return the exit code."""
    rig = load_rig(rig_path)
    make_folder(out)
    console = note_console()
    with Progress(console=console, disable=not console.is_terminal) as bar, telling_when_compiling():
        task = bar.add_task("replay", total=None)

        def progress(done: int, total: int, what: str) -> None:
            bar.update(task, completed=done, total=total, description=what)

        found = compare_axis(read_axis(sources, rig, mapping), progress)
        if with_networks:
            bar.update(task, description=f"networks, {SEEDS} seeds")
            threads = os.cpu_count() or 1
            with ThreadPoolExecutor(threads) as pool:
                networks = fit_networks(found.train, found.tests, mapper=over_threads(pool, threads))
            found = found._replace(networks=networks)
        written, *_ = write_axis(found, out)
        bar.update(task, description="figures")
        figures = write_axis_figures(found, out)
    if as_json:
        sys.stdout.write(written.read_text(encoding="utf-8"))
        return 0
    for title, cells in axis_tables(found):
        print_cells(cells, title, 2 if "fitted to" in cells.headers else 1)
    sys.stdout.write(f"{len(figures)} figures, axis_comparison.json and axis_comparison.csv are in {out}/\n")
    return 0
