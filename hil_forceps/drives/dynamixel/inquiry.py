"""A Dynamixel, asked by the ping that `scan --ask` sends: one packet to all.

Any packet feeds a servo's bus watchdog, so nothing is read from its control table: what it is set to, the service
reads and writes at each start (`set_up.py`).
"""

from typing import Final

from firmware_protocol.frames import Frame
from hil_forceps.drives.dynamixel import control_table as table
from hil_forceps.drives.dynamixel import packets as wire
from hil_forceps.drives.dynamixel.set_up import PING_SIZE
from hil_forceps.drives.inquiry import Said

ANSWER_NS: Final = 100_000_000  # of all servos, behind each other (e-manual: the id times the length of an answer)


class DynamixelInquiry:
    """One servo; an `Inquiry`."""

    def __init__(self, node: int) -> None:
        self._node = node
        self._asked_ns: int | None = None
        self._is_over = False
        self._status: wire.Status | None = None

    def poll(self, now_ns: int) -> list[Frame]:
        """Return the ping, once."""
        if self._asked_ns is None:
            self._asked_ns = now_ns
            return [wire.ping(wire.BROADCAST_ID)]
        self._is_over = now_ns - self._asked_ns >= ANSWER_NS
        return []

    def receive(self, frame: Frame, now_ns: int) -> None:  # noqa: ARG002 - nothing here depends on when
        """Take one packet."""
        status = wire.parse_status(frame.data)
        if frame.arbitration_id == self._node and status is not None and len(status.data) == PING_SIZE:
            self._status = status

    def said(self) -> Said | None:
        """Return what the ping brought."""
        status = self._status
        if status is None:
            return None
        number, firmware = int.from_bytes(status.data[:2], "little"), status.data[2]
        model = table.MODELS.get(number)
        said = Said(firmware=f"{'model number ' + str(number) if model is None else model.name}, firmware {firmware}")
        said.fault = f"it alerts: {table.HARDWARE_ERROR_STATUS} has the error" if status.alert else ""
        if model is None:
            known = ", ".join(f"{each.name} ({each.number})" for each in table.MODELS.values())
            said.misfit = f"unknown model; known models: {known}"
        else:
            said.counts_per_rev = table.COUNTS_PER_REV
        if firmware < table.MIN_FIRMWARE:
            said.misfit = (
                f"this firmware has no bus watchdog; update it to {table.MIN_FIRMWARE} or later with DYNAMIXEL Wizard"
            )
        return said

    def is_complete(self) -> bool:
        """Tell whether the servos have had their time to answer."""
        return self._is_over
