"""Executors for the work of many sessions: processes of this computer or a cluster, through joblib."""

import importlib
import importlib.util
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

from hil_forceps.rig.errors import UserError

PROCESSES = "processes"
TASKS_PER_WORKER = 8  # at a time, where a backend can't give results as they come

Task = TypeVar("Task")
Result = TypeVar("Result")


def check_executor(executor: str) -> None:
    """UserError for an unknown executor, or if its package is not installed."""
    name = executor.partition("://")[0]
    known = executor in {PROCESSES, "ray"} or (name in {"dask", "ray"} and executor.partition("://")[2])
    if not known:
        raise UserError(f"executor {executor}: is unknown; use processes, dask://HOST:PORT, ray or ray://HOST:PORT")
    needed = {"dask": ("dask", "distributed"), "ray": ("ray",)}.get(name, ())
    for module in needed:
        if importlib.util.find_spec(module) is None:
            raise UserError(f"executor {executor}: {module} is not installed; pip install 'hil-forceps[{name}]'")


def spread(work: Callable[[Task], Result], tasks: Sequence[Task], executor: str, jobs: int | None) -> Iterator[Result]:
    """Yield the results of tasks in the order in which they end; `jobs`: processes, by default all processors.

    `work` is a function of a module, tasks are plain data: both are sent to other processes. UserError if a cluster
    can't be reached or a process is lost.
    """
    check_executor(executor)
    count = min(jobs or os.cpu_count() or 1, len(tasks))
    if executor == PROCESSES and count <= 1:
        yield from map(work, tasks)
        return
    import joblib  # noqa: PLC0415 - only for several

    with _backend(executor, joblib) as own_count:
        workers = own_count if jobs is None and own_count else count
        backend, _ = joblib.parallel.get_active_backend()
        try:
            if backend.supports_return_generator:
                pool = joblib.Parallel(n_jobs=workers, return_as="generator_unordered", batch_size=1)
                yield from pool(joblib.delayed(work)(task) for task in tasks)
                return
            for first in range(0, len(tasks), TASKS_PER_WORKER * max(workers, 1)):
                pool = joblib.Parallel(n_jobs=workers, batch_size=1)
                yield from pool(
                    joblib.delayed(work)(task) for task in tasks[first : first + TASKS_PER_WORKER * max(workers, 1)]
                )
        except joblib.externals.loky.process_executor.TerminatedWorkerError as error:
            raise UserError(
                "a process that fitted a log was killed, possibly for lack of memory; run the command again with "
                "fewer --jobs; finished logs are kept"
            ) from error


@contextmanager
def _backend(executor: str, joblib: Any) -> Iterator[int]:
    """Select joblib's backend for an executor; yield its number of workers, 0 if unknown."""
    name, _, address = executor.partition("://")
    if name == "dask":
        with _dask(executor, address) as workers, joblib.parallel_config("dask"):
            yield workers
    elif name == "ray":
        with _ray(executor), joblib.parallel_config("ray"):
            yield 0
    else:
        with joblib.parallel_config("loky", inner_max_num_threads=1):
            yield 0


@contextmanager
def _dask(executor: str, address: str) -> Iterator[int]:
    distributed = importlib.import_module("distributed")
    try:
        client = distributed.Client(f"tcp://{address}", timeout="10s")
    except (OSError, ValueError) as error:
        raise UserError(
            f"executor {executor}: no scheduler answers at this address; start one with `dask scheduler`"
        ) from error
    with client:
        workers = sum(int(each["nthreads"]) for each in client.scheduler_info(n_workers=-1)["workers"].values())
        if workers < 1:
            raise UserError(
                f"executor {executor}: the scheduler has no workers; start some with `dask worker {address}`"
            )
        yield workers


@contextmanager
def _ray(executor: str) -> Iterator[None]:
    ray, register = importlib.import_module("ray"), importlib.import_module("ray.util.joblib").register_ray
    own = not ray.is_initialized()
    try:
        if own:
            address = executor if executor.startswith("ray://") else None
            ray.init(address=address, log_to_driver=False, include_dashboard=False, logging_level="ERROR")
    except (ConnectionError, OSError, RuntimeError, ValueError) as error:
        raise UserError(f"executor {executor}: no Ray cluster answers at this address; see `ray status`") from error
    register()
    try:
        yield
    finally:
        if own:
            ray.shutdown()
