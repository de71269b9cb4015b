"""Sees, before anything moves, that a VESC's timeout is on, as short as was said, and that nobody else feeds it.

    EXPIRING  until the VESC says that its timeout has expired: nobody has commanded it for that long
    FEEDING   it is told to release the motor, which it is already, until it says that the timeout was fed
    WAITING   until the VESC says that its timeout has expired once more
    PASSED

A VESC drives on for as long as its timeout is behind a host that failed, for ever where it is off, and tells nobody how
long that is. It says whether it has expired, in every answer.
"""

from enum import Enum, auto
from typing import Final

THREAD_NS: Final = 10_000_000  # the firmware looks at its timeout this often (timeout.c)
SLACK_NS: Final = 4 * THREAD_NS  # one look to be late by, one to be told in, and the way there and back
REPEAT_NS: Final = 50_000_000  # between orders that nothing shows
FEEDING_NS: Final = 10 * REPEAT_NS  # for one to show


class Stage(Enum):
    """How far the trial is."""

    EXPIRING = auto()
    FEEDING = auto()
    WAITING = auto()
    PASSED = auto()


class TimeoutTrial:
    """One trial."""

    def __init__(self, timeout_ns: int) -> None:
        self.stage = Stage.EXPIRING
        self._timeout_ns = timeout_ns
        self._began_ns: int | None = None  # of the stage, by the first answer in it
        self._ordered_ns: int | None = None

    def is_due(self, now_ns: int) -> bool:
        """Tell whether to order the release now."""
        if self.stage is not Stage.FEEDING:
            return False
        if self._ordered_ns is not None and now_ns - self._ordered_ns < REPEAT_NS:
            return False
        self._ordered_ns = now_ns
        return True

    def see(self, has_timeout: bool, asked_ns: int) -> None:
        """Take what an answer says, to a request that went out then."""
        self._began_ns = asked_ns if self._began_ns is None else self._began_ns
        if self.stage is Stage.EXPIRING and has_timeout:
            self.stage, self._began_ns = Stage.FEEDING, asked_ns
        elif self.stage is Stage.FEEDING and not has_timeout and _is_behind(asked_ns, self._ordered_ns):
            self.stage, self._began_ns = Stage.WAITING, self._ordered_ns
        elif self.stage is Stage.WAITING and has_timeout:
            self.stage = Stage.PASSED

    def is_late(self, now_ns: int) -> bool:
        """Tell whether what the stage waits for should have come by now."""
        if self._began_ns is None or self.stage is Stage.PASSED:
            return False
        longest_ns = FEEDING_NS if self.stage is Stage.FEEDING else self._timeout_ns + SLACK_NS
        return now_ns - self._began_ns > longest_ns


def _is_behind(asked_ns: int, ordered_ns: int | None) -> bool:
    return ordered_ns is not None and asked_ns >= ordered_ns
