"""All checks, each with the requirement that it proves and what it needs."""

from collections.abc import Callable
from enum import Flag, auto
from typing import Final, NamedTuple

from firmware_protocol.conformance.session import Session


class Need(Flag):
    """What a check can't do without."""

    NOTHING = 0
    MOTION = auto()  # gives torque: only where the user allows it
    FD_DRIVE = auto()
    CLASSIC_DRIVE = auto()
    FD_LINE = auto()  # the line carries FD frames, whatever the drive speaks
    FOREIGN = auto()  # the line carries extended ids and remote frames
    SERIAL = auto()
    STREAM = auto()  # the line is serial and cuts bytes where it likes
    DATAGRAM = auto()  # the line is serial and keeps them in the pieces in which they were sent


class Check(NamedTuple):
    """One check: `run` returns its evidence, or raises Violation or Inconclusive."""

    name: str
    requirement: int
    needs: Need
    last: bool  # leaves a trace that others would stumble over, or judges what has been seen so far
    run: Callable[[Session], str]


CHECKS: Final[list[Check]] = []


def check(
    requirement: int, needs: Need = Need.NOTHING, last: bool = False
) -> Callable[[Callable[[Session], str]], Callable[[Session], str]]:
    """Register a function as a check of one requirement."""

    def register(run: Callable[[Session], str]) -> Callable[[Session], str]:
        CHECKS.append(Check(run.__name__, requirement, needs, last, run))
        return run

    return register
