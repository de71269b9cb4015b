"""An ODrive, listened to: any frame to its node would feed its watchdog, so nothing is sent."""

from typing import Final

from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState
from hil_forceps.drives.inquiry import Said
from hil_forceps.drives.odrive import messages as wire
from hil_forceps.drives.odrive.messages import AxisState, Command, Firmware

MIN_HEARTBEATS: Final = 2  # one frame of eight bytes may be anybody's
MIN_ESTIMATES: Final = 21  # 20 periods, so that one frame late by a period shows as 5 %


class ODriveInquiry:
    """One axis; an `Inquiry`."""

    def __init__(self, node: int, firmware: Firmware) -> None:
        self._node = node
        self._firmware = firmware
        self._beats = 0
        self._heartbeat: wire.Heartbeat | None = None
        self._estimates = 0
        self._first_ns = self._last_ns = 0

    def poll(self, now_ns: int) -> list[Frame]:  # noqa: ARG002 - nothing is ever sent
        """Return nothing."""
        return []

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Take one frame."""
        if frame.is_extended:
            return
        if frame.arbitration_id == wire.frame_id(self._node, Command.HEARTBEAT):
            heartbeat = wire.parse_heartbeat(frame.data)
            if heartbeat is not None:
                self._heartbeat, self._beats = heartbeat, self._beats + 1
        elif frame.arbitration_id == wire.frame_id(self._node, Command.ENCODER_ESTIMATES):
            if self._estimates == 0:
                self._first_ns = now_ns
            self._last_ns = now_ns
            self._estimates += 1

    def said(self) -> Said | None:
        """Return what the heartbeats say; the period is the mean between the encoder's frames."""
        heartbeat = self._heartbeat
        if heartbeat is None or self._beats < MIN_HEARTBEATS:
            return None
        said = Said(state=_state_of(heartbeat), fault="")
        if heartbeat.axis_error:
            said.fault = wire.error_words(self._firmware, heartbeat.axis_error)
        if self._estimates >= MIN_ESTIMATES:
            said.sample_period_s = (self._last_ns - self._first_ns) * 1e-9 / (self._estimates - 1)
        return said

    def is_complete(self) -> bool:
        """Tell whether heartbeats and enough of the encoder's frames came."""
        return self._beats >= MIN_HEARTBEATS and self._estimates >= MIN_ESTIMATES


def _state_of(heartbeat: wire.Heartbeat) -> DriveState:
    if heartbeat.axis_state == AxisState.CLOSED_LOOP_CONTROL:
        return DriveState.OPERATIONAL
    if heartbeat.axis_state not in {AxisState.UNDEFINED, AxisState.IDLE}:
        return DriveState.ARMED  # calibrates, looks for an index, homes
    return DriveState.FAULT if heartbeat.axis_error else DriveState.DISABLED
