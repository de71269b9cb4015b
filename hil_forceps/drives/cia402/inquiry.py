"""A CiA 402 drive, asked by SDO uploads alone: they are answered in every NMT state but stopped, and change nothing.

Its watchdog is the host's heartbeat (1016h), which an upload isn't. What the service writes at each start (PDOs, mode,
1016h) is not looked at: it will be written anew.
"""

from typing import Final

from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState
from hil_forceps.drives.cia402 import messages as wire
from hil_forceps.drives.cia402.messages import State
from hil_forceps.drives.cia402.setup import DEVICE_PROFILE
from hil_forceps.drives.inquiry import Questions, Said

_DEVICE_TYPE, _ERROR_CODE, _STATUSWORD = (0x1000, 0), (0x603F, 0), (0x6041, 0)
# CiA 402: position encoder resolution, as increments for so many turns of the motor.
_INCREMENTS, _TURNS = (0x608F, 1), (0x608F, 2)
_REVISION: Final = (0x1018, 3)
_CURRENT_LIMIT: Final = (0x3001, 2)  # an EPOS4's output current limit, in mA
_ASKED: Final = (_DEVICE_TYPE, _STATUSWORD, _ERROR_CODE, _REVISION, _INCREMENTS, _TURNS, _CURRENT_LIMIT)
_ENABLED: Final = frozenset({State.OPERATION_ENABLED, State.QUICK_STOP, State.FAULT_REACTION})


class Cia402Inquiry:
    """One node; an `Inquiry`."""

    def __init__(self, node: int) -> None:
        self._node = node
        self._values: dict[tuple[int, int], int] = {}
        self._questions = Questions({_name(place): wire.sdo_read(node, *place) for place in _ASKED})

    def poll(self, now_ns: int) -> list[Frame]:
        """Return the next upload's request."""
        return self._questions.poll(now_ns)

    def receive(self, frame: Frame, now_ns: int) -> None:  # noqa: ARG002 - nothing here depends on when
        """Take one frame."""
        if frame.is_extended or frame.arbitration_id != wire.SDO_ANSWER_ID + self._node:
            return
        answer = wire.parse_sdo(frame.data)
        if answer is None or (answer.object_index, answer.subindex) not in _ASKED:
            return
        place = (answer.object_index, answer.subindex)
        if answer.value is not None:
            self._values[place] = answer.value
        self._questions.answered(_name(place))

    def said(self) -> Said | None:
        """Return what the objects say."""
        values = self._values
        if not values:
            return None
        said = Said()
        if _REVISION in values:
            said.firmware = f"revision {values[_REVISION] >> 16:04x}h"
        profile = values.get(_DEVICE_TYPE, DEVICE_PROFILE) & 0xFFFF
        if profile != DEVICE_PROFILE:
            said.misfit = f"its device profile is {profile}, not {DEVICE_PROFILE}; check motor_driver.profile"
        self._tell_state(said)
        turns = values.get(_TURNS, 0)
        if turns and _INCREMENTS in values:
            said.counts_per_rev = round(values[_INCREMENTS] / turns)
        if _CURRENT_LIMIT in values:
            said.current_limit_A = values[_CURRENT_LIMIT] * 1e-3
        return said

    def is_complete(self) -> bool:
        """Tell whether all was answered or given up."""
        return self._questions.is_over

    def _tell_state(self, said: Said) -> None:
        state = wire.state_of(self._values[_STATUSWORD] & 0xFFFF) if _STATUSWORD in self._values else None
        if state is None:
            return
        if state in {State.FAULT, State.FAULT_REACTION}:
            said.fault = f"error code 0x{self._values.get(_ERROR_CODE, 0):04x}"
        else:
            said.fault = ""
        if state is State.FAULT:
            said.state = DriveState.FAULT
        else:
            said.state = DriveState.OPERATIONAL if state in _ENABLED else DriveState.DISABLED


def _name(place: tuple[int, int]) -> int:
    return place[0] << 8 | place[1]
