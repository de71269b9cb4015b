"""Work shared out over a pool of threads."""

import threading
from collections.abc import Callable, Iterable
from concurrent.futures import Executor
from typing import Any

from hil_forceps.diagnosis.mapper import Mapper


def over_threads(pool: Executor) -> Mapper:
    """Return a mapper over a pool of threads; what a task maps in turn is done within it.

    Were it handed to the pool, all threads could come to wait for work that only they would do.
    """
    here = threading.local()

    def mapper(work: Callable[[Any], Any], tasks: Iterable[Any]) -> Iterable[Any]:
        def within(task: Any) -> Any:
            here.working = True
            try:
                return work(task)
            finally:
                here.working = False

        return map(work, tasks) if getattr(here, "working", False) else pool.map(within, tasks)

    return mapper
