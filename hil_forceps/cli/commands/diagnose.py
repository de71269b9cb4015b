"""`hil-forceps diagnose`: what the simulation gets wrong about measured runs, why, and what mending it gains."""

import json
import os
import sys
import time
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console

from hil_forceps.cli.files import make_folder
from hil_forceps.cli.memory import keep_pages
from hil_forceps.cli.progress import progress_on
from hil_forceps.cli.threads import over_threads
from hil_forceps.cli.trajectory_file import write_trajectory
from hil_forceps.control.trajectories import Trajectory
from hil_forceps.data.readers.format import Choice
from hil_forceps.data.readers.read_run import read_run
from hil_forceps.data.run import Run
from hil_forceps.diagnosis.result import Diagnosis, Rung, to_json
from hil_forceps.report.diagnosis.files import begun, draughtsman, write_figures, write_report
from hil_forceps.rig import Rig, load_rig
from hil_forceps.rig.catalogue import EFFECT_IDS
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.loading import dump_rig

TRAJECTORY_FILE = "next_experiment.csv"


def diagnose(
    runs: Annotated[list[Path], Parameter(consume_multiple=True)],
    /,
    *,
    rig: Path,
    out: Path,
    jobs: int | None = None,
    seed: int = 0,
    hold_out: Annotated[tuple[str, ...], Parameter(consume_multiple=True)] = (),
    without: Annotated[tuple[str, ...], Parameter(consume_multiple=True)] = (),
    budget: float | None = None,
    figures: bool = False,
    bus: str | None = None,
    node: int | None = None,
) -> int:
    """Show what a rig's simulation gets wrong about measured runs, name the cause, extend the rig, measure the gain.

    Writes diagnosis.json, report.html (opens offline), extended.yaml and, where another experiment would tell more, its
    motion for `hil-forceps run --trajectory`: next_experiment.csv.

    Parameters
    ----------
    runs
        Measured runs: CSV, Parquet, recordings (.mcap), bus logs, surgical-tool text or zip, EPOS Studio, EMPS .mat.
    rig
        The rig file to simulate with.
    out
        Folder for the results.
    jobs
        Threads; all processors by default.
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
    bus
        Of bus logs with drives on several buses, the one to read: candump's interface, the channel of the others.
    node
        Of bus logs with several drives, the one to read.
    """
    deadline = None if budget is None else time.monotonic() + budget
    if unknown := [name for name in without if name not in EFFECT_IDS]:
        raise UserError(f"--without {unknown[0]}: is no effect of the catalogue; see docs/diagnosis.md")
    if jobs is not None and jobs < 1:
        raise UserError(f"--jobs {jobs}: must be 1 or more")
    if seed < 0:
        raise UserError(f"--seed {seed}: must be 0 or more")
    if budget is not None and not budget > 0.0:
        raise UserError(f"--budget {budget}: must be more than 0 seconds")
    known = load_rig(rig)
    read = _read(runs, known, Choice(bus, node))
    make_folder(out)
    console = Console(stderr=True)
    threads = jobs or os.cpu_count() or 1
    with (
        ThreadPoolExecutor(threads) as pool,
        draughtsman() if threads > 1 else nullcontext() as helper,
        progress_on(console) as tell,
    ):
        # What computes and what draws take a second each to load: here, beside each other.
        from hil_forceps.diagnosis.conclude import diagnose as diagnose_runs  # noqa: PLC0415
        from hil_forceps.diagnosis.options import Options  # noqa: PLC0415
        from hil_forceps.diagnosis.validation.conclusion import even_runs  # noqa: PLC0415

        keep_pages()
        drawing: list[Future[dict[str, str]]] = []

        def to_draw(told: Diagnosis) -> None:
            if helper:
                drawing.append(begun(told, helper))

        def spent() -> bool:
            return deadline is not None and time.monotonic() > deadline

        if budget is not None and even_runs(read, known) is None:
            raise UserError(
                "--budget: needs runs of a drive whose law and references are known; leave it out for these"
            )
        options = Options(
            frozenset(without),
            tuple(hold_out),
            seed,
            over_threads(pool, threads),
            tell,
            to_draw,
            spent,
        )
        diagnosis, extended, trajectory = diagnose_runs(read, known, options)
        tell("drawing")
        write_report(diagnosis, out / "report.html", drawing=drawing[0] if drawing else None)
        if figures:
            make_folder(out / "figures", inside=out)
            write_figures(diagnosis, out / "figures")
    (out / "diagnosis.json").write_text(json.dumps(to_json(diagnosis), indent=2, allow_nan=False) + "\n")
    (out / "extended.yaml").write_text(dump_rig(extended))
    _leave_trajectory(trajectory, out / TRAJECTORY_FILE)
    _print(diagnosis, out)
    return 0


