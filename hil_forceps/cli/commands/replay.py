"""`hil-forceps replay`: recordings, and measured runs of real instruments, through the estimators."""

import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.progress import Progress

from hil_forceps.bench.run_folder import RECORDING_NAME
from hil_forceps.cli.commands.replay_axis import replay_axis
from hil_forceps.cli.commands.replay_recording import replay_recording
from hil_forceps.cli.files import make_folder
from hil_forceps.cli.notes import note_console
from hil_forceps.cli.tables import print_cells
from hil_forceps.data.readers.tables.mapping import ColumnMap, read_map
from hil_forceps.data.recording.format import FAULT_NAME
from hil_forceps.identification.instrument.black_boxes import black_boxes as black_boxes_of
from hil_forceps.identification.instrument.comparison_files import comparison_tables, write_comparison
from hil_forceps.identification.instrument.evaluation import compare_instrument, evaluate, read_instrument
from hil_forceps.identification.instrument.report import write_report
from hil_forceps.report.identification.comparison import write_comparison_figures
from hil_forceps.report.identification.instrument import write_instrument_figures
from hil_forceps.rig import load_rig
from hil_forceps.rig.errors import UserError

RECORDING_SUFFIX = ".mcap"
RIG_SUFFIXES = {".yaml", ".yml"}


def replay(
    source: Path,
    *others: Path,
    rig: Path | None = None,
    out: Path | None = None,
    algorithm: str | None = None,
    black_boxes: bool = False,
    map_: Annotated[tuple[str, ...], Parameter(name="--map", negative="")] = (),
    as_json: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Send what was recorded through the estimators again.

    A recording of ours (.mcap): the same samples must give the same references, byte for byte; exit code 1 and the
    first difference when they don't, and where a part of the recording is damaged or missing.

    Runs of a real instrument (folder or zip of the surgical-tool format, or CSV): jaw torque and jaw angle estimated
    from the motor side, against what was measured at the jaw; needs --rig and --out. The estimators of the bench on all
    runs, then a transmission model fitted to some runs and held against others, beside regressions.

    Two sources or more: runs of an axis that one motor moves, without a jaw (EMPS, or CSV with theta_m_rad and
    tau_m_N_m). Terms of its inverse model are chosen and fitted on the first and held against the others; needs --rig
    for the radius, and --out.

    Parameters
    ----------
    source
        Recording, the folder of a `run`, another folder, zip or CSV.
    others
        More runs of an axis, to test on.
    rig
        For runs of an instrument: the rig file to estimate with; what it leaves `unknown` of ratio and offsets is
        fitted, nothing else.
    out
        Folder for tables and figures.
    algorithm
        For a recording: another estimator than the recorded one; then only its estimates are compared.
    black_boxes
        For runs of an instrument: gradient boosting and a network in the comparison too; needs scikit-learn. For runs
        of an axis: a network driven by the force alone, fitted from several seeds; some minutes more.
    map_
        Which column of a table is which of a run, and its unit: theta_m_rad=pos:deg; or a YAML of such lines
        (docs/measured-data.md).
    as_json
        The same as JSON; of runs of an instrument or an axis what is in instrument.json or axis_comparison.json.
    """
    if missing := [path for path in (source, *others) if not path.exists()]:
        raise UserError([f"{path}: no such file or folder" for path in missing])
    if others:
        if rig is None or out is None:
            raise UserError("runs of an axis need --rig RIG.yaml and --out DIR")
        if algorithm is not None:
            raise UserError("several sources are runs of an axis: --algorithm doesn't go with them")
        return replay_axis([source, *others], rig, out, read_map(map_), with_networks=black_boxes, as_json=as_json)
    if (source / RECORDING_NAME).is_file():
        source /= RECORDING_NAME
    if source.suffix.lower() == RECORDING_SUFFIX:
        return replay_recording(source, algorithm, as_json=as_json)
    if source.suffix.lower() in RIG_SUFFIXES:
        raise UserError(f"{source}: is no recording; a rig file goes behind --rig, the recording or run comes first")
    if rig is None or out is None:
        raise UserError(f"{source}: {_no_recording(source)}; runs of an instrument need --rig RIG.yaml and --out DIR")
    return _instrument(source, rig, out, black_boxes, read_map(map_), as_json=as_json)


def _no_recording(source: Path) -> str:
    """Say what a source is that isn't a recording, and what would be one."""
    if source.is_dir():
        return f"holds no {RECORDING_NAME}; name the folder of a run, or its recording"
    if source.name.endswith(FAULT_NAME):
        return f"is the last second of a run, and that is not replayed; name its {RECORDING_NAME}, or see it by explain"
    return f"is no recording, which is named *{RECORDING_SUFFIX}"


def _instrument(
    source: Path, rig_path: Path, out: Path, with_learned: bool, mapping: ColumnMap, *, as_json: bool
) -> int:
    rig = load_rig(rig_path)
    make_folder(out)
    if with_learned:
        black_boxes_of(with_learned=True)  # says at once what isn't installed
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
    print_cells(report.table(), f"{report.name}: estimated from the motor side against measured at the jaw", 3)
    for assumed in report.assumed:
        sys.stdout.write(f"assumed: {assumed}\n")
    for split, cells in comparison_tables(comparison):
        print_cells(cells, f"{report.name}, RMSE on what was held out: {split}", 2)
    if not comparison.splits:
        sys.stdout.write("no comparison on runs held out: it takes runs at two loads or two frequencies\n")
    sys.stdout.write(
        f"{len(figures)} figures, instrument.json, instrument_runs.csv, instrument_comparison.json and "
        f"instrument_comparison.csv are in {out}/\n"
    )
    return 0
