"""All runs of a bench, in processes of their own, in an order that does not depend on which ends first."""

import multiprocessing
import os
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from pathlib import Path

from hil_forceps.bench.execute import Executed, execute
from hil_forceps.bench.matrix import RunSpec
from hil_forceps.rig import Rig

Done = Callable[[Executed], None]


def default_jobs() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0))


def run_all(specs: Sequence[RunSpec], rig: Rig, seed: int, out: Path, jobs: int, done: Done) -> list[Executed]:
    """Execute every spec and return them in the order of `specs`; `done` is called as each ends.

    The first run that raises ends the campaign with its exception; runs not yet begun are dropped.
    """
    if jobs == 1 or len(specs) == 1:
        return [_told(execute(spec, rig, seed, out), done) for spec in specs]
    results: dict[RunSpec, Executed] = {}
    # Spawned, not forked: a fork would inherit threads of the libraries in an unknown state.
    with ProcessPoolExecutor(min(jobs, len(specs)), multiprocessing.get_context("spawn")) as pool:
        # Long runs first, or the last one keeps a single processor busy while the others idle.
        order = sorted(specs, key=lambda spec: spec.sample_time_s)
        pending: dict[Future[Executed], RunSpec] = {pool.submit(execute, s, rig, seed, out): s for s in order}
        try:
            while pending:
                for future in wait(pending, return_when=FIRST_COMPLETED).done:
                    results[pending.pop(future)] = _told(future.result(), done)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return [results[spec] for spec in specs]


def _told(executed: Executed, done: Done) -> Executed:
    done(executed)
    return executed
