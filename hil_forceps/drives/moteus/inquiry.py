"""A moteus, asked by a query of registers: it writes no mode, so it commands nothing and feeds no watchdog."""

from typing import Final

from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState
from hil_forceps.drives.inquiry import Questions, Said
from hil_forceps.drives.moteus import messages as wire
from hil_forceps.drives.moteus.messages import Mode

_IDENTITY: Final = 0  # the one question
_STATES: Final = {
    Mode.STOPPED: DriveState.DISABLED,
    Mode.FAULT: DriveState.FAULT,
    Mode.POSITION: DriveState.OPERATIONAL,
}


class MoteusInquiry:
    """One controller; an `Inquiry`."""

    def __init__(self, node: int) -> None:
        self._reply_id = wire.reply_id(node)
        self._questions = Questions({_IDENTITY: wire.identify(node)})
        self._feedback: wire.Feedback | None = None
        self._identity: wire.Identity | None = None

    def poll(self, now_ns: int) -> list[Frame]:
        """Return the query."""
        return self._questions.poll(now_ns)

    def receive(self, frame: Frame, now_ns: int) -> None:  # noqa: ARG002 - nothing here depends on when
        """Take one frame."""
        is_ours = frame.arbitration_id == self._reply_id and frame.is_extended == wire.is_extended(self._reply_id)
        feedback = wire.parse_feedback(frame.data) if is_ours and frame.is_fd else None
        if feedback is None:
            return
        self._feedback = feedback
        identity = wire.parse_identity(frame.data)
        if identity is not None:
            self._identity = identity
        if identity is not None or wire.refused_register(frame.data) is not None:
            self._questions.answered(_IDENTITY)

    def said(self) -> Said | None:
        """Return what the registers say."""
        feedback, identity = self._feedback, self._identity
        if feedback is None:
            return None
        # Any mode but these may move or damp: what isn't known to be without torque has some.
        said = Said(state=_STATES.get(Mode(feedback.mode), DriveState.ARMED) if feedback.mode in set(Mode) else None)
        is_latched = feedback.mode in {Mode.FAULT, Mode.TIMEOUT}
        said.fault = wire.fault_words(feedback.mode, feedback.fault) if is_latched else ""
        if identity is None:
            said.misfit = "its firmware is too old; flash a newer one with moteus_tool --flash"
        else:
            said.firmware = f"firmware {wire.version_words(identity.firmware)}, registers {identity.register_map}"
            if identity.register_map != wire.REGISTER_MAP:
                said.misfit = (
                    f"register map version {wire.REGISTER_MAP} is supported; flash a firmware that has it with "
                    "moteus_tool --flash"
                )
        return said

    def is_complete(self) -> bool:
        """Tell whether the query was answered or given up."""
        return self._questions.is_over
