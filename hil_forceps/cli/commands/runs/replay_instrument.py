"""Estimators on measured runs of an instrument, and models fitted to some of the runs and tested on the others."""

import sys
from pathlib import Path

from rich.progress import Progress

from hil_forceps.cli.arguments.files import make_folder
from hil_forceps.cli.terminal.notes import note_console
from hil_forceps.cli.terminal.tables import print_cells
from hil_forceps.data.readers.tables.mapping import ColumnMap
from hil_forceps.identification.instrument.black_boxes import black_boxes
from hil_forceps.identification.instrument.comparison_files import comparison_tables, write_comparison
from hil_forceps.identification.instrument.evaluation import compare_instrument, evaluate, read_instrument
from hil_forceps.identification.instrument.report import write_report
from hil_forceps.report.identification.comparison import write_comparison_figures
from hil_forceps.report.identification.instrument import write_instrument_figures
from hil_forceps.rig import load_rig


def replay_instrument(
    source: Path, rig_path: Path, out: Path, with_learned: bool, mapping: ColumnMap, *, as_json: bool
) -> int:
    """Write tables and figures to `out`; UserError if the sources or the rig can't be used."""
    rig = load_rig(rig_path)
    make_folder(out)
    if with_learned:
        black_boxes(with_learned=True)  # reports a missing package before the work begins
    console = note_console()
    with Progress(console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task("replay", total=None)

        def progress(done: int, total: int, what: str) -> None:
            bar.update(task, completed=done, total=total or None, description=what)

        runs = read_instrument(source, progress, mapping)
        report = evaluate(source.stem, runs, rig, progress)
        comparison = compare_instrument(runs, rig, with_learned=with_learned, progress=progress)
        written, _ = write_report(report, out)
        write_comparison(comparison, out)
        bar.update(task, description="figures")
        figures = [*write_instrument_figures(report, out), *write_comparison_figures(comparison, out)]
    if as_json:
        sys.stdout.write(written.read_text(encoding="utf-8"))
        return 0
    print_cells(report.table(), f"{report.name}: estimates from the motor side, compared with the measured jaw", 3)
    for assumed in report.assumed:
        sys.stdout.write(f"assumed: {assumed}\n")
    for split, cells in comparison_tables(comparison):
        print_cells(cells, f"{report.name}, RMSE on runs held out: {split}", 2)
    if not comparison.splits:
        sys.stdout.write("no comparison on runs held out: it needs runs with two loads or two frequencies\n")
    sys.stdout.write(
        f"{len(figures)} figures, instrument.json, instrument_runs.csv, instrument_comparison.json and "
        f"instrument_comparison.csv are in {out}/\n"
    )
    return 0
