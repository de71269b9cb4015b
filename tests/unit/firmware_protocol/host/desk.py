"""A host's machine on a desk: frames are put in by hand, and what it sends is looked at."""

from firmware_protocol import codec
from firmware_protocol.frames import Frame
from firmware_protocol.host.machine import HostConfig, HostMachine, HostPhase
from firmware_protocol.messages import (
    DriveHeartbeat,
    DriveState,
    FaultReason,
    HostHeartbeat,
    Identity,
    Message,
)

MS = 1_000_000
NODE, SERIAL = 4, 0xABCDEF012345
P = HostPhase


class Desk:
    """A host with a hand-made drive at the other end."""

    def __init__(self, **settings: int | bool) -> None:
        self.host = HostMachine(HostConfig(**{"node": NODE, **settings}))  # type: ignore[arg-type]
        self.now_ns = 5_000 * MS
        self.n = 0
        self.heartbeat_sequence = 0
        self.sent: list[Message] = []

    def hear(self, message: Message) -> None:
        self.host.receive(codec.encode(message), self.now_ns)

    def sample(self, state: int = 0, fault: int = 0, theta: int = 777) -> None:
        self.n += 1
        for frame in (
            codec.encode_feedback(NODE, theta, 0, self.n & 0xFF),
            codec.encode_timing(NODE, self.n * 1_000, self.n & 0xFF, 0, state, fault),
        ):
            self.host.receive(frame, self.now_ns)

    def drive_heartbeat(self, state: int = 0, fault: int = 0, major: int = 1, lost: int = 0, advance: int = 1) -> None:
        self.heartbeat_sequence += advance
        sequence = self.heartbeat_sequence & 0xFF
        self.hear(DriveHeartbeat(NODE, state, fault, major, 0, 3, lost, sequence))

    def setpoint(self, theta: int) -> Frame | None:
        self.host.take_samples()
        return self.host.setpoint(theta)

    def phase(self) -> HostPhase:
        return self.host.phase

    def wait(self, ms: int, state: int | None = None) -> list[int]:
        """Poll each ms, with samples of that state; return the control bits of the heartbeats sent."""
        controls = []
        for _ in range(ms):
            self.now_ns += MS
            if state is not None:
                self.sample(state)
            for frame in self.host.poll(self.now_ns):
                message = codec.Decoder().decode(frame)
                assert message is not None
                self.sent.append(message)
                if isinstance(message, HostHeartbeat):
                    controls.append(message.control)
        return controls

    def identify(self) -> None:
        self.host.connect(self.now_ns)
        self.hear(Identity(NODE, SERIAL, 1, 0))

    def ready(self) -> None:
        self.identify()
        self.sample()

    def armed(self) -> None:
        self.ready()
        self.host.enable()
        self.wait(30, DriveState.DISABLED)
        self.sample(DriveState.ARMED)

    def running(self) -> None:
        self.armed()
        self.sample(DriveState.OPERATIONAL)

    def refused(self) -> None:
        self.host.connect(self.now_ns)
        self.hear(Identity(NODE, SERIAL, 2, 0))

    def faulted(self) -> None:
        self.ready()
        self.sample(DriveState.FAULT, FaultReason.SUPPLY)
