"""A VESC, asked for its values: a request doesn't feed its timeout.

It takes the mean current since the last answer, which whoever else asks then misses. How long the timeout is, a VESC
tells nobody; the service tries it at each start (`timeout_trial.py`), by commands, so not here.
"""

from typing import Final

from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState
from hil_forceps.drives.inquiry import Questions, Said
from hil_forceps.drives.vesc import messages as wire
from hil_forceps.drives.vesc.answers import Answers
from hil_forceps.drives.vesc.faults import fault_words
from hil_forceps.drives.vesc.messages import Command

_VALUES: Final = 0  # the one question


class VescInquiry:
    """One motor; an `Inquiry`."""

    def __init__(self, node: int) -> None:
        self._node = node
        self._answers = Answers({"torn_answers": 0})
        self._questions = Questions({_VALUES: wire.request(node)})
        self._values: wire.Values | None = None
        self._is_old = False

    def poll(self, now_ns: int) -> list[Frame]:
        """Return the request."""
        return self._questions.poll(now_ns)

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Take one frame."""
        found = wire.node_and_command(frame)
        if found == (wire.HOST_ID, Command.FILL_RX_BUFFER):
            self._answers.fill(frame.data, now_ns)
        elif found == (wire.HOST_ID, Command.PROCESS_RX_BUFFER):
            answer = self._answers.process(frame.data)
            if answer is None or answer.node != self._node or not answer.payload:
                return
            values = wire.parse_values(answer.payload)
            self._values = values or self._values
            self._is_old = self._is_old or wire.lacks_status(answer.payload)
            if values is not None or self._is_old:
                self._questions.answered(_VALUES)

    def said(self) -> Said | None:
        """Return what the values say; that it has no torque only its current shows."""
        if self._is_old:
            return Said(
                firmware="firmware before 5.03", misfit="it does not report its timeout; update its firmware to 5.03"
            )
        if self._values is None:
            return None
        said = Said(firmware="firmware 5.03 or later")
        if self._values.fault:
            said.fault, said.state = fault_words(self._values.fault), DriveState.FAULT
        elif self._values.is_killed:
            said.fault, said.state = "its kill switch is on", DriveState.FAULT
        else:
            said.fault = ""
            said.state = DriveState.ARMED if self._values.current_A else DriveState.DISABLED
        return said

    def is_complete(self) -> bool:
        """Tell whether the request was answered or given up."""
        return self._questions.is_over