def _leave_trajectory(trajectory: Trajectory | None, path: Path) -> None:
    """Write the motion of the next experiment, or take away that of an earlier diagnosis."""
    if trajectory is None:
        path.unlink(missing_ok=True)
    else:
        write_trajectory(trajectory, path)


def _read(paths: Sequence[Path], rig: Rig, choice: Choice) -> list[Run]:
    read = [run for path in paths for run in read_run(path, rig=rig, choice=choice)]
    if not read:
        raise UserError("no runs were given")
    names = [run.name for run in read]
    doubled = {name for name in names if names.count(name) > 1}
    counters: dict[str, int] = {}
    result = []
    for run in read:
        if run.name in doubled:
            counters[run.name] = counters.get(run.name, 0) + 1
            result.append(Run(f"{run.name}#{counters[run.name]}", run.columns, run.notes))
        else:
            result.append(run)
    return result


def _gain_of(rung: Rung, channel: str) -> str:
    return f" (gains {100 * rung.gain[channel]:.0f} %)" if channel in rung.gain else ""


def _print(diagnosis: Diagnosis, out: Path) -> None:
    lines = [f"{diagnosis.verdict}: {diagnosis.sentence}"]
    for effect in diagnosis.effects:
        values = ", ".join(
            f"{name} = {p.value:.4g} {p.unit} [{p.low:.4g}, {p.high:.4g}]".replace("  ", " ")
            for name, p in effect.parameters.items()
        )
        lines.append(f"  {effect.id} ({effect.location}), confidence {effect.confidence:.2f}: {values}")
    if len(diagnosis.candidate_sets) > 1:
        lines.append("  as good: " + "; ".join(" + ".join(ids) for ids in diagnosis.candidate_sets[1:]))
    for name, shift in diagnosis.parameter_shifts.items():
        fitted = shift.fitted
        assumed = "unknown" if shift.assumed is None else f"{shift.assumed:.4g}"
        lines.append(f"  {name}: {assumed} -> {fitted.value:.4g} [{fitted.low:.4g}, {fitted.high:.4g}] {fitted.unit}")
    for name, gain in diagnosis.gain.items():
        lines.append(
            f"  held out, {name}: RMSE {gain.baseline_rmse:.4g} -> {gain.extended_rmse:.4g} "
            f"(noise {gain.floor_rmse:.4g}), explained {100 * gain.explained_share:.0f} % "
            f"[{100 * gain.low:.0f}, {100 * gain.high:.0f}]"
        )
    lines += [
        f"  ladder, {rung.id or 'known parameters'}: "
        + ", ".join(f"{n} {e:.4g}" + _gain_of(rung, n) for n, e in rung.rmse.items())
        + "".join(
            f"; {n} = {p.value:.4g} [{p.low:.4g}, {p.high:.4g}] {p.unit}".rstrip() for n, p in rung.parameters.items()
        )
        for rung in diagnosis.ladder
    ]
    problems = [f for f in diagnosis.data_audit if f.severity != "note"]
    lines += [f"  data, {f.run or 'all runs'}: {f.text}" for f in problems]
    lines += [f"  because {reason}" for reason in diagnosis.reasons]
    if diagnosis.varies_over:
        lines.append(f"  what stays unexplained varies over {', '.join(diagnosis.varies_over)}")
    if diagnosis.next_experiment is not None:
        following = diagnosis.next_experiment
        lines.append(f"  next: {following.name} (separation {following.predicted_separation:.1f} sd); {following.why}")
        lines.append(f"  its motion, for `hil-forceps run --trajectory`: {out / TRAJECTORY_FILE}")
    lines.append(f"  report.html, diagnosis.json and extended.yaml are in {out}/")
    sys.stdout.write("\n".join(lines) + "\n")
