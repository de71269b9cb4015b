"""Work distributed over a pool of threads."""

import itertools
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from typing import Any

from hil_forceps.diagnosis.evidence import Mapper


class _Shared:
    """A queue of tasks for several threads."""

    def __init__(self, work: Callable[[Any], Any], tasks: Iterable[Any]) -> None:
        self._work, self.tasks = work, list(tasks)
        self.results: list[Any] = [None] * len(self.tasks)
        self._places = itertools.count()

    def help(self) -> None:
        """Execute tasks until none is left."""
        while (place := next(self._places)) < len(self.tasks):
            self.results[place] = self._work(self.tasks[place])


def over_threads(pool: Executor, threads: int) -> Mapper:
    """Return a mapper over a pool of `threads` threads; nested maps share their work with idle threads.

    The calling thread executes the tasks that no other takes. If all were handed to the pool, its threads could wait
    for work that only they can do.
    """
    here = threading.local()

    def mapper(work: Callable[[Any], Any], tasks: Iterable[Any]) -> Iterable[Any]:
        shared = _Shared(work, tasks)

        def help_in_pool() -> None:
            here.working = True
            shared.help()

        within = getattr(here, "working", False)
        helpers = [pool.submit(help_in_pool) for _ in range(min(threads, len(shared.tasks)) - within)]
        if not within:
            return _after(helpers, shared)
        try:
            shared.help()
        finally:
            for helper in helpers:
                if not helper.cancel():
                    helper.result()
        return shared.results

    return mapper


def _after(helpers: Iterable[Future[None]], shared: _Shared) -> Iterator[Any]:
    for helper in helpers:
        helper.result()
    yield from shared.results
