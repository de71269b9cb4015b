"""The drive's side of the protocol, without IO: frames, samples and times in, frames and a reference out.

What changes its state is the table DRIVE_TRANSITIONS in `states`; this file says which frame or delay is which event.

The owner calls `poll` at least once a millisecond and before it uses `reference_raw`; `sample` at each measurement;
`receive` for each frame. `now_us` comes from the clock that stamps the samples, never runs backwards, and may wrap.
"""

from collections.abc import Callable
from typing import Any, Final

from firmware_protocol import codec
from firmware_protocol.drive.config import DriveConfig
from firmware_protocol.drive.discovery import identity_delay_us
from firmware_protocol.drive.parameter_values import ParameterStore
from firmware_protocol.frames import BROADCAST_NODE, MAX_NODE, Frame, arbitration_id
from firmware_protocol.messages import (
    PROTOCOL_MAJOR,
    PROTOCOL_MINOR,
    AssignNode,
    Control,
    DriveHeartbeat,
    DriveState,
    FaultReason,
    Function,
    HostHeartbeat,
    Identity,
    ParamOp,
    ParamRequest,
    ParamResponse,
    Setpoint,
)
from firmware_protocol.parameters import Index
from firmware_protocol.scales import ANGLE_MODULUS, unwrap, wrap_int32
from firmware_protocol.states import DRIVE_REASONS, DRIVE_TRANSITIONS, MAX_SEQUENCE_ADVANCE, DriveEvent

__all__ = ["DriveConfig", "DriveMachine"]

MAX_STEP_FACTOR: Final = 8  # steps that lost setpoints may add to the step limit

REJECTIONS: Final = (
    *codec.DECODE_COUNTERS,
    "not_enabled",
    "setpoint_stale",
    "sample_old",
    "sample_future",
    "heartbeat_stale",
    "param_refused",
    "assign_refused",
)
COUNTERS: Final = (*REJECTIONS, "not_for_us", "setpoints_accepted", "setpoints_lost", "faults")

# Members under names of their own: a look-up through the class costs more than all else in the cyclic path.
_DISABLED: Final = DriveState.DISABLED
_ARMED: Final = DriveState.ARMED
_OPERATIONAL: Final = DriveState.OPERATIONAL
_REFERENCE: Final = DriveEvent.REFERENCE
_MASK32: Final = (1 << 32) - 1
_HALF32: Final = 1 << 31
_ALL_CONTROLS: Final = 0xFF
_ENABLE: Final = int(Control.ENABLE)
_RESET: Final = int(Control.FAULT_RESET)
_CURRENT_MIN: Final = -(1 << 15)
_CURRENT_MAX: Final = (1 << 15) - 1
_REJECTED_MAX: Final = 0xFFFF


