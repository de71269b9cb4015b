"""References on their way to a VESC: the first stays until answers say that it was taken, and none may stay away.

A VESC lets go of the motor when no command came for its timeout, and takes the next one as if nothing had been.
"""

from typing import Final

TAKEN_ANSWERS_IN_A_ROW: Final = 3


class References:
    """What went out since the drive was enabled."""

    def __init__(self, timeout_ns: int) -> None:
        self.held_raw: int | None = None  # the first one
        self._timeout_ns = timeout_ns
        self._is_new = False  # one went out since the last tick
        self._first_ns: int | None = None
        self._last_ns = 0
        self._taken = 0  # answers in a row from behind the first that have nothing against it

    def forget(self) -> None:
        """Begin anew, with another first one."""
        self.held_raw, self._is_new, self._first_ns, self._taken = None, False, None, 0

    def send(self, raw: int) -> None:
        """Take note that one goes out."""
        self.held_raw = raw if self.held_raw is None else self.held_raw
        self._is_new = True

    def tick(self, now_ns: int) -> None:
        """Give the time to what went out in this tick."""
        if self._is_new:
            self._first_ns = now_ns if self._first_ns is None else self._first_ns
            self._is_new, self._last_ns = False, now_ns

    def have_starved(self, now_ns: int) -> bool:
        """Tell whether none went out for longer than the timeout."""
        return self._first_ns is not None and now_ns - self._last_ns > self._timeout_ns

    def see(self, has_timeout: bool, asked_ns: int) -> bool:
        """Take what an answer without a fault says; return whether the first reference was taken."""
        is_behind = self._first_ns is not None and asked_ns >= self._first_ns
        self._taken = self._taken + 1 if is_behind and not has_timeout else 0
        return self._taken >= TAKEN_ANSWERS_IN_A_ROW
