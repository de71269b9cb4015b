"""`hil-forceps bench`: the paper's simulations through the bus, judged, drawn and recorded."""

import sys
import time
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from hil_forceps.bench.campaign import default_jobs, run_all
from hil_forceps.bench.execute import DURATION_NS, Executed
from hil_forceps.bench.matrix import RunSpec, run_matrix
from hil_forceps.bench.realtime import Wire, run_realtime
from hil_forceps.bench.summary import RunRecord, summary, timing, write_json
from hil_forceps.cli.files import make_folder
from hil_forceps.cli.kernels import ready_kernels
from hil_forceps.report.bench import write_bench_figures
from hil_forceps.report.traces import SummaryPoint
from hil_forceps.rig import Rig, load_rig
from hil_forceps.rig.errors import UserError

# Figures need no more than this; a run at 10 kHz holds ten times as many samples.
EXIT_NOT_FINITE_IS_FINE = 0


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
) -> int:
    """Run a bench file: every simulation and algorithm, compensated and not, over the bus in virtual time.

    Writes summary.json (the same bytes for the same seed), timing.json, figures (PDF and PNG), and a recording and a
    bus log of every run.

    Parameters
    ----------
    config
        Bench file: a rig file with the section `bench:`, such as configs/paper.yaml.
    out
        Folder for the results; made if it isn't there.
    seed
        Seed of all noise and jitter.
    simulation
        Only this simulation of the paper, 1 or 2.
    algorithm
        Only this estimator.
    jobs
        Processes at a time; as many as there are processors if not given.
    realtime
        Against the simulated drive in a process of its own, by the wall clock: each run takes its 20 s.
    wire
        With --realtime: what the two processes talk over, pty or udp_multicast.
    """
    rig = load_rig(config)
    specs = run_matrix(rig, simulation, algorithm)
    make_folder(out)
    ready_kernels(rig)
    console = Console()
    began = time.perf_counter()
    if realtime:
        specs = [spec for spec in specs if spec.on_bus]
        executed = _with_progress(specs, lambda done: run_realtime(specs, config, rig, seed, out, wire, done))
    else:
        count = default_jobs() if jobs is None else jobs
        if count < 1:
            raise UserError(f"--jobs {count}: must be at least 1")
        executed = _with_progress(specs, lambda done: run_all(specs, rig, seed, out, count, done))
    wall_s = time.perf_counter() - began
    _write(executed, seed, wall_s, out, rig)
    _print_table(console, [e.record for e in executed], out)
    return EXIT_NOT_FINITE_IS_FINE
