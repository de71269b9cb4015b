"""Traffic with one drive: what it sends is recorded, what a host must send cyclically goes out while time passes."""

from collections.abc import Callable
from typing import Final, NamedTuple

from firmware_protocol.conformance import wire
from firmware_protocol.conformance.findings import Inconclusive
from firmware_protocol.conformance.monitor import Monitor
from firmware_protocol.conformance.port import MS, Margins, Port
from firmware_protocol.frames import Frame, split_id
from firmware_protocol.messages import (
    PROTOCOL_MAJOR,
    PROTOCOL_MINOR,
    DriveHeartbeat,
    FdFeedback,
    Feedback,
    Function,
    HostHeartbeat,
    Identity,
    Message,
    ParamResponse,
    Timing,
)

HEARTBEAT_NS: Final = 20 * MS
REFERENCE_NS: Final = 2 * MS
SILENT_NS: Final = 50 * MS  # without a measurement the heartbeats say the state
MAX_NO_ROOM_NS: Final = 1_000 * MS
MAX_RECORDED_SAMPLES: Final = 100_000


class Sample(NamedTuple):
    """One measurement with its arrival; angle, current and stamp as the wire has them."""

    time_ns: int
    sequence: int
    stamp_us: int
    theta_m: int
    current: int
    echo: int
    state: int
    fault: int


