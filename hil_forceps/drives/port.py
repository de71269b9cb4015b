"""What the service asks of a drive, whatever protocol that speaks: frames and times in, frames and samples out.

A profile is pure: it reads no clock and opens nothing. Samples come in the project's own raw integers (angle in 2⁻²⁴
turn of the motor pulley, current in 0.2 mA), so that recordings, estimators and the gate are the same for all drives. A
profile hands out a reference only through `setpoint`, which the service calls with what the gate let pass.
"""

from collections.abc import Mapping
from typing import Final, Protocol

from firmware_protocol.frames import Frame
from firmware_protocol.host.samples import RawBench, RawSample
from firmware_protocol.messages import DriveState
from firmware_protocol.states import HostPhase

NO_TORQUE: Final = frozenset({DriveState.DISABLED, DriveState.FAULT})  # what a drive says that pulls nothing
SEQUENCE_MASK: Final = 0xFF  # numbers of references and samples count modulo 256, as in a recording


class DriveMachine(Protocol):
    """One drive, as the host sees it."""

    @property
    def phase(self) -> HostPhase:
        """Where the host stands with the drive."""

    @property
    def refusal(self) -> str:
        """Why the drive was refused, in one line; empty unless the phase is REFUSED."""

    @property
    def drive_state(self) -> DriveState | None:
        """What the drive says of itself; None before it has said anything."""

    @property
    def setpoint_sequence(self) -> int:
        """Number of the last reference handed out, modulo 256."""

    @property
    def counters(self) -> Mapping[str, int]:
        """What went missing or was not understood, by name."""

    def fault_words(self) -> str:
        """Return the drive's fault in words."""

    def connect(self, now_ns: int) -> None:
        """Start to look for the drive."""

    def enable(self) -> None:
        """Ask for torque."""

    def disable(self) -> None:
        """Ask for no torque; allowed in every phase."""

    def reset_fault(self) -> None:
        """Ask the drive once to forget its fault."""

    def estop_frame(self) -> Frame:
        """Return what to send at once where this program fails."""

    def setpoint(self, theta_m_ref_raw: int) -> Frame | None:
        """Return the reference to send, None where the phase forbids one."""

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Take one frame from the bus; what isn't the drive's, or is damaged, is counted and dropped."""

    def poll(self, now_ns: int) -> list[Frame]:
        """Let time pass; return what is due."""

    def take_samples(self) -> list[RawSample]:
        """Hand over the samples since the last call, oldest first."""

    def take_bench(self) -> list[RawBench]:
        """Hand over readings of bench sensors since the last call; most drives have none."""
