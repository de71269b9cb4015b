"""The host's side of the protocol, without IO: frames and times in, samples and frames out.

What changes its phase is the table HOST_TRANSITIONS in `states`; this file says which report or call is which event.
`now_ns` is the host's monotonic time. Frames from outside never raise; a command that the phase does not allow does.
"""

from collections.abc import Callable
from typing import Any, Final

from firmware_protocol import codec
from firmware_protocol.frames import BROADCAST_NODE, MAX_NODE, Frame, arbitration_id
from firmware_protocol.host.config import HostConfig
from firmware_protocol.host.heartbeat import HostHeartbeatSource
from firmware_protocol.host.samples import RawBench, RawSample, SampleAssembler
from firmware_protocol.messages import (
    PROTOCOL_MAJOR,
    PROTOCOL_MINOR,
    Discover,
    DriveHeartbeat,
    DriveState,
    Estop,
    FaultReason,
    Function,
    Identity,
    ParamOp,
    ParamRequest,
    ParamResponse,
    fault_words,
)
from firmware_protocol.states import HOST_COMMANDS, HOST_TRANSITIONS, MAX_SEQUENCE_ADVANCE, HostEvent, HostPhase

__all__ = ["HostConfig", "HostMachine", "HostPhase", "RawBench", "RawSample"]

STREAM_SILENCE_NS: Final = 50_000_000  # samples are the better witness of the state until they have been away so long
MAX_QUEUED_RESPONSES: Final = 64

HOST_COUNTERS: Final = (
    "not_for_us",
    "stale_heartbeat",
    "unknown_fault",
    "lost_setpoints",
    "rejected_by_drive",
    "drive_gone",
    "enable_timeout",
    "dropped_out",
    "heartbeats_sent",
    "setpoints_sent",
    "responses_overflow",
)

_MASK32: Final = (1 << 32) - 1
_HALF32: Final = 1 << 31
# Members under names of their own: a look-up through the class costs more than all else in the cyclic path.
_RUNNING: Final = HostPhase.RUNNING
_ENABLING: Final = HostPhase.ENABLING
_OPERATIONAL: Final = int(DriveState.OPERATIONAL)
_STATES: Final = tuple(DriveState)
_SAW: Final = (HostEvent.SAW_DISABLED, HostEvent.SAW_ARMED, HostEvent.SAW_OPERATIONAL, HostEvent.SAW_FAULT)
_FAULTS: Final = {int(reason): reason for reason in FaultReason}
_CONNECTED: Final = frozenset({HostPhase.READY, HostPhase.ENABLING, HostPhase.RUNNING, HostPhase.FAULT})

_Routes = dict[int, Callable[[Any, int], None]]


