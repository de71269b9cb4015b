"""The steps between a host's phases that every maker's drive takes; a profile adds what its protocol has besides.

Events are what the drive says and what the user asks for; an event that a phase doesn't name changes nothing.

    connect, enable, disable   what the user asks for
    complete                   the drive is known, and says all that is needed
    refuse                     it isn't one that can be driven, or isn't set up for it
    fault                      it says that it has one, or that its watchdog has stopped it
    gone                       nothing is heard of it any more, or it has been reset
"""

from typing import Final

from firmware_protocol.states import HostPhase

P = HostPhase
Transitions = dict[tuple[HostPhase, str], HostPhase]
COMMON: Final[Transitions] = {
    (P.DISCONNECTED, "connect"): P.IDENTIFYING,
    (P.REFUSED, "connect"): P.IDENTIFYING,
    (P.IDENTIFYING, "complete"): P.READY,
    (P.IDENTIFYING, "refuse"): P.REFUSED,
    (P.IDENTIFYING, "fault"): P.FAULT,
    (P.READY, "enable"): P.ENABLING,
    (P.READY, "fault"): P.FAULT,
    (P.READY, "gone"): P.DISCONNECTED,
    (P.ENABLING, "disable"): P.READY,
    (P.ENABLING, "fault"): P.FAULT,
    (P.ENABLING, "gone"): P.DISCONNECTED,
    (P.RUNNING, "disable"): P.READY,
    (P.RUNNING, "fault"): P.FAULT,
    (P.RUNNING, "gone"): P.DISCONNECTED,
    (P.FAULT, "gone"): P.DISCONNECTED,
}
