"""Progress of long work: a spinner on a terminal, else a line at each step and every few seconds."""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

FIRST_LINE_S = 1.0  # a command that is refused sooner prints only its error
LINE_PERIOD_S = 5.0

T = TypeVar("T")


@contextmanager
def progress_on(console: Console, every_s: float = LINE_PERIOD_S) -> Iterator[Callable[[str], None]]:
    """Yield a function that takes the name of each step; the current step is repeated while it lasts."""
    if console.is_terminal:
        with Progress(SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn(), console=console) as bar:
            task = bar.add_task("loading", total=None)
            yield lambda text: bar.update(task, description=text)
        return
    began, done, told = time.monotonic(), threading.Event(), ["loading"]

    def line() -> None:
        console.print(f"{time.monotonic() - began:5.0f} s  {told[0]}", highlight=False, soft_wrap=True)

    def again() -> None:
        wait_s = FIRST_LINE_S
        while not done.wait(wait_s):
            line()
            wait_s = every_s

    def tell(text: str) -> None:
        if text != told[0]:
            told[0] = text
            line()

    teller = threading.Thread(target=again, name="progress", daemon=True)
    teller.start()
    try:
        yield tell
    finally:
        done.set()
        teller.join()


@contextmanager
def last_told(line: Callable[[T], str], every_s: float = LINE_PERIOD_S) -> Iterator[Callable[[T], None]]:
    """Yield a function that takes the newest state; a thread writes it as a line every few seconds.

    The thread keeps a loop in real time from waiting for standard error.
    """
    began, done, newest = time.monotonic(), threading.Event(), list[T]()

    def take(state: T) -> None:
        newest[:] = [state]

    def write() -> None:
        while not done.wait(every_s):
            for state in newest:
                sys.stderr.write(f"{time.monotonic() - began:5.0f} s  {line(state)}\n")

    teller = threading.Thread(target=write, name="progress", daemon=True)
    teller.start()
    try:
        yield take
    finally:
        done.set()
        teller.join(timeout=1.0)
