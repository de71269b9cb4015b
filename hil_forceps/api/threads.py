"""Work shared out over a pool of threads."""

import itertools
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from typing import Any

from hil_forceps.diagnosis.evidence import Mapper


class _Shared:
    """Tasks that any thread may take the next of, as long as there are any."""

    def __init__(self, work: Callable[[Any], Any], tasks: Iterable[Any]) -> None:
        self._work, self.tasks = work, list(tasks)
        self.results: list[Any] = [None] * len(self.tasks)
        self._places = itertools.count()

    def help(self) -> None:
        """Do what no other has taken."""
        while (place := next(self._places)) < len(self.tasks):
            self.results[place] = self._work(self.tasks[place])


def over_threads(pool: Executor, threads: int) -> Mapper:
    """Return a mapper over a pool of so many threads; what a task maps in turn it shares with those that are idle.

    Of that the task's own thread does whatever no other takes: were all handed to the pool, its threads could come to
    wait for work that only they would do.
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
