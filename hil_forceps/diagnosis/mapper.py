"""How work is shared out: `map`, or that of a pool, in which a task may map in turn."""

from collections.abc import Callable, Iterable
from typing import Any

Mapper = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]
