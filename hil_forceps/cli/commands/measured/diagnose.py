"""`hil-forceps diagnose`: differences between simulation and measured runs, their causes, and an extended rig."""

import json
import sys
import time
from concurrent.futures import Future
from contextlib import nullcontext
from importlib import import_module
from pathlib import Path
from typing import Annotated, Final

from cyclopts import Parameter

from hil_forceps.api.batch.executor import PROCESSES
from hil_forceps.api.diagnosis import DiagnosisResult, Wishes, conclude
from hil_forceps.api.runs import read_runs
from hil_forceps.cli.arguments.files import make_folder
from hil_forceps.cli.arguments.options import spoken_as_options
from hil_forceps.cli.arguments.trajectory_file import write_trajectory
from hil_forceps.cli.commands.measured.diagnose_batch import diagnose_batch
from hil_forceps.cli.kernels import telling_when_compiling
from hil_forceps.cli.memory import keep_pages
from hil_forceps.cli.terminal.notes import note_console
from hil_forceps.cli.terminal.progress import progress_on
from hil_forceps.control.trajectories import Trajectory
from hil_forceps.diagnosis.result import Diagnosis
from hil_forceps.report.diagnosis.files import begun, draughtsman, write_figures, write_report
from hil_forceps.rig import load_rig
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.loading import dump_rig

TRAJECTORY_FILE = "next_experiment.csv"
_OPTIONS: Final = {name: name for name in ("hold_out", "without", "seed", "jobs")} | {"budget_s": "budget"}


def diagnose(
    runs: Annotated[list[Path], Parameter(consume_multiple=True)],
    /,
    *,
    rig: Path | None = None,
    out: Path,
    jobs: int | None = None,
    seed: int = 0,
    hold_out: Annotated[tuple[str, ...], Parameter(consume_multiple=True)] = (),
    without: Annotated[tuple[str, ...], Parameter(consume_multiple=True)] = (),
    budget: float | None = None,
    figures: bool = False,
    batch: Annotated[bool, Parameter(negative="")] = False,
    executor: str = PROCESSES,
    bus: str | None = None,
    node: int | None = None,
    map_: Annotated[tuple[str, ...], Parameter(name="--map")] = (),
) -> int:
    """Compare the simulation of a rig with measured runs, and find the effects that explain the difference.

    Writes diagnosis.json, report.html (opens offline) and extended.yaml, which is the rig with the effects that were
    found. Runs held out measure the improvement. If another experiment would give more information, its motion is in
    next_experiment.csv, for `hil-forceps run --trajectory`.

    Parameters
    ----------
    runs
        Measured runs: files or folders that `import` reads (docs/measured-data.md).
    rig
        Rig file to simulate with; with --batch, for logs without a rig.yaml of their own.
    out
        Folder for the results.
    jobs
        Number of threads, with --batch of processes; default: all processors.
    seed
        Seed of the bootstraps; the same seed gives the same bytes.
    hold_out
        Names of runs held out from fitting and selection; default: the last third.
    without
        Catalogue entries to exclude.
    budget
        Time limit in s, after which no further step begins. The result is the best so far, and lists what was not
        tested. Only if the control law of the drive is known.
    figures
        Also write the figures as files.
    batch
        Diagnose each file and each folder in the given folder separately. Writes OUT/NAME for each, and
        OUT/verdicts.json. After an interruption the same command continues.
    executor
        With --batch: processes, dask://HOST:PORT, ray or ray://HOST:PORT; the results are the same.
    bus
        Bus to read, if a bus log has drives on several: the interface in candump's format, the channel in others.
    node
        Node to read, if a bus log has several drives.
    map_
        Column of a table for a quantity of a run, with its unit, such as theta_m_rad=pos:deg; or a YAML file of such
        lines (docs/measured-data.md).
    """
    began_s = time.monotonic()
    wishes = Wishes(hold_out, without, seed, jobs, budget)
    if batch:
        if bus is not None or node is not None:
            raise UserError(f"{'--node' if bus is None else '--bus'}: not possible with --batch; import the logs first")
        with spoken_as_options({**_OPTIONS, "executor": "executor", "out": "out"}):
            return diagnose_batch(runs, rig, out, wishes, executor, map_, figures=figures)
    if executor != PROCESSES:
        raise UserError("--executor: only with --batch; add --batch, or leave --executor out")
    if rig is None:
        raise UserError("--rig: missing; name the rig file to simulate with")
    with spoken_as_options(_OPTIONS):
        wishes.check()
    known = load_rig(rig)
    read = read_runs(*runs, rig=known, bus=bus, node=node, columns=map_)
    with spoken_as_options(_OPTIONS):
        wishes.check_names(read)
    make_folder(out)
    console = note_console()
    with (
        draughtsman() if wishes.threads > 1 else nullcontext() as helper,
        progress_on(console) as tell,
        telling_when_compiling(),
        spoken_as_options(_OPTIONS),
    ):
        # Computation and drawing take a second each to load; here they load in parallel.
        import_module("hil_forceps.diagnosis.conclude")
        keep_pages()
        drawing: list[Future[dict[str, str]]] = []

        def to_draw(told: Diagnosis) -> None:
            if helper:
                drawing.append(begun(told, helper))

        result = conclude(read, known, wishes, began_s, tell, to_draw)
        tell("drawing")
        write_report(result.diagnosis, out / "report.html", drawing=drawing[0] if drawing else None)
        if figures:
            make_folder(out / "figures", inside=out)
            write_figures(result.diagnosis, out / "figures")
    (out / "diagnosis.json").write_text(json.dumps(result.to_json(), indent=2, allow_nan=False) + "\n")
    (out / "extended.yaml").write_text(dump_rig(result.extended_rig))
    _leave_trajectory(result.next_trajectory, out / TRAJECTORY_FILE)
    _print(result, out)
    return 0


def _leave_trajectory(trajectory: Trajectory | None, path: Path) -> None:
    """Write the motion of the next experiment, or delete that of an earlier diagnosis."""
    if trajectory is None:
        path.unlink(missing_ok=True)
    else:
        write_trajectory(trajectory, path)


def _print(result: DiagnosisResult, out: Path) -> None:
    lines = [str(result)]
    if result.diagnosis.next_experiment is not None:
        lines.append(f"  motion of this experiment, for `hil-forceps run --trajectory`: {out / TRAJECTORY_FILE}")
    lines.append(f"  report.html, diagnosis.json and extended.yaml are in {out}/")
    sys.stdout.write("\n".join(lines) + "\n")
