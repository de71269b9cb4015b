"""What a profile promises of its drive that no method of the port tells: what conformance holds a drive to."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

Starved = Literal["fault", "braked", "ready", "lost", "released"]
_COUNTS_GOOD: Final = frozenset({"samples", "setpoints_sent", "not_for_us"})


@dataclass(frozen=True, slots=True)
class Promises:
    """One drive's, as its rig sets it up.

    `starved` is what the machine shows when references stay away for longer than the watchdog's time while the service
    goes on polling:

    - fault: the drive stops by itself, without torque, and latches that until one reset;
    - braked: the same, but it brakes or damps until it is reset or disabled;
    - ready: it stops by itself and latches nothing;
    - lost: it stops by itself, and the machine hears nothing of it any more;
    - released: the machine itself goes on with commands that don't pull.
    """

    state_report_s: float = 0.1  # until a change of state shows, at the latest: a heartbeat's period, say
    starved: Starved = "fault"
    tells_state: bool = True  # the drive itself says whether it has torque
    tells_watchdog: bool = True  # the drive itself says that its watchdog has stopped it
    # Behind the watchdog's time, until it acts: firmware looks rarely, or something else feeds it for a while. None: no
    # watchdog is documented.
    reaction_s: float | None = 0.0
    current_step_A: float = 0.0  # in which it tells its current, where that is coarser than its noise
    harmless_counters: frozenset[str] = frozenset()  # besides `…_sent`: what grows where nothing is wrong


def damage(counters: Mapping[str, int], promises: Promises) -> dict[str, int]:
    """Return the counters that tell of something missing, damaged or not understood."""
    harmless = _COUNTS_GOOD | promises.harmless_counters
    return {name: n for name, n in counters.items() if name not in harmless and not name.endswith("_sent")}
