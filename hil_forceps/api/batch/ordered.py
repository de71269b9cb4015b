"""A few longer tasks over processes of this computer, with results in order."""

import os
from collections.abc import Callable
from typing import Any


def over_processes(work: Callable[[Any], Any], tasks: list[Any], jobs: int | None) -> list[Any]:
    """Return the results of tasks in their order; a single task runs in this process."""
    count = min(jobs or os.cpu_count() or 1, len(tasks))
    if count <= 1:
        return [work(task) for task in tasks]
    import joblib  # noqa: PLC0415 - only for several

    with joblib.parallel_config("loky", inner_max_num_threads=1):
        found: list[Any] = joblib.Parallel(n_jobs=count, batch_size=1)(joblib.delayed(work)(task) for task in tasks)
    return found
