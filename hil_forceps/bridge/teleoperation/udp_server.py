"""References over UDP: the socket that the loop looks at once a tick, and the answers that it sends after it.

Nothing here waits. At most `MAX_DATAGRAMS` are taken in a tick, and what the system keeps for the socket is small: a
flood costs little time and makes nothing old, it only pushes out. Whoever lacks the token is not answered.
"""

import socket
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

from hil_forceps.bridge.axis import Axis
from hil_forceps.bridge.live.topics import STAGES
from hil_forceps.bridge.teleoperation.datagrams import (
    REFERENCE_BYTES,
    EstimateDatagram,
    ReferenceDatagram,
    Verdict,
    has_tag,
    pack_estimate,
    parse_reference,
)
from hil_forceps.bridge.teleoperation.reference_input import ReferenceInput
from hil_forceps.control.gate import GateState
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.plant import PlantParameters

MAX_DATAGRAMS: Final = 32
RECEIVE_BUFFER_BYTES: Final = 1 << 14
NOT_HEARD: Final = 255
_STAGE_CODES: Final = {stage: code for code, stage in enumerate(STAGES)}
_GATE_CODES: Final = {state: code for code, state in enumerate(GateState)}


class _Pending(NamedTuple):
    """A datagram that wants an answer."""

    reference: ReferenceDatagram
    verdict: Verdict
    sender: Any


class UdpReferences:
    """References for all axes of a service on one port. UserError where the address can't be had."""

    def __init__(
        self,
        inputs: Sequence[ReferenceInput],
        plants: Sequence[PlantParameters],
        address: tuple[str, int],
        token: bytes,
    ) -> None:
        self.inputs = tuple(inputs)
        self.counters = {"malformed": 0, "bad_tag": 0, "no_such_axis": 0, "not_answered": 0}
        self._plants = tuple(plants)
        self._token = token
        self._pending: list[_Pending] = []
        family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
            self._socket.bind(address)
            self._socket.setblocking(False)
        except OSError as error:
            self._socket.close()
            raise UserError(
                f"--references {address[0]}:{address[1]}: can't be opened: {error.strerror}; use another port"
            ) from error
        self.port = int(self._socket.getsockname()[1])

    def receive(self, now_ns: int) -> None:
        """Take what has come since the last call."""
        try:
            for _ in range(MAX_DATAGRAMS):
                data, sender = self._socket.recvfrom(REFERENCE_BYTES + 1)
                self._take(data, sender, now_ns)
        except OSError:  # nothing more; or an answer before reached nobody
            return

    def reply(self, axes: Sequence[Axis]) -> None:
        """Answer each reference that was taken, by what the tick made of it."""
        for reference, verdict, sender in self._pending:
            answer = pack_estimate(self._estimate(reference, verdict, axes), self._token)
            try:
                self._socket.sendto(answer, sender)
            except OSError:
                self.counters["not_answered"] += 1
        self._pending.clear()

    def close(self) -> None:
        """Release the socket; safe to call twice."""
        self._socket.close()

    def _take(self, data: bytes, sender: Any, now_ns: int) -> None:
        reference = parse_reference(data)
        if reference is None:
            self.counters["malformed"] += 1
        elif not has_tag(data, self._token):
            self.counters["bad_tag"] += 1
        elif reference.axis >= len(self.inputs):
            self.counters["no_such_axis"] += 1
            self._pending.append(_Pending(reference, Verdict.NO_SUCH_AXIS, sender))
        else:
            verdict = self.inputs[reference.axis].take(reference, sender, now_ns)
            self._pending.append(_Pending(reference, verdict, sender))

    def _estimate(self, reference: ReferenceDatagram, verdict: Verdict, axes: Sequence[Axis]) -> EstimateDatagram:
        place = reference.axis if reference.axis < len(axes) else 0
        axis, taken, plant = axes[place], self.inputs[place], self._plants[place]
        pipeline, state = axis.pipeline, axis.drive.drive_state
        newest = pipeline.newest
        wound_m = plant.motor_pulley_radius_m * pipeline.sample.theta_m_rad
        return EstimateDatagram(
            session=taken.session,
            axis=reference.axis,
            sequence=reference.sequence,
            stamp_ns=reference.stamp_ns,
            verdict=verdict,
            sample_ns=0 if newest is None else newest.received_ns,
            theta_j_rad=(wound_m - pipeline.estimate.elongation_m) / plant.jaw_pulley_radius_m,
            tau_w_N_m=pipeline.estimate.tau_w_N_m,
            theta_j_ref_rad=taken.theta_j_ref_rad,
            stage=_STAGE_CODES[axis.course.stage],
            drive_state=NOT_HEARD if state is None else int(state),
            gate_state=_GATE_CODES[pipeline.gate.state],
            input_state=int(taken.state),
        )
