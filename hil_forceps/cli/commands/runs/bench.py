"""`hil-forceps bench`: the paper's simulations through the bus, with errors, figures and recordings."""

import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.box import SIMPLE_HEAD
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from hil_forceps.bench.campaign import Done, default_jobs, run_all
from hil_forceps.bench.execute import Executed
from hil_forceps.bench.matrix import PAPER_DURATION_S, RunSpec, run_matrix
from hil_forceps.bench.realtime import RealTime, Wire, run_realtime
from hil_forceps.bench.stopping import StopFlag, stopped_by_signals
from hil_forceps.bench.summary import RunRecord, summary, timing, timing_traces, write_json
from hil_forceps.bridge.live.topics import description_of
from hil_forceps.cli.arguments.files import make_folder, named
from hil_forceps.cli.kernels import ready_kernels
from hil_forceps.cli.terminal.live_page import shown
from hil_forceps.cli.terminal.notes import is_quiet, note_console
from hil_forceps.cli.terminal.tables import print_table
from hil_forceps.live.view import LiveOptions, live_options
from hil_forceps.report.bench.figures import write_bench_figures
from hil_forceps.report.bench.timing import timing_figure
from hil_forceps.report.save import save_figure
from hil_forceps.report.traces import SummaryPoint
from hil_forceps.rig import load_rig
from hil_forceps.rig.errors import UserError

MINIMUM_WIDTH = 100
MAXIMUM_DURATION_S = 86_400.0


def bench(
    *,
    config: Path,
    out: Path,
    seed: int = 0,
    simulation: int | None = None,
    algorithm: str | None = None,
    jobs: Annotated[int | None, Parameter(show_default=False)] = None,
    realtime: bool = False,
    wire: Wire = "pty",
    duration: float | None = None,
    estimator_rig: Path | None = None,
    as_json: Annotated[bool, Parameter(name="--json", negative="")] = False,
    live: bool = False,
    live_bind: str = "",
    foxglove: bool = False,
) -> int:
    """Run a bench file: every simulation and algorithm, with and without compensation, over the bus in virtual time.

    Writes summary.json (the same bytes for the same seed), timing.json, figures (PDF and PNG), and a recording and a
    bus log of every run.

    Parameters
    ----------
    config
        Bench file: a rig file with the section `bench:`, such as configs/paper.yaml.
    out
        Folder for the results; created if it does not exist.
    seed
        Seed of all noise and jitter.
    simulation
        Run only this simulation of the paper, 1 or 2.
    algorithm
        Run only this estimator.
    jobs
        Number of parallel processes; default: all processors.
    realtime
        Run in real time, with the simulated drive in a separate process; compensated runs only.
    wire
        With --realtime: connection between the two processes, pty or udp_multicast.
    duration
        With --realtime: duration of each run in s, 20 or more.
    estimator_rig
        Run each simulation a second time with this rig file for the estimators, for example one without the effects of
        the plant. The plant remains that of the bench file.
    as_json
        Print the content of summary.json instead of the table.
    live
        With --realtime: show the runs on a live page in the browser, only on this machine (docs/live.md).
    live_bind
        With --live: PORT or ADDRESS:PORT of the page; default: a free port on 127.0.0.1.
    foxglove
        With --live: also send the data to Foxglove.
    """
    page = _page(live_options(live=live, control=False, bind=live_bind, foxglove=foxglove), realtime=realtime)
    rig = load_rig(config)
    with named(config):
        rig.require_bench()
    if seed < 0:
        raise UserError(f"--seed {seed}: must not be negative")
    count = default_jobs() if jobs is None else jobs
    if count < 1:
        raise UserError(f"--jobs {count}: must be at least 1")
    believed = None if estimator_rig is None else load_rig(estimator_rig)
    specs = run_matrix(rig, simulation, algorithm, estimator_rig.name if estimator_rig is not None else "")
    if realtime:
        duration_s = _duration(duration)
        specs = [spec._replace(duration_s=duration_s) for spec in specs if spec.on_bus and spec.compensated]
    elif duration is not None:
        raise UserError("--duration: only with --realtime; in virtual time a run lasts 20 s; leave it out")
    make_folder(out)
    ready_kernels(rig, rig.bench.host_period_s)
    began = time.perf_counter()
    flag = StopFlag()

    def work(done: Done) -> list[Executed]:
        if realtime:
            how = RealTime(config, wire, believed, view)
            return run_realtime(specs, rig, seed, out, how, done, flag.is_set)
        return run_all(specs, rig, seed, out, count, done, flag.is_set, believed)

    described = description_of(config.stem, ("",), time.monotonic_ns())
    with stopped_by_signals(flag), shown(described, page) as view:
        executed = _with_progress(specs, work)
    if flag.is_set():
        raise KeyboardInterrupt
    wall_s = time.perf_counter() - began
    _write(executed, seed, wall_s, out)
    if realtime:
        for run in executed:
            timing_of_run = timing_traces(run.record, rig, wire)
            save_figure(timing_figure(timing_of_run), out, f"{run.record.spec.name}_timing")
    _tell([e.record for e in executed], out, as_json=as_json)
    return 0


