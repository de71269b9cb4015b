"""The table of defects: each changes one thing, by a patch that is taken back."""

from collections.abc import Callable
from typing import Any, Final, NamedTuple

import pytest

from tests.fault_campaign.rigs import PROFILES
from tests.fault_campaign.schedule import Kind

Plant = Callable[[pytest.MonkeyPatch], None]


class Defect(NamedTuple):
    """One defect; its function's docstring says what is wrong."""

    name: str
    plant: Plant
    profiles: tuple[str, ...]  # whose schedules it is looked for with
    caught_by: frozenset[str]  # names of invariants, one of which must tell
    among: tuple[Kind, ...]  # faults that the schedules are drawn from


DEFECTS: Final[dict[str, Defect]] = {}


def defect(
    *caught_by: str, profiles: tuple[str, ...] = PROFILES, among: tuple[Kind, ...] = tuple(Kind)
) -> Callable[[Plant], Plant]:
    """Enter a defect into the table."""

    def enter(plant: Plant) -> Plant:
        DEFECTS[plant.__name__] = Defect(plant.__name__, plant, profiles, frozenset(caught_by), among)
        return plant

    return enter


def around(patch: pytest.MonkeyPatch, owner: Any, name: str, instead: Callable[..., Any]) -> None:
    """Replace a method by `instead(old, self, ...)`."""
    old = getattr(owner, name)
    patch.setattr(owner, name, lambda self, *arguments: instead(old, self, *arguments))
