"""Where the gate stands, as a table: state × event → state.

1. Nothing passes but in OPEN, FROZEN and FAILING.
2. OPEN is reached from CLOSED by opening at the measured angle, and from FROZEN when what froze it is over.
3. Too long a time without output closes the gate, and latches one that is frozen.
4. What is beyond a limit freezes; what cannot be so fails, and does not recover.
5. A freeze that lasts too long latches, and LATCHED is left by `CLEARED` alone, to CLOSED.
"""

from enum import Enum
from typing import Final


class GateState(Enum):
    """Where the gate stands."""

    CLOSED = "closed"
    OPEN = "open"
    FROZEN = "frozen"  # the reference is held, until the feedback is within its limits again
    FAILING = "failing"  # the reference is held, and then the gate latches
    LATCHED = "latched"


class GateEvent(Enum):
    """What happens to it."""

    OPENED = "opened"  # at a measured angle that is fresh and within the bounds
    REFUSED = "refused"  # there is no such angle to open at
    GAP = "gap"  # too long since the last output
    EXCEEDED = "exceeded"  # a limit of what is measured
    RECOVERED = "recovered"  # and within it again
    IMPLAUSIBLE = "implausible"  # what is measured cannot be
    HELD_TOO_LONG = "held_too_long"
    CLEARED = "cleared"


_S, _E = GateState, GateEvent

TRANSITIONS: Final = {
    _S.CLOSED: dict.fromkeys(_E, _S.CLOSED) | {_E.OPENED: _S.OPEN},
    _S.OPEN: dict.fromkeys(_E, _S.OPEN)
    | {_E.REFUSED: _S.CLOSED, _E.GAP: _S.CLOSED, _E.EXCEEDED: _S.FROZEN, _E.IMPLAUSIBLE: _S.FAILING},
    _S.FROZEN: dict.fromkeys(_E, _S.FROZEN)
    | {_E.GAP: _S.LATCHED, _E.RECOVERED: _S.OPEN, _E.IMPLAUSIBLE: _S.FAILING, _E.HELD_TOO_LONG: _S.LATCHED},
    _S.FAILING: dict.fromkeys(_E, _S.FAILING) | {_E.GAP: _S.LATCHED, _E.HELD_TOO_LONG: _S.LATCHED},
    _S.LATCHED: dict.fromkeys(_E, _S.LATCHED) | {_E.CLEARED: _S.CLOSED},
}  # fmt: skip