class DriveMachine:
    """One drive. `state`, `fault` and `reference_raw` are what the motor obeys; `counters` says what was dropped."""

    def __init__(self, config: DriveConfig) -> None:
        self.config = config
        self.state = DriveState.DISABLED
        self.fault = FaultReason.NONE
        self.reference_raw: int | None = None  # near the measured angle; None: the motor gets no current
        self.counters = dict.fromkeys(COUNTERS, 0)
        self._decoder = codec.Decoder(self.counters)
        self._values = ParameterStore(config)
        self._adopt_parameters()
        self._sequence = -1  # of the newest sample; negative until there is one
        self._setpoint_sequence = 0
        self._reference_wire = 0
        self._fed_us = self._armed_us = self._host_us = self._heartbeat_us = 0
        self._host_present = False
        self._host_sequence = 0
        # Taken as high until a host has shown them low: a drive that restarts under a running host stays put.
        self._levels = _ALL_CONTROLS
        self._heartbeat_sequence = 0
        self._announce = True  # a state not yet told by a heartbeat
        self._identity_due_us: int | None = None
        self._discoveries = 0
        self._take_node(config.node)

    @property
    def node(self) -> int:
        """The node id in force."""
        return self._node

    def receive(self, frame: Frame, now_us: int, theta_m_raw: int) -> list[Frame]:
        """Take one frame; `theta_m_raw` is the angle now, wrapped or not. Return the answers to send."""
        handler = self._handlers.get(frame[0])
        if handler is None or frame[3]:  # an extended id
            self.counters["not_for_us"] += 1
            return []
        self._expire(now_us)
        message = self._decoder.decode(frame)
        if message is None:
            return []
        return handler(message, now_us, theta_m_raw)

    def poll(self, now_us: int) -> list[Frame]:
        """Let time pass: expire what is due, return heartbeat and IDENTITY when due."""
        self._expire(now_us)
        frames = []
        if self._announce or (now_us - self._heartbeat_us) & _MASK32 >= self._heartbeat_period_us:
            frames.append(self._heartbeat(now_us))
        if self._identity_due_us is not None and (now_us - self._identity_due_us) & _MASK32 < _HALF32:
            self._identity_due_us = None
            frames.append(self._identity())
        return frames

    def sample(self, stamp_us: int, theta_m_raw: int, current_raw: int) -> list[Frame]:
        """Number one measurement and return its frames; a current beyond 16 bits saturates."""
        sequence = self._sequence = (self._sequence + 1) & 0xFF
        theta = (theta_m_raw + _HALF32 & _MASK32) - _HALF32
        current = current_raw
        if not _CURRENT_MIN <= current <= _CURRENT_MAX:
            current = min(max(current, _CURRENT_MIN), _CURRENT_MAX)
        stamp, echo, node = stamp_us & _MASK32, self._setpoint_sequence, self._node
        if self.config.fd:
            return [codec.encode_fd_feedback(node, theta, current, stamp, sequence, echo, self.state, self.fault)]
        return [
            codec.encode_feedback(node, theta, current, sequence),
            codec.encode_timing(node, stamp, sequence, echo, self.state, self.fault),
        ]

    def trip(self, reason: FaultReason) -> None:
        """Fault for a reason of the device's own (overcurrent, encoder ...); ValueError for NONE."""
        if reason is FaultReason.NONE:
            raise ValueError("a trip needs a reason")
        self._fire(DriveEvent.TRIP, FaultReason(reason))

    def rejected(self) -> int:
        """Count the frames for this drive that it dropped."""
        return sum(self.counters[name] for name in REJECTIONS)

    def _fire(self, event: DriveEvent, reason: FaultReason | None = None) -> None:
        target = DRIVE_TRANSITIONS[self.state].get(event)
        if target is None:
            return
        self.state = target
        self._announce = True
        if target is not DriveState.OPERATIONAL:
            self.reference_raw = None
        self.fault = FaultReason.NONE
        if target is DriveState.FAULT:
            self.fault = DRIVE_REASONS[event] if reason is None else reason
            self.counters["faults"] += 1

    def _expire(self, now_us: int) -> None:
        state = self.state
        if state is _OPERATIONAL:
            if (now_us - self._fed_us) & _MASK32 >= self._watchdog_timeout_us:
                self._fire(DriveEvent.WATCHDOG_EXPIRED)
        elif state is _ARMED and (now_us - self._armed_us) & _MASK32 >= self._arm_timeout_us:
            self._fire(DriveEvent.ARM_EXPIRED)
        if self._host_present and (now_us - self._host_us) & _MASK32 >= self._host_timeout_us:
            self._forget_host()
            self._fire(DriveEvent.HOST_LOST)

    def _forget_host(self) -> None:
        self._host_present = False
        self._levels = _ALL_CONTROLS

    def _on_setpoint(self, message: Setpoint, now_us: int, theta_m_raw: int) -> list[Frame]:
        advance = self._freshness(message)
        if advance:
            event = self._judge_reference(message.theta_m_ref, advance, theta_m_raw)
            if event is not _REFERENCE or self.state is _ARMED:  # a reference changes no other state
                self._fire(event)
            if event is _REFERENCE:
                self._fed_us = now_us
                self._setpoint_sequence = message.sequence
                self._reference_wire = message.theta_m_ref
                self.reference_raw = unwrap(message.theta_m_ref, theta_m_raw, ANGLE_MODULUS)
                self.counters["setpoints_accepted"] += 1
                if advance > 1:
                    self.counters["setpoints_lost"] += advance - 1
        return []

    def _freshness(self, message: Setpoint) -> int:
        """Return by how much the sequence advanced (1 for the first of a session), 0 when not fresh or not wanted."""
        state = self.state
        if state is not _OPERATIONAL and state is not _ARMED:
            return self._drop("not_enabled")
        age = (self._sequence - message.sample_sequence) & 0xFF
        if self._sequence < 0 or age > MAX_SEQUENCE_ADVANCE:
            return self._drop("sample_future")
        if age > self._max_sample_age:
            return self._drop("sample_old")
        if state is _ARMED:
            return 1
        advance = (message.sequence - self._setpoint_sequence) & 0xFF
        return advance if 1 <= advance <= MAX_SEQUENCE_ADVANCE else self._drop("setpoint_stale")

    def _judge_reference(self, reference: int, advance: int, theta_m_raw: int) -> DriveEvent:
        if not self._theta_min_raw <= reference <= self._theta_max_raw:
            return DriveEvent.REFERENCE_OUTSIDE
        if self.state is _ARMED:
            near = abs(wrap_int32(reference - theta_m_raw)) <= self._reference_tolerance_raw
            return _REFERENCE if near else DriveEvent.REFERENCE_OFF
        step = abs((reference - self._reference_wire + _HALF32 & _MASK32) - _HALF32)
        if step > self._max_step_raw * (advance if advance < MAX_STEP_FACTOR else MAX_STEP_FACTOR):
            return DriveEvent.REFERENCE_JUMP
        return _REFERENCE

    def _on_host_heartbeat(self, message: HostHeartbeat, now_us: int, _: int) -> list[Frame]:
        if self._host_present and not 1 <= (message.sequence - self._host_sequence) & 0xFF <= MAX_SEQUENCE_ADVANCE:
            self._drop("heartbeat_stale")
            return []
        self._host_present = True
        self._host_us = now_us
        self._host_sequence = message.sequence
        rising = message.control & ~self._levels
        self._levels = message.control
        if not message.control & _ENABLE:
            self._fire(DriveEvent.DISABLE)
        elif message.protocol_major != PROTOCOL_MAJOR:
            if rising & _ENABLE or self.state is not _DISABLED:
                self._fire(DriveEvent.VERSION_MISFIT)
        elif rising & _ENABLE and self.state is _DISABLED:
            self._armed_us = now_us
            self._fire(DriveEvent.ENABLE)
        if rising & _RESET:  # after ENABLE, so one heartbeat that raises both resets and does not enable
            self._fire(DriveEvent.RESET)
        return []

    def _on_estop(self, *_: object) -> list[Frame]:
        self._fire(DriveEvent.ESTOP)
        return []

    def _on_param_request(self, message: ParamRequest, _now_us: int, _theta: int) -> list[Frame]:
        self._values.put(Index.REJECTED, self.rejected())
        self._values.put(Index.SETPOINTS_ACCEPTED, self.counters["setpoints_accepted"])
        self._values.put(Index.SETPOINTS_LOST, self.counters["setpoints_lost"])
        number = message.parameter
        result, held = self._values.execute(message.op, number, message.value, self.state is _DISABLED)
        if result is not ParamOp.OK:
            self._drop("param_refused")
        self._adopt_parameters()
        return [codec.encode(ParamResponse(self._node, result, number, held))]

    def _on_discover(self, _message: object, now_us: int, _theta: int) -> list[Frame]:
        if self._identity_due_us is None:
            delay_us = identity_delay_us(self.config.serial_number, self._discoveries)
            self._discoveries += 1
            self._identity_due_us = now_us + delay_us
        return []

    def _on_assign_node(self, message: AssignNode, _now_us: int, _theta: int) -> list[Frame]:
        if message.serial_number != self.config.serial_number:
            self.counters["not_for_us"] += 1
            return []
        if self.state is not _DISABLED or not 1 <= message.new_node <= MAX_NODE:
            self._drop("assign_refused")
            return []
        self._take_node(message.new_node)
        self._forget_host()
        return [self._identity()]

    def _identity(self) -> Frame:
        return codec.encode(Identity(self._node, self.config.serial_number, PROTOCOL_MAJOR, PROTOCOL_MINOR))

    def _heartbeat(self, now_us: int) -> Frame:
        self._announce = False
        self._heartbeat_us = now_us
        sequence, self._heartbeat_sequence = self._heartbeat_sequence, (self._heartbeat_sequence + 1) & 0xFF
        rejected = min(self.rejected(), _REJECTED_MAX)
        lost = self.counters["setpoints_lost"] & 0xFF
        versions = (PROTOCOL_MAJOR, PROTOCOL_MINOR)
        return codec.encode(DriveHeartbeat(self._node, self.state, self.fault, *versions, rejected, lost, sequence))

    def _take_node(self, node: int) -> None:
        self._node = node
        self._values.put(Index.NODE, node)
        setpoint = Function.FD_SETPOINT if self.config.fd else Function.SETPOINT
        self._handlers: dict[int, Callable[[Any, int, int], list[Frame]]] = {
            arbitration_id(setpoint, node): self._on_setpoint,
            arbitration_id(Function.HOST_HEARTBEAT, node): self._on_host_heartbeat,
            arbitration_id(Function.PARAM_REQUEST, node): self._on_param_request,
            arbitration_id(Function.ASSIGN_NODE, BROADCAST_NODE): self._on_assign_node,
        }
        for address in (BROADCAST_NODE, node):
            self._handlers[arbitration_id(Function.ESTOP, address)] = self._on_estop
            self._handlers[arbitration_id(Function.DISCOVER, address)] = self._on_discover

    def _adopt_parameters(self) -> None:
        values = self._values
        self._theta_min_raw = values[Index.THETA_MIN]
        self._theta_max_raw = values[Index.THETA_MAX]
        self._max_step_raw = values[Index.MAX_STEP]
        self._reference_tolerance_raw = values[Index.REFERENCE_TOLERANCE]
        self._watchdog_timeout_us = values[Index.WATCHDOG_TIMEOUT]
        self._host_timeout_us = values[Index.HOST_HEARTBEAT_TIMEOUT]
        self._heartbeat_period_us = values[Index.HEARTBEAT_PERIOD]
        self._arm_timeout_us = values[Index.ARM_TIMEOUT]
        self._max_sample_age = values[Index.MAX_SAMPLE_AGE]

    def _drop(self, reason: str) -> int:
        self.counters[reason] += 1
        return 0
