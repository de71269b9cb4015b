"""All runs of a bench, in parallel processes, with results in the order of the runs."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from pathlib import Path

from hil_forceps.bench.execute import Executed, execute, never
from hil_forceps.bench.matrix import RunSpec
from hil_forceps.bench.stopping import StopFlag
from hil_forceps.rig import Rig

STOP_POLL_S = 0.2

Done = Callable[[Executed], None]


def default_jobs() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0))


def run_all(
    specs: Sequence[RunSpec],
    rig: Rig,
    seed: int,
    out: Path,
    jobs: int,
    done: Done,
    stop_requested: Callable[[], bool] = never,
    estimator_rig: Rig | None = None,
) -> list[Executed]:
    """Execute all specs and return the results in the order of `specs`; `done` is called at the end of each.

    The first run that raises ends the campaign with its exception; runs not yet begun are dropped. On `stop_requested`
    the current runs are stopped, and the finished results are returned. `estimator_rig`: of the specs that name one.
    """
    if jobs == 1 or len(specs) == 1:
        results = []
        for spec in specs:
            if not stop_requested():
                results.append(execute(spec, rig, seed, out, stop_requested, estimator_rig))
                done(results[-1])
        return results
    with _worker_pool(min(jobs, len(specs))) as pool:
        # Long runs first; otherwise the last one occupies one processor while the others are idle.
        order = sorted(specs, key=lambda spec: spec.sample_time_s)
        futures = {pool.submit(_execute_in_worker, spec, rig, seed, out, estimator_rig): spec for spec in order}
        by_spec = _collect(futures, done, stop_requested)
    return [by_spec[spec] for spec in specs if spec in by_spec]


def _collect(
    futures: Mapping[Future[Executed], RunSpec], done: Done, stop_requested: Callable[[], bool]
) -> dict[RunSpec, Executed]:
    results: dict[RunSpec, Executed] = {}
    pending = set(futures)
    try:
        while pending and not stop_requested():
            finished, pending = wait(pending, timeout=STOP_POLL_S, return_when=FIRST_COMPLETED)
            for future in finished:
                results[futures[future]] = future.result()
                done(results[futures[future]])
    finally:
        if pending:
            for future in pending:
                future.cancel()
            for worker in multiprocessing.active_children():
                worker.terminate()
    return results


def _worker_pool(jobs: int) -> ProcessPoolExecutor:
    # Spawned, not forked: a fork would inherit locks of the libraries' threads in an unknown state.
    return ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), _listen_to_parent)


_worker_stop = StopFlag()


def _listen_to_parent() -> None:
    """In a worker: ignore Ctrl-C, which reaches the whole process group; the parent sends SIGTERM instead."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda _number, _frame: _worker_stop.set())


def _execute_in_worker(spec: RunSpec, rig: Rig, seed: int, out: Path, estimator_rig: Rig | None) -> Executed:
    return execute(spec, rig, seed, out, _worker_stop.is_set, estimator_rig)
