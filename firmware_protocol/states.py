"""Both ends as tables: what is not in a table changes nothing.

Drive. Only ENABLE leads out of DISABLED towards torque, and only a fresh reference near the measured angle gives it.
FAULT latches and keeps its first reason, because only RESET leaves it; RESET leads to DISABLED, never further.
ESTOP and TRIP fault every state but FAULT, which is one already.

Host. It says what the drive last reported and what the user last asked for, whichever is the more careful. A command
that is not in HOST_COMMANDS for the phase is a mistake of the caller.
"""

from enum import Enum, auto
from typing import Final

from firmware_protocol.messages import DriveState, FaultReason

MAX_SEQUENCE_ADVANCE: Final = 127  # HFP-042: numbers so far ahead count as new, others as old


class DriveEvent(Enum):
    """What can happen to a drive."""

    ENABLE = auto()  # rising edge of ENABLE from a host whose version fits
    VERSION_MISFIT = auto()  # ENABLE from a host whose major version does not fit
    DISABLE = auto()  # ENABLE low
    RESET = auto()  # rising edge of FAULT_RESET
    REFERENCE = auto()  # fresh, within limits; in ARMED also within tolerance of the measured angle
    REFERENCE_OFF = auto()  # fresh, but in ARMED too far from the measured angle
    REFERENCE_OUTSIDE = auto()  # fresh, but beyond a position limit
    REFERENCE_JUMP = auto()  # fresh, but too far from the one before
    WATCHDOG_EXPIRED = auto()
    HOST_LOST = auto()
    ARM_EXPIRED = auto()
    ESTOP = auto()
    TRIP = auto()  # the device's own protection


_ALWAYS: Final = {DriveEvent.ESTOP: DriveState.FAULT, DriveEvent.TRIP: DriveState.FAULT}

DRIVE_TRANSITIONS: Final[dict[DriveState, dict[DriveEvent, DriveState]]] = {
    DriveState.DISABLED: {
        **_ALWAYS,
        DriveEvent.ENABLE: DriveState.ARMED,
        DriveEvent.VERSION_MISFIT: DriveState.FAULT,
    },
    DriveState.ARMED: {
        **_ALWAYS,
        DriveEvent.DISABLE: DriveState.DISABLED,
        DriveEvent.REFERENCE: DriveState.OPERATIONAL,
        DriveEvent.REFERENCE_OFF: DriveState.FAULT,
        DriveEvent.REFERENCE_OUTSIDE: DriveState.FAULT,
        DriveEvent.ARM_EXPIRED: DriveState.FAULT,
        DriveEvent.HOST_LOST: DriveState.FAULT,
        DriveEvent.VERSION_MISFIT: DriveState.FAULT,
    },
    DriveState.OPERATIONAL: {
        **_ALWAYS,
        DriveEvent.DISABLE: DriveState.DISABLED,
        DriveEvent.REFERENCE_OUTSIDE: DriveState.FAULT,
        DriveEvent.REFERENCE_JUMP: DriveState.FAULT,
        DriveEvent.WATCHDOG_EXPIRED: DriveState.FAULT,
        DriveEvent.HOST_LOST: DriveState.FAULT,
        DriveEvent.VERSION_MISFIT: DriveState.FAULT,
    },
    DriveState.FAULT: {DriveEvent.RESET: DriveState.DISABLED},
}

DRIVE_REASONS: Final[dict[DriveEvent, FaultReason]] = {
    DriveEvent.VERSION_MISFIT: FaultReason.VERSION,
    DriveEvent.REFERENCE_OFF: FaultReason.REFERENCE_MISMATCH,
    DriveEvent.REFERENCE_OUTSIDE: FaultReason.REFERENCE_POSITION,
    DriveEvent.REFERENCE_JUMP: FaultReason.REFERENCE_RATE,
    DriveEvent.WATCHDOG_EXPIRED: FaultReason.WATCHDOG,
    DriveEvent.HOST_LOST: FaultReason.HOST_HEARTBEAT_LOST,
    DriveEvent.ARM_EXPIRED: FaultReason.ENABLE_TIMEOUT,
    DriveEvent.ESTOP: FaultReason.ESTOP,
}  # TRIP brings its own


class HostPhase(Enum):
    """Where the host stands with its drive."""

    DISCONNECTED = auto()
    IDENTIFYING = auto()  # asks who is there
    READY = auto()  # identified, version fits, no torque wanted
    ENABLING = auto()  # torque wanted, the drive does not follow yet
    RUNNING = auto()  # the drive follows the references
    FAULT = auto()  # the drive reports a fault
    REFUSED = auto()  # wrong version or wrong device: nothing is sent


class HostEvent(Enum):
    """What can happen to a host: the first four are commands of the user."""

    CONNECT = auto()
    ENABLE = auto()
    DISABLE = auto()
    RESET = auto()
    IDENTIFIED = auto()
    MISFIT = auto()  # other major version, or not the serial number expected
    SAW_DISABLED = auto()  # what the drive reports
    SAW_ARMED = auto()
    SAW_OPERATIONAL = auto()
    SAW_FAULT = auto()
    GONE = auto()  # silent too long, or restarted
    ENABLE_EXPIRED = auto()


_CONNECTED: Final = {
    HostEvent.GONE: HostPhase.DISCONNECTED,
    HostEvent.MISFIT: HostPhase.REFUSED,
}

HOST_TRANSITIONS: Final[dict[HostPhase, dict[HostEvent, HostPhase]]] = {
    HostPhase.DISCONNECTED: {HostEvent.CONNECT: HostPhase.IDENTIFYING},
    HostPhase.IDENTIFYING: {HostEvent.IDENTIFIED: HostPhase.READY, HostEvent.MISFIT: HostPhase.REFUSED},
    HostPhase.READY: {
        **_CONNECTED,
        HostEvent.ENABLE: HostPhase.ENABLING,
        HostEvent.SAW_FAULT: HostPhase.FAULT,
    },
    HostPhase.ENABLING: {
        **_CONNECTED,
        HostEvent.DISABLE: HostPhase.READY,
        HostEvent.ENABLE_EXPIRED: HostPhase.READY,
        HostEvent.SAW_OPERATIONAL: HostPhase.RUNNING,
        HostEvent.SAW_FAULT: HostPhase.FAULT,
    },
    HostPhase.RUNNING: {
        **_CONNECTED,
        HostEvent.DISABLE: HostPhase.READY,
        HostEvent.SAW_DISABLED: HostPhase.READY,
        HostEvent.SAW_ARMED: HostPhase.READY,
        HostEvent.SAW_FAULT: HostPhase.FAULT,
    },
    HostPhase.FAULT: {**_CONNECTED, HostEvent.SAW_DISABLED: HostPhase.READY},
    HostPhase.REFUSED: {HostEvent.CONNECT: HostPhase.IDENTIFYING},
}

HOST_COMMANDS: Final[dict[HostEvent, frozenset[HostPhase]]] = {
    HostEvent.CONNECT: frozenset({HostPhase.DISCONNECTED, HostPhase.IDENTIFYING, HostPhase.REFUSED}),
    HostEvent.ENABLE: frozenset({HostPhase.READY, HostPhase.ENABLING, HostPhase.RUNNING}),
    HostEvent.DISABLE: frozenset(HostPhase),
    HostEvent.RESET: frozenset({HostPhase.FAULT}),
}
