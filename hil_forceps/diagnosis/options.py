"""How a diagnosis is made, and which runs are held out."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

from hil_forceps.diagnosis.evidence import Mapper
from hil_forceps.diagnosis.result import Diagnosis
from hil_forceps.rig.errors import UserError

HELD_OUT_SHARE = 3  # one run in three is held out


def do_nothing(_: object) -> None:
    """Tell and draw nothing."""


def never() -> bool:
    """Say no."""
    return False


@dataclass(frozen=True, slots=True, eq=False)
class Options:
    """How to diagnose; the defaults are what the published figures were made with."""

    without: frozenset[str] = frozenset()  # entries of the catalogue that are left out
    hold_out: tuple[str, ...] = ()  # names of runs to hold out; none: chosen here
    seed: int = 0
    mapper: Mapper = map
    progress: Callable[[str], None] = do_nothing
    # Told all that figures show, while the next experiment is still looked for; may come from a thread of its own.
    to_draw: Callable[[Diagnosis], None] = do_nothing
    spent: Callable[[], bool] = never  # whether the time that was allowed is spent


class Named(Protocol):
    """What has a name."""

    @property
    def name(self) -> str:
        """The name."""


AnyRun = TypeVar("AnyRun", bound=Named)  # as measured, or on equally spaced rows


def split_runs(runs: Sequence[AnyRun], wanted: Sequence[str]) -> tuple[list[AnyRun], list[AnyRun]]:
    """Return the runs to fit and those to hold out: those wanted, else the last third, but none of a single run."""
    names = [run.name for run in runs]
    if unknown := [name for name in wanted if name not in names]:
        raise UserError(f"hold_out {unknown[0]}: no such run; the runs are {', '.join(names)}")
    if wanted:
        held = [run for run in runs if run.name in wanted]
        fitted = [run for run in runs if run.name not in wanted]
        if not fitted:
            raise UserError("hold_out: every run is held out; leave one at least to fit")
        return fitted, held
    count = len(runs) // HELD_OUT_SHARE if len(runs) > 2 else len(runs) - 1
    split = len(runs) - max(count, 0)
    return list(runs[:split]), list(runs[split:])