class Probe:
    """A host that does what a check says and nothing of its own but keeping alive.

    While `beating`, HOST_HEARTBEAT goes out each 20 ms with the last control bits; while `reference` is an angle, it
    goes out each 2 ms. Records are those since `begin`. `stalled_ns`: the longest time that this host stood still.
    `thorough`: try every value, not only the few that matter most; as a rule where time is virtual.
    """

    def __init__(self, port: Port, node: int, margins: Margins) -> None:
        self.port = port
        self.node = node
        self.margins = margins
        self.fd = False
        self.thorough = port.virtual_time
        self.monitor = Monitor(port.virtual_time)
        self.beating = False
        self.control = 0
        self.reference: int | None = None
        self.host_sequence = 0
        self.setpoint_sequence = 0
        self.state, self.fault = -1, -1
        self.newest: Sample | None = None
        self.others: set[int] = set()  # nodes of other drives that were heard
        self.sent: set[int] = set()  # ids: some interfaces play back what one sends
        self._beat_due_ns = self._reference_due_ns = 0
        self._halves: Feedback | None = None
        self._seen_ns: int | None = None  # by the loop
        self.begin()

    def begin(self) -> None:
        """Start the records anew."""
        self.samples: list[Sample] = []
        self.beats: list[tuple[int, DriveHeartbeat]] = []
        self.responses: list[tuple[int, ParamResponse]] = []
        self.identities: list[tuple[int, Identity]] = []
        self.stalled_ns = 0
        self._lost_before = self.monitor.lost

    @property
    def virtual(self) -> bool:
        """Tell whether nothing can be late here."""
        return self.port.virtual_time

    def lost(self) -> int:
        """Count the measurements that are missing since `begin`."""
        return self.monitor.lost - self._lost_before

    def now_ns(self) -> int:
        """Return the time now."""
        return self.port.now_ns()

    def dense(self, values: "range | tuple[int, ...]", few: tuple[int, ...]) -> tuple[int, ...]:
        """Return all values where time costs nothing, else the few that matter most."""
        return tuple(values) if self.thorough else few

    # -- time ---------------------------------------------------------------------------------------------------------

    def run(self, duration_ns: int, until: Callable[[], bool] | None = None, tick_ns: int = 0) -> bool:
        """Let time pass, keeping alive; True as soon as `until` holds."""
        port = self.port
        end_ns = port.now_ns() + duration_ns
        tick_ns = tick_ns or self.margins.tick_ns
        while True:
            now_ns = port.now_ns()
            self._watch_host(now_ns)
            for time_ns, frame in port.receive():
                self._on_frame(time_ns, frame)
            if until is not None and until():
                return True
            if now_ns >= end_ns:
                return False
            self._keep_alive(now_ns)
            port.wait_until(min(end_ns, now_ns + tick_ns))

    def wait_until(self, time_ns: int) -> None:
        """Do nothing at all until then: for what must be sent at an instant."""
        self.port.wait_until(time_ns)
        self._seen_ns = self.port.now_ns()
        if not self.port.virtual_time:
            self.stalled_ns = max(self.stalled_ns, self._seen_ns - time_ns)

    def _watch_host(self, now_ns: int) -> None:
        if self._seen_ns is not None and not self.port.virtual_time:
            self.stalled_ns = max(self.stalled_ns, now_ns - self._seen_ns - self.margins.tick_ns)
        self._seen_ns = now_ns

    def _keep_alive(self, now_ns: int) -> None:
        if self.beating and now_ns >= self._beat_due_ns:
            self.send_heartbeat(self.control)
        if self.reference is not None and now_ns >= self._reference_due_ns and self.newest is not None:
            self._reference_due_ns = now_ns + REFERENCE_NS
            self.send_setpoint(self.reference)

    # -- out ----------------------------------------------------------------------------------------------------------

    def send(self, frame: Frame) -> int:
        """Send a frame, waiting for room; return the time before it went."""
        self.sent.add(frame.arbitration_id)
        give_up_ns = self.port.now_ns() + MAX_NO_ROOM_NS
        while True:
            now_ns = self.port.now_ns()
            if self.port.send(frame):
                return now_ns
            if now_ns >= give_up_ns:
                raise Inconclusive("the line accepts no more frames")
            self._watch_host(now_ns)  # it is the line that makes us wait
            self.port.wait_until(now_ns + self.margins.gap_ns // 4)

    def send_heartbeat(
        self, control: int, advance: int = 1, major: int = PROTOCOL_MAJOR, minor: int = PROTOCOL_MINOR
    ) -> int:
        """Send HOST_HEARTBEAT; its bits and sequence are what the next ones build on. Return the time."""
        self.host_sequence = (self.host_sequence + advance) & 0xFF
        self.control = control
        message = HostHeartbeat(self.node, control, major, minor, self.host_sequence)
        body = wire.heartbeat_body(*message[1:4], message.sequence)
        time_ns = self.send(wire.sealed8(Function.HOST_HEARTBEAT, self.node, body))
        self._beat_due_ns = time_ns + HEARTBEAT_NS
        return time_ns

    def send_setpoint(self, theta_raw: int, advance: int = 1, age: int = 0) -> int:
        """Send the reference made `age` samples ago; return the time."""
        self.setpoint_sequence = (self.setpoint_sequence + advance) & 0xFF
        return self.send(self.setpoint_frame(theta_raw, self.setpoint_sequence, age))

    def setpoint_frame(self, theta_raw: int, sequence: int, age: int = 0) -> Frame:
        """Make a reference of any sequence."""
        newest = 0 if self.newest is None else self.newest.sequence
        return wire.setpoint(self.fd, self.node, theta_raw, sequence, newest - age)

    # -- in -----------------------------------------------------------------------------------------------------------

    def _on_frame(self, time_ns: int, frame: Frame) -> None:
        if frame.is_extended:
            return  # somebody else's: the protocol has no such ids
        function, node = split_id(frame.arbitration_id)
        if function not in wire.DRIVE_FUNCTIONS:
            if node == self.node and frame.arbitration_id not in self.sent:
                self.monitor.note(10, f"a frame under id {frame.arbitration_id:#05x}, which no drive sends")
            return
        if node != self.node and function != Function.IDENTITY:
            self.others.add(node)
            return
        self._on_message(time_ns, self.monitor.message(time_ns, frame))

    def _on_message(self, time_ns: int, message: Message | None) -> None:
        if isinstance(message, Feedback):
            self._halves = message
        elif isinstance(message, Timing):
            self._on_timing(time_ns, message)
        elif isinstance(message, FdFeedback):
            self._on_sample(Sample(time_ns, message.sequence, message.stamp_us, *message[1:3], *message[5:]))
        elif isinstance(message, DriveHeartbeat):
            self._on_beat(time_ns, message)
        elif isinstance(message, ParamResponse):
            self.responses.append((time_ns, message))
        elif isinstance(message, Identity):
            self.identities.append((time_ns, message))

    def _on_timing(self, time_ns: int, timing: Timing) -> None:
        """Pair with the half that came just before: which sequence it carries is for the monitor to judge."""
        half, self._halves = self._halves, None
        if half is not None:
            self._on_sample(Sample(time_ns, half.sequence, timing.stamp_us, half.theta_m, half.current, *timing[3:]))

    def _on_sample(self, sample: Sample) -> None:
        self.newest = sample
        self.state, self.fault = sample.state, sample.fault
        self.samples.append(sample)
        if len(self.samples) > MAX_RECORDED_SAMPLES:
            del self.samples[: MAX_RECORDED_SAMPLES // 2]

    def _on_beat(self, time_ns: int, beat: DriveHeartbeat) -> None:
        self.beats.append((time_ns, beat))
        if self.newest is None or time_ns - self.newest.time_ns > SILENT_NS:
            self.state, self.fault = beat.state, beat.fault
