"""How work is shared out: `map`, or that of a pool. What a task does must not wait for tasks of its own."""

from collections.abc import Callable, Iterable
from typing import Any

Mapper = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]
