"""A drive of the project's own protocol, asked by DISCOVER and by reading parameters.

Neither feeds its watchdog or changes anything (HFP-122, HFP-150), and nothing but DISCOVER goes out before an IDENTITY
that fits (HFP-070).
"""

from typing import Final

from firmware_protocol import codec
from firmware_protocol.frames import Frame
from firmware_protocol.messages import (
    PROTOCOL_MAJOR,
    Discover,
    DriveHeartbeat,
    DriveState,
    Identity,
    ParamOp,
    ParamRequest,
    ParamResponse,
    fault_words,
)
from firmware_protocol.parameters import Index
from firmware_protocol.scales import ANGLE_LSB_RAD
from hil_forceps.drives.inquiry import ASK_AGAIN_NS, Questions, Said

_PARAMETERS: Final = (
    Index.FD,
    Index.THETA_MIN,
    Index.THETA_MAX,
    Index.WATCHDOG_TIMEOUT,
    Index.SAMPLE_PERIOD,
    Index.COUNTS_PER_REV,
    Index.TORQUE_CONSTANT,
)


class NativeInquiry:
    """One node; an `Inquiry`."""

    def __init__(self, node: int) -> None:
        self._node = node
        self._decoder = codec.Decoder()
        self._identity: Identity | None = None
        self._heartbeat: DriveHeartbeat | None = None
        self._discovered_ns: int | None = None
        self._values: dict[int, int] = {}
        self._questions = Questions(
            {each: codec.encode(ParamRequest(node, ParamOp.READ, each, 0)) for each in _PARAMETERS}
        )

    def poll(self, now_ns: int) -> list[Frame]:
        """Return DISCOVER, and behind an identity that fits the next parameter's request."""
        if self._identity is None:
            if self._discovered_ns is not None and now_ns - self._discovered_ns < ASK_AGAIN_NS:
                return []
            self._discovered_ns = now_ns
            return [codec.encode(Discover(self._node))]
        return self._questions.poll(now_ns) if self._fits() else []

    def receive(self, frame: Frame, now_ns: int) -> None:  # noqa: ARG002 - nothing here depends on when
        """Take one frame."""
        message = None if frame.is_extended else self._decoder.decode(frame)
        if message is None or message.node != self._node:
            return
        if isinstance(message, Identity):
            self._identity = message
        elif isinstance(message, DriveHeartbeat):
            self._heartbeat = message
        elif isinstance(message, ParamResponse):
            if message.op == ParamOp.OK:
                self._values[message.parameter] = message.value
            self._questions.answered(message.parameter)

    def said(self) -> Said | None:
        """Return what the drive has said."""
        heard = self._identity or self._heartbeat
        if heard is None:
            return None
        said = Said(firmware=f"protocol {heard.protocol_major}.{heard.protocol_minor}")
        if not self._fits():
            older = "host" if heard.protocol_major > PROTOCOL_MAJOR else "drive"
            said.misfit = f"this host has protocol version {PROTOCOL_MAJOR}; update the {older}"
        if self._heartbeat is not None:
            said.fault = fault_words(self._heartbeat.fault) if self._heartbeat.fault else ""
            if self._heartbeat.state in set(DriveState):
                said.state = DriveState(self._heartbeat.state)
        self._tell_parameters(said)
        return said

    def is_complete(self) -> bool:
        """Tell whether identity, heartbeat and all parameters came."""
        return (
            self._heartbeat is not None and self._identity is not None and (self._questions.is_over or not self._fits())
        )

    def _fits(self) -> bool:
        return all(each is None or each.protocol_major == PROTOCOL_MAJOR for each in (self._identity, self._heartbeat))

    def _tell_parameters(self, said: Said) -> None:
        values = self._values
        said.counts_per_rev = values.get(Index.COUNTS_PER_REV)
        if Index.SAMPLE_PERIOD in values:
            said.sample_period_s = values[Index.SAMPLE_PERIOD] * 1e-6
        if Index.WATCHDOG_TIMEOUT in values:
            said.watchdog_s = values[Index.WATCHDOG_TIMEOUT] * 1e-6
        if Index.TORQUE_CONSTANT in values:
            said.torque_constant_N_m_per_A = values[Index.TORQUE_CONSTANT] * 1e-9
        if Index.FD in values:
            said.is_fd = bool(values[Index.FD])
        if Index.THETA_MIN in values and Index.THETA_MAX in values:
            said.position_range_rad = (
                values[Index.THETA_MIN] * ANGLE_LSB_RAD,
                values[Index.THETA_MAX] * ANGLE_LSB_RAD,
            )
