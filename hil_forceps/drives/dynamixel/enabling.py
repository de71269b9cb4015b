"""Torque without a kick: no current until the servo has been given the measured angle as its goal, under torque.

The maker does not say what a servo makes of a goal that it gets without torque, nor whether it keeps one of before
when torque is switched on. In current-based position mode the goal current is the limit, so with 0 nothing can move
until the goal is right, whatever it was.
"""

from enum import IntEnum
from typing import Final

from hil_forceps.drives.dynamixel import control_table as table
from hil_forceps.drives.dynamixel.control_table import Item

FIRST_REFERENCES: Final = 3  # they are not answered, so two may be lost


class Step(IntEnum):
    """What is done next."""

    NO_CURRENT = 0
    REFERENCES = 1
    TORQUE = 2
    REFERENCES_UNDER_TORQUE = 3
    CURRENT = 4
    DONE = 5


_OF_REFERENCES: Final = frozenset({Step.REFERENCES, Step.REFERENCES_UNDER_TORQUE})


class Enabling:
    """The steps; `limit` is the goal current at the end, in units of the servo."""

    def __init__(self, limit: int) -> None:
        self.step = Step.NO_CURRENT
        self._limit = limit
        self._references = 0
        self._held_raw: int | None = None

    def reference(self, raw: int) -> int | None:
        """Return the reference to send, the first that there was; None where it isn't the time for one."""
        if self.step not in _OF_REFERENCES:
            return None
        if self._held_raw is None:
            self._held_raw = raw
        self._references += 1
        return self._held_raw

    def order(self) -> tuple[Item, int] | None:
        """Return what is to be written now; None while references are sent."""
        if self.step in _OF_REFERENCES:
            if self._references < FIRST_REFERENCES:
                return None
            self._go_to(Step(self.step + 1))
        if self.step is Step.TORQUE:
            return table.TORQUE_ENABLE, 1
        return table.GOAL_CURRENT, self._limit if self.step is Step.CURRENT else 0

    def taken(self) -> None:
        """Go on: the servo has taken the order."""
        self._go_to(Step(self.step + 1))

    def without_torque(self) -> None:
        """Order torque once more: the servo says that it has none, as it does in the sample of each reference."""
        if self.step is Step.REFERENCES_UNDER_TORQUE:
            self._go_to(Step.TORQUE)

    def _go_to(self, step: Step) -> None:
        self.step, self._references = step, 0
