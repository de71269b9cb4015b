"""What the service is told and what it tells: settings, telemetry, and how a run ended."""

from collections.abc import Mapping
from enum import Enum
from typing import NamedTuple

from hil_forceps.bridge.gate_tally import GateCount
from hil_forceps.bridge.statistics import HistogramSummary
from hil_forceps.control.gate import GateTrip, GateVerdict


class StopReason(Enum):
    """Why a run ended; the value is the word for files."""

    COMPLETED = "completed"  # the wanted time of the experiment is over
    STOP_REQUESTED = "stop_requested"
    NO_DRIVE = "no_drive"
    VERSION_REFUSED = "version_refused"
    ENABLE_FAILED = "enable_failed"
    DRIVE_FAULT = "drive_fault"
    DRIVE_LOST = "drive_lost"  # the drive fell silent
    DRIVE_STOPPED = "drive_stopped"  # the drive left operation by itself
    REFERENCE_DENIED = "reference_denied"  # the gate let nothing pass
    FEEDBACK_IMPLAUSIBLE = "feedback_implausible"  # the gate has latched: what is measured can't be
    GATE_LATCHED = "gate_latched"  # the gate has latched: what is measured stayed beyond a limit
    BUS_DOWN = "bus_down"
    RECORDING_FAILED = "recording_failed"
    RUNAWAY = "runaway"  # the motor went away from its reference at the current limit
    FOLLOWING_ERROR = "following_error"  # the motor left the window around its reference
    OTHER_AXIS = "other_axis"  # another axis of the same service failed
    REFERENCE_LOST = "reference_lost"  # references from outside stayed away
    EMERGENCY_STOP = "emergency_stop"  # an operator stopped it


AS_MEANT = frozenset({StopReason.COMPLETED, StopReason.STOP_REQUESTED})  # a run ended as it was meant to


class Stage(Enum):
    """Where a run is."""

    CONNECTING = "connecting"
    ENABLING = "enabling"
    RUNNING = "running"
    STOPPING = "stopping"
    STOPPED = "stopped"  # by an operator, without torque, until that is cleared or the run is ended
    ENDED = "ended"


class ServiceConfig(NamedTuple):
    """Times of the loop, in ns of the host's clock.

    `duration_ns` counts the drive's time from the zero; None is no end.
    """

    period_ns: int = 1_000_000
    phase_ns: int = 600_000
    duration_ns: int | None = None
    connect_timeout_ns: int = 2_000_000_000
    enable_timeout_ns: int = 2_000_000_000
    disable_timeout_ns: int = 500_000_000
    silence_timeout_ns: int = 100_000_000  # without a sample while running
    max_denied_in_a_row: int = 5
    reset_fault: bool = False  # clear a fault that the drive holds from before; otherwise that ends the run
    telemetry_period_ns: int = 200_000_000


class Telemetry(NamedTuple):
    """A look at the run, a few times a second. Not finite before there is something to show."""

    stage: Stage
    time_s: float  # since the zero; NaN before
    theta_m_rad: float
    reference_rad: float
    tau_w_N_m: float
    elongation_m: float
    frames_sent: int
    frames_received: int
    overruns: int
    axis: str = ""  # where there are several


class ServiceResult(NamedTuple):
    """How a run ended.

    `drive_disabled`: after the end the drive itself reported no torque, or it reported nothing and was never asked
    for any.
    """

    reason: StopReason
    message: str
    drive_disabled: bool
    zero_ns: int | None
    counters: Mapping[str, Mapping[str, int]]  # of the service, the pipeline, the host's machine, the link
    timing: Mapping[str, HistogramSummary]
    gate: Mapping[GateVerdict, GateCount]  # what the gate limited, held or denied
    gate_trip: GateTrip | None  # what stopped the gate
    stages: tuple[tuple[int, str], ...] = ()  # when each began, host's clock; the first is the start of the run

    @property
    def ok(self) -> bool:
        """Whether the run ended as it was meant to."""
        return self.reason in AS_MEANT and self.drive_disabled
