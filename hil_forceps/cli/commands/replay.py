"""`hil-forceps replay`: recordings, and measured runs of real instruments, through the estimators."""

import sys
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter
from rich.progress import Progress

from hil_forceps.bench.assembly import make_pipeline, settings_of
from hil_forceps.bench.run_folder import RECORDING_NAME
from hil_forceps.bridge.pipeline import VERDICT_NAMES
from hil_forceps.bridge.replay import RecordedReference
from hil_forceps.bridge.replay import replay as replay_recording
from hil_forceps.cli.commands.replay_axis import replay_axis
from hil_forceps.cli.files import make_folder
from hil_forceps.cli.kernels import ready_kernels
from hil_forceps.cli.notes import note, note_console
from hil_forceps.cli.tables import print_cells
from hil_forceps.data.readers.tables.mapping import ColumnMap, read_map
from hil_forceps.data.recording.reader import Recording, read_recording
from hil_forceps.data.recording.writer import Outcome
from hil_forceps.identification.instrument.black_boxes import black_boxes as black_boxes_of
from hil_forceps.identification.instrument.comparison_files import comparison_tables, write_comparison
from hil_forceps.identification.instrument.evaluation import compare_instrument, evaluate, read_instrument
from hil_forceps.identification.instrument.report import write_report
from hil_forceps.report.identification.comparison import write_comparison_figures
from hil_forceps.report.identification.instrument import write_instrument_figures
from hil_forceps.rig import load_rig
from hil_forceps.rig.errors import UserError

EXIT_DIFFERENT = 1
RECORDING_SUFFIX = ".mcap"
RIG_SUFFIXES = {".yaml", ".yml"}
_NOT_SENT = {
    Outcome.QUEUE_FULL: "found the bus full",
    Outcome.BUS_DOWN: "found no bus",
    Outcome.NOT_ALLOWED: "came before the drive took references",
}


def replay(
    source: Path,
    *others: Path,
    rig: Path | None = None,
    out: Path | None = None,
    algorithm: str | None = None,
    black_boxes: bool = False,
    map_: Annotated[tuple[str, ...], Parameter(name="--map")] = (),
) -> int:
    """Send what was recorded through the estimators again.

    A recording of ours (.mcap): the same samples must give the same references, byte for byte; exit code 1 and the
    first difference when they don't. Runs of a real instrument (folder or zip of the surgical-tool format, or CSV):
    jaw torque and jaw angle estimated from the motor side, against what was measured at the jaw; needs --rig and
    --out. The estimators of the bench on all runs, then a transmission model fitted to some runs and held against
    others, beside regressions.

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
    """
    if missing := [path for path in (source, *others) if not path.exists()]:
        raise UserError([f"{path}: no such file or folder" for path in missing])
    if others:
        if rig is None or out is None:
            raise UserError("runs of an axis need --rig RIG.yaml and --out DIR")
        if algorithm is not None:
            raise UserError("several sources are runs of an axis: --algorithm doesn't go with them")
        return replay_axis([source, *others], rig, out, read_map(map_), with_networks=black_boxes)
    if (source / RECORDING_NAME).is_file():
        source /= RECORDING_NAME
    if source.suffix.lower() == RECORDING_SUFFIX:
        return _recording(source, algorithm)
    if source.suffix.lower() in RIG_SUFFIXES:
        raise UserError(f"{source}: is no recording; a rig file goes behind --rig, the recording or run comes first")
    if rig is None or out is None:
        raise UserError(f"{source}: runs of an instrument need --rig RIG.yaml and --out DIR")
    return _instrument(source, rig, out, black_boxes, read_map(map_))


def _recording(path: Path, algorithm: str | None) -> int:
    recording = read_recording(path)
    for each in recording.notes:
        note(f"{path}: {each}")
    rig, settings = settings_of(recording)
    is_same = algorithm is None or algorithm == settings.algorithm
    if algorithm is not None:
        settings = settings._replace(algorithm=algorithm)
    ready_kernels(rig, settings.sample_time_s)
    outside = RecordedReference() if settings.trajectory is None else None
    result = replay_recording(recording, make_pipeline(rig, settings, outside), outside)
    count = len(recording.references)
    if not len(recording.samples):
        raise UserError(f"{path}: holds no samples; the drive never answered, or the recording was cut off at once")
    if not is_same:
        difference = result.samples["tau_w_estimate_N_m"] - recording.samples["tau_w_estimate_N_m"]
        rms = float(np.sqrt(np.nanmean(np.square(difference)))) if difference.size else 0.0
        sys.stdout.write(
            f"{path}: {len(recording.samples)} samples through {settings.algorithm}; "
            f"its τ_w differs from the recorded one by {rms * 1e3:.4f} mN m RMS\n"
        )
        return 0
    if result.first_difference is None:
        sys.stdout.write(f"{path}: {count} references from {len(recording.samples)} samples, all identical")
        sys.stdout.write(f"; {_sent_or_not(recording)}\n")
        return 0
    sys.stdout.write(f"{path}: differs: {result.first_difference}\n")
    return EXIT_DIFFERENT


def _sent_or_not(recording: Recording) -> str:
    """Say how many of the ticks' references left, which is what `run` counts, and why the others did not."""
    references = recording.references
    told = [f"{np.count_nonzero(references['outcome'] == Outcome.SENT)} of them were sent"]
    for outcome in Outcome:
        count = np.count_nonzero(references["outcome"] == outcome)
        if count and outcome not in {Outcome.SENT, Outcome.NONE}:
            told.append(f"{count} {_NOT_SENT[outcome]}")
    unsent = references["verdict"][references["outcome"] == Outcome.NONE]
    for verdict, count in zip(*np.unique(unsent, return_counts=True), strict=True):
        told.append(f"{count} {VERDICT_NAMES.get(int(verdict), f'verdict {verdict}').lower().replace('_', ' ')}")
    return ", ".join(told)


def _instrument(source: Path, rig_path: Path, out: Path, with_learned: bool, mapping: ColumnMap) -> int:
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
        write_report(report, out)
        write_comparison(comparison, out)
        bar.update(task, description="figures")
        figures = [*write_instrument_figures(report, out), *write_comparison_figures(comparison, out)]
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
