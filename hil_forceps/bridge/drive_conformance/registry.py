"""All checks, each with the promise that it proves and what it needs."""

from collections.abc import Callable
from enum import Enum, auto
from typing import Final, NamedTuple

from hil_forceps.bridge.drive_conformance.session import Session


class Need(Enum):
    """What a check can't do without."""

    LISTENING = auto()
    TORQUE = auto()  # the motor is held where it is
    MOTION = auto()  # the motor is moved by one step


class Check(NamedTuple):
    """One check: `run` adds to the session's evidence, or raises Violation or Inconclusive."""

    promise: int
    needs: Need
    excuse: Callable[[Session], str]  # why there is nothing to judge with such a profile, or nothing
    run: Callable[[Session], None]


CHECKS: Final[dict[int, Check]] = {}


def check(
    promise: int, needs: Need, excuse: Callable[[Session], str] = lambda _: ""
) -> Callable[[Callable[[Session], None]], Callable[[Session], None]]:
    """Register a function as the check of one promise."""

    def register(run: Callable[[Session], None]) -> Callable[[Session], None]:
        if promise in CHECKS:
            raise ValueError(f"promise {promise} has a check already")
        CHECKS[promise] = Check(promise, needs, excuse, run)
        return run

    return register