def _tell(records: Sequence[RunRecord], out: Path, *, as_json: bool) -> None:
    if as_json:
        sys.stdout.write((out / "summary.json").read_text(encoding="utf-8"))
        return
    _print_table(records)
    sys.stdout.write(f"figures, recordings and bus logs are in {out}/\n")


def _page(options: LiveOptions | None, *, realtime: bool) -> LiveOptions | None:
    if options is not None and not realtime:
        raise UserError("--live: only with --realtime; a run in virtual time is too short to be watched")
    return options


def _duration(given: float | None) -> float:
    if given is None:
        return PAPER_DURATION_S
    if not PAPER_DURATION_S <= given <= MAXIMUM_DURATION_S:
        raise UserError(f"--duration {given:g}: must be {PAPER_DURATION_S:g} to {MAXIMUM_DURATION_S:g} s")
    return given


def _with_progress(specs: Sequence[RunSpec], work: Callable[[Done], list[Executed]]) -> list[Executed]:
    """Show a bar on a terminal, elsewhere one line for each run."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    console = note_console()
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        task = progress.add_task("bench", total=len(specs))

        def done(executed: Executed) -> None:
            progress.update(task, advance=1, description=executed.record.spec.name)
            if not console.is_terminal and not is_quiet():
                sys.stderr.write(f"{executed.record.spec.name}: {executed.record.ending}\n")

        return work(done)


def _write(executed: Sequence[Executed], seed: int, wall_s: float, out: Path) -> None:
    records = [e.record for e in executed]
    write_json(out / "summary.json", summary(records, seed))
    write_json(
        out / "timing.json", timing(records, sum(e.traces.time_s[-1] for e in executed if e.traces.time_s.size), wall_s)
    )
    points = [
        SummaryPoint(r.spec.algorithm, r.spec.simulation, r.spec.sample_time_s, r.metrics.tau_w_rmse_N_m)
        for r in records
        if r.spec.compensated and not r.spec.estimator_rig
    ]
    write_bench_figures([e.traces for e in executed if not e.record.spec.estimator_rig], points, out)


def _print_table(records: Sequence[RunRecord]) -> None:
    table = Table(
        title="Errors over 9–20 s; jaw: mean under steady load; ×: speed relative to real time",
        title_justify="left",
        box=SIMPLE_HEAD,
        padding=(0, 1),
    )
    table.add_column("algorithm", no_wrap=True)
    told = sorted({record.spec.estimator_rig for record in records})
    if told != [""]:
        table.add_column("estimator's rig", no_wrap=True)
    for name in ("sim", "comp.", "T\nms", "τ_w RMSE\nmN m", "peak\nmN m", "jaw\ndeg", "x RMSE\nµm", "lost", "×"):
        table.add_column(name, justify="right", no_wrap=True)
    for record in records:
        spec, metrics = record.spec, record.metrics
        table.add_row(
            spec.algorithm,
            *([spec.estimator_rig or "the bench's"] if told != [""] else []),
            str(spec.simulation),
            "yes" if spec.compensated else "no",
            f"{spec.sample_time_s * 1e3:g}",
            _scaled(metrics.tau_w_rmse_N_m, 1e3, ".4f"),
            _scaled(metrics.tau_w_peak_error_N_m, 1e3, ".3f"),
            _scaled(metrics.jaw_error_steady_deg, 1.0, "+.3f"),
            _scaled(metrics.elongation_rmse_m, 1e6, ".3f"),
            str(record.frames_lost),
            f"{record.timing['real_time_factor']:.1f}",
        )
    width = MINIMUM_WIDTH if told == [""] else MINIMUM_WIDTH + len("estimator's rig") + 5
    print_table(table, width)
    not_finite = sorted({record.spec.algorithm for record in records if not record.metrics.finite})
    for algorithm in not_finite:
        sys.stdout.write(f"{algorithm}: – means that the estimate was not finite; see docs/estimators.md\n")


def _scaled(value: float | None, scale: float, form: str) -> str:
    return "–" if value is None else format(value * scale, form)
