"""How a check says which requirement it proves and what it needs, and how it says what it found."""

from collections.abc import Callable
from enum import Flag, auto
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from firmware_protocol.conformance.session import Session


class Violation(Exception):  # noqa: N818 - a finding, not an error of the program
    """The drive did what the requirement forbids; the text is the evidence."""


class Inconclusive(Exception):  # noqa: N818
    """It can't be told from here: something that the check needs was not to be had."""


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


class Check(NamedTuple):
    """One check: `run` returns its evidence, or raises Violation or Inconclusive."""

    name: str
    requirement: int
    needs: Need
    last: bool  # leaves a trace that others would stumble over, or judges what has been seen so far
    run: Callable[["Session"], str]


CHECKS: Final[list[Check]] = []


def check(
    requirement: int, needs: Need = Need.NOTHING, last: bool = False
) -> Callable[[Callable[["Session"], str]], Callable[["Session"], str]]:
    """Register a function as a check of one requirement."""

    def register(run: Callable[["Session"], str]) -> Callable[["Session"], str]:
        CHECKS.append(Check(run.__name__, requirement, needs, last, run))
        return run

    return register


def expect(condition: bool, finding: str) -> None:
    """Raise Violation with the finding unless the condition holds."""
    if not condition:
        raise Violation(finding)


def require(condition: bool, missing: str) -> None:
    """Raise Inconclusive unless the condition holds, which the check needs but does not judge."""
    if not condition:
        raise Inconclusive(missing)
