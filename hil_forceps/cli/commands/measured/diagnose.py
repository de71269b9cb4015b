"""`hil-forceps diagnose`: what the simulation gets wrong about measured runs, why, and what mending it gains."""

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
    """Show what a rig's simulation gets wrong about measured runs, name the cause, extend the rig, measure the gain.

    Writes diagnosis.json, report.html (opens offline), extended.yaml and, where another experiment would tell more, its
    motion for `hil-forceps run --trajectory`: next_experiment.csv.

    Parameters
    ----------
    runs
        Measured runs: any file or folder that `import` reads (docs/measured-data.md).
    rig
        The rig file to simulate with; with --batch, of what has no rig.yaml of its own.
    out
        Folder for the results.
    jobs
        Threads, with --batch processes; all processors by default.
    seed
        Of bootstraps; the same seed gives the same bytes.
    hold_out
        Names of runs that are neither fitted nor chosen by; the last third by default.
    without
        Entries of the catalogue to leave out.
    budget
        Seconds after which nothing new is begun: the best answer so far, and what was not looked at. Only for runs of a
        drive whose law is known.
    figures
        Write the figures as files, too.
    batch
        Diagnose each file and each folder in the one folder named, by itself: OUT/NAME of each, and OUT/verdicts.json.
        Ended in between and started again it goes on.
    executor
        With --batch: processes, dask://HOST:PORT, ray, ray://HOST:PORT; the results are the same.
    bus
        Of bus logs with drives on several buses, the one to read: candump's interface, the channel of the others.
    node
        Of bus logs with several drives, the one to read.
    map_
        Which column of a table is which of a run, and its unit: theta_m_rad=pos:deg; or a YAML of such lines
        (docs/measured-data.md).
    """
    began_s = time.monotonic()
    wishes = Wishes(hold_out, without, seed, jobs, budget)
    if batch:
        if bus is not None or node is not None:
            raise UserError(f"{'--node' if bus is None else '--bus'}: does not go with --batch; import such logs first")
        with spoken_as_options({**_OPTIONS, "executor": "executor", "out": "out"}):
            return diagnose_batch(runs, rig, out, wishes, executor, map_, figures=figures)
    if executor != PROCESSES:
        raise UserError("--executor: goes with --batch")
    if rig is None:
        raise UserError("--rig: is missing; name the rig file to simulate with")
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
        spoken_as_options(_OPTIONS),
    ):
        # What computes and what draws take a second each to load: here, beside each other.
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
    """Write the motion of the next experiment, or take away that of an earlier diagnosis."""
    if trajectory is None:
        path.unlink(missing_ok=True)
    else:
        write_trajectory(trajectory, path)


def _print(result: DiagnosisResult, out: Path) -> None:
    lines = [str(result)]
    if result.diagnosis.next_experiment is not None:
        lines.append(f"  its motion, for `hil-forceps run --trajectory`: {out / TRAJECTORY_FILE}")
    lines.append(f"  report.html, diagnosis.json and extended.yaml are in {out}/")
    sys.stdout.write("\n".join(lines) + "\n")
