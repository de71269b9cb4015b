"""Work handed to a thread through a bounded queue, or done at once where nobody is in a hurry (virtual time)."""

import queue
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Item = TypeVar("Item")


class Background(Generic[Item]):
    """Calls `work` for every item, in order. `work` must not raise; a handed-over item is its alone."""

    def __init__(self, work: Callable[[Item], None], threaded: bool, depth: int, name: str) -> None:
        """`depth`: how many items may wait for the thread."""
        self._work = work
        self._queue: queue.Queue[Item | None] | None = queue.Queue(depth) if threaded else None
        self._thread = threading.Thread(target=self._drain, name=name, daemon=True) if threaded else None
        if self._thread is not None:
            self._thread.start()

    def put(self, item: Item, timeout_s: float = 0.0) -> bool:
        """Hand over an item; False when the queue stays full for `timeout_s`, and the item is not taken."""
        if self._queue is None:
            self._work(item)
            return True
        try:
            self._queue.put(item, block=timeout_s > 0.0, timeout=timeout_s)
        except queue.Full:
            return False
        return True

    def close(self, timeout_s: float) -> bool:
        """Wait for what was handed over; False when it is not done in time (a disk that hangs)."""
        if self._queue is None or self._thread is None:
            return True
        try:
            self._queue.put(None, timeout=timeout_s)
        except queue.Full:
            return False
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _drain(self) -> None:
        assert self._queue is not None
        while (item := self._queue.get()) is not None:
            self._work(item)