class HostMachine:
    """One host and its drive. `phase` says what may be done, `refusal` why not, `counters` what went missing."""

    def __init__(self, config: HostConfig) -> None:
        self.config = config
        self.node = config.node
        self.phase = HostPhase.DISCONNECTED
        self.refusal = ""
        self.identity: Identity | None = None
        self.drive_state: DriveState | None = None
        self.fault = FaultReason.NONE
        self.counters = dict.fromkeys(HOST_COUNTERS, 0)
        self._decoder = codec.Decoder(self.counters)
        self._samples = SampleAssembler(self.counters)
        self._responses: list[ParamResponse] = []
        self._routes: _Routes = {}
        self.setpoint_sequence = 0  # of the last reference handed out
        self._discover_due_ns = 0
        self._heard_ns = 0
        self._enabling_since_ns: int | None = None
        self._drive_heartbeat: DriveHeartbeat | None = None
        self._heartbeats = HostHeartbeatSource(config.heartbeat_period_ns)
        self._begin_session()

    def connect(self, now_ns: int) -> None:
        """Start to ask for the drive; ValueError while connected."""
        self._command(HostEvent.CONNECT)
        if self.phase is not HostPhase.IDENTIFYING:
            self._discover_due_ns = now_ns
            self.refusal = ""
            self._fire(HostEvent.CONNECT)

    def enable(self) -> None:
        """Ask for torque; ValueError unless READY, ENABLING or RUNNING."""
        self._command(HostEvent.ENABLE)
        self._fire(HostEvent.ENABLE)

    def disable(self) -> None:
        """Ask for no torque; allowed in every phase."""
        self._fire(HostEvent.DISABLE)

    def reset_fault(self) -> None:
        """Ask the drive to forget its fault, by one pulse; ValueError unless in FAULT."""
        self._command(HostEvent.RESET)
        self._heartbeats.request_reset()

    def fault_words(self) -> str:
        """Return the drive's fault in words."""
        return fault_words(self.fault)

    def estop_frame(self) -> Frame:
        """Return the ESTOP to send at once, in whatever phase; to all while the node is not known."""
        return codec.encode(Estop(self.node))

    def read_parameter(self, number: int) -> Frame:
        """Return the request to send; the answer comes by `take_responses`. ValueError while the node is unknown."""
        return codec.encode(ParamRequest(self.node, ParamOp.READ, number, 0))

    def write_parameter(self, number: int, value: int) -> Frame:
        """Return the request to send; the answer comes by `take_responses`. ValueError while the node is unknown."""
        return codec.encode(ParamRequest(self.node, ParamOp.WRITE, number, value))

    def take_samples(self) -> list[RawSample]:
        """Hand over the samples since the last call, oldest first."""
        return self._samples.take_samples()

    def take_bench(self) -> list[RawBench]:
        """Hand over the bench readings since the last call, oldest first."""
        return self._samples.take_bench()

    def take_responses(self) -> list[ParamResponse]:
        """Hand over the parameter answers since the last call, oldest first."""
        responses, self._responses = self._responses, []
        return responses

    def setpoint(self, theta_m_ref_raw: int) -> Frame | None:
        """Return the reference to send (wrapped or not), None where the phase forbids one.

        It goes out as computed from the newest sample taken: who takes none any more keeps no motor alive. Until the
        drive says that it follows, the measured angle itself goes out instead: enabling moves nothing.
        """
        taken = self._samples.taken
        if taken is None:
            return None
        if self.phase is not _RUNNING:
            if not self._heartbeats.enabling or self.drive_state is not DriveState.ARMED:
                return None
            theta_m_ref_raw = taken.theta_m
        sequence = self.setpoint_sequence = (self.setpoint_sequence + 1) & 0xFF
        wire = (theta_m_ref_raw + _HALF32 & _MASK32) - _HALF32
        self.counters["setpoints_sent"] += 1
        return codec.encode_setpoint(self.node, wire, sequence, taken.sequence, self.config.fd)

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Take one frame from the bus."""
        handler = self._routes.get(frame[0])
        if handler is None or frame[3]:  # an extended id
            self.counters["not_for_us"] += 1
            return
        message = self._decoder.decode(frame)
        if message is not None:
            handler(message, now_ns)

    def poll(self, now_ns: int) -> list[Frame]:
        """Let time pass; return DISCOVER or HOST_HEARTBEAT when due."""
        phase = self.phase
        if phase is not _RUNNING:
            if phase is HostPhase.IDENTIFYING:
                return self._discover(now_ns)
            if phase not in _CONNECTED:
                return []
        if now_ns - self._heard_ns >= self.config.drive_timeout_ns:
            self._lose_drive()
            return []
        if phase is _ENABLING:
            self._advance_enabling(now_ns)
        heartbeat = self._heartbeats.poll(self.node, now_ns)
        if heartbeat is None:
            return []
        self.counters["heartbeats_sent"] += 1
        return [heartbeat]

    def _discover(self, now_ns: int) -> list[Frame]:
        if now_ns < self._discover_due_ns:
            return []
        self._discover_due_ns = now_ns + self.config.discover_period_ns
        return [codec.encode(Discover(self.config.node))]

    def _command(self, event: HostEvent) -> None:
        if self.phase not in HOST_COMMANDS[event]:
            raise ValueError(f"{event.name} is not possible while {self.phase.name}")

    def _fire(self, event: HostEvent) -> None:
        target = HOST_TRANSITIONS[self.phase].get(event)
        if target is None:
            return
        was_connected = self.phase in _CONNECTED
        self.phase = target
        self._enabling_since_ns = None
        if target is not HostPhase.RUNNING:
            self._heartbeats.release()
        if target not in _CONNECTED:
            self._begin_session()
        elif not was_connected:
            self._routes = self._connected_routes()

    def _begin_session(self) -> None:
        """Forget everything about the drive but the words of a refusal."""
        self.node = self.config.node
        self.identity = None
        self.drive_state = None
        self.fault = FaultReason.NONE
        self._samples.reset()
        self._drive_heartbeat = None
        self._heartbeats.begin_session()
        self._routes = {}
        if self.phase is HostPhase.IDENTIFYING:
            nodes = range(1, MAX_NODE + 1) if self.node == BROADCAST_NODE else (self.node,)
            self._routes = {arbitration_id(Function.IDENTITY, node): self._on_identity for node in nodes}

    def _connected_routes(self) -> _Routes:
        routes: dict[Function, Callable[[Any, int], None]] = {
            Function.DRIVE_HEARTBEAT: self._on_drive_heartbeat,
            Function.BENCH_SENSOR: self._samples.on_bench,
            Function.PARAM_RESPONSE: self._on_response,
            Function.IDENTITY: self._on_identity,
        }
        if self.config.fd:
            routes[Function.FD_FEEDBACK] = self._on_fd_feedback
        else:
            routes[Function.FEEDBACK] = self._on_feedback
            routes[Function.TIMING] = self._on_timing
        return {arbitration_id(function, self.node): handler for function, handler in routes.items()}

    def _lose_drive(self) -> None:
        self.counters["drive_gone"] += 1
        self._fire(HostEvent.GONE)

    def _advance_enabling(self, now_ns: int) -> None:
        if self._enabling_since_ns is None:
            self._enabling_since_ns = now_ns
        if now_ns - self._enabling_since_ns >= self.config.enable_timeout_ns:
            self.counters["enable_timeout"] += 1
            self._fire(HostEvent.ENABLE_EXPIRED)
        elif self.drive_state is DriveState.DISABLED:
            self._heartbeats.raise_enable()

    def _on_feedback(self, message: Any, now_ns: int) -> None:
        sample = self._samples.on_feedback(message, now_ns)
        if sample is not None or self._samples.restarted:
            self._saw_sample(sample)

    def _on_timing(self, message: Any, now_ns: int) -> None:
        self._saw_sample(self._samples.on_timing(message, now_ns))

    def _on_fd_feedback(self, message: Any, now_ns: int) -> None:
        self._saw_sample(self._samples.on_fd_feedback(message, now_ns))

    def _saw_sample(self, sample: RawSample | None) -> None:
        if sample is not None:
            _, _, _, _, state, fault, _, self._heard_ns = sample
            if self.phase is not _RUNNING or state != _OPERATIONAL or fault:  # else there is no news
                self._see(state, fault)
        elif self._samples.restarted:
            self._lose_drive()

    def _see(self, state: int, fault: int) -> None:
        self.drive_state = _STATES[state]
        self.fault = _FAULTS.get(fault, FaultReason.INTERNAL)
        if fault not in _FAULTS:
            self.counters["unknown_fault"] += 1
        if self.phase is HostPhase.ENABLING and not self._heartbeats.enabling and state != DriveState.FAULT:
            return  # what is left of an earlier enabling is no answer to this one
        if self.phase is HostPhase.RUNNING and state == DriveState.DISABLED:
            self.counters["dropped_out"] += 1
        self._fire(_SAW[state])

    def _on_drive_heartbeat(self, message: DriveHeartbeat, now_ns: int) -> None:
        last = self._drive_heartbeat
        if last is not None:
            if not 1 <= (message.sequence - last.sequence) & 0xFF <= MAX_SEQUENCE_ADVANCE:
                self.counters["stale_heartbeat"] += 1
                return
            self.counters["lost_setpoints"] += (message.setpoints_lost - last.setpoints_lost) & 0xFF
        self._drive_heartbeat = message
        self._heard_ns = now_ns
        self.counters["rejected_by_drive"] = message.rejected
        if message.protocol_major != PROTOCOL_MAJOR:
            self._refuse(_version_words(message.node, message.protocol_major, message.protocol_minor))
            return
        newest = self._samples.newest
        if newest is None or now_ns - newest.received_ns >= STREAM_SILENCE_NS:
            if message.state < len(_STATES):
                self._see(message.state, message.fault)
            else:
                self.counters["unknown_state"] += 1

    def _on_identity(self, message: Identity, now_ns: int) -> None:
        expected = self.config.serial_number if self.identity is None else self.identity.serial_number
        if message.protocol_major != PROTOCOL_MAJOR:
            self._refuse(_version_words(message.node, message.protocol_major, message.protocol_minor))
        elif expected is not None and message.serial_number != expected:
            self._refuse(
                f"node {message.node} is drive {message.serial_number:#014x}, but {expected:#014x} is expected: "
                "check the wiring and the node ids"
            )
        elif self.phase is HostPhase.IDENTIFYING:
            self.node = message.node
            self.identity = message
            self._heard_ns = now_ns
            self._fire(HostEvent.IDENTIFIED)

    def _refuse(self, words: str) -> None:
        self.refusal = words
        self._fire(HostEvent.MISFIT)

    def _on_response(self, message: ParamResponse, now_ns: int) -> None:
        self._heard_ns = now_ns
        self._responses.append(message)
        if len(self._responses) > MAX_QUEUED_RESPONSES:
            del self._responses[0]
            self.counters["responses_overflow"] += 1


def _version_words(node: int, major: int, minor: int) -> str:
    return (
        f"drive at node {node} has protocol {major}.{minor}, this host has {PROTOCOL_MAJOR}.{PROTOCOL_MINOR}: "
        f"the major version must be the same, so update the {'host' if major > PROTOCOL_MAJOR else 'drive'}"
    )
