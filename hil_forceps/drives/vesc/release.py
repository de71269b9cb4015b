"""The order to let go of the motor, and what answers say of it: a VESC has no word for "no torque".

What is taken for it: `QUIET_ANSWERS_IN_A_ROW` answers say less than a step of current, and where the release was
ordered, they come from behind that order. Firmware that has stopped its modulation says exactly 0.
"""

from typing import Final

REPEAT_NS: Final = 50_000_000  # between orders that no answer shows yet
QUIET_ANSWERS_IN_A_ROW: Final = 3


class Release:
    """Whether the motor has been let go."""

    def __init__(self) -> None:
        self.is_wanted = False
        self._quiet = 0  # answers in a row without current
        self._first_ns: int | None = None  # of the orders
        self._last_ns = 0

    @property
    def is_quiet(self) -> bool:
        """Tell whether no current flows."""
        return self._quiet >= QUIET_ANSWERS_IN_A_ROW

    def want(self) -> None:
        """Ask for it; what was seen before doesn't count."""
        self.is_wanted, self._first_ns, self._quiet = True, None, 0

    def withdraw(self) -> None:
        """Ask for it no more."""
        self.is_wanted, self._first_ns = False, None

    def forget(self) -> None:
        """Begin to look anew."""
        self._quiet = 0

    def is_due(self, now_ns: int) -> bool:
        """Tell whether to order it now, asked for or not."""
        if self.is_quiet or (self._first_ns is not None and now_ns - self._last_ns < REPEAT_NS):
            return False
        self._first_ns = now_ns if self._first_ns is None else self._first_ns
        self._last_ns = now_ns
        return True

    def see(self, current_A: float, asked_ns: int) -> None:
        """Take what an answer says, to a request that went out then; in a tick, orders go out before requests."""
        is_behind = self._first_ns is not None and asked_ns >= self._first_ns
        if current_A != 0.0 or (self.is_wanted and not is_behind):
            self._quiet = 0
        else:
            self._quiet = min(self._quiet + 1, QUIET_ANSWERS_IN_A_ROW)
