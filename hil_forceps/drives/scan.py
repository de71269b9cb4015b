"""Who is on a bus, by listening alone: what heartbeats say of their protocols, nodes and states.

Nothing is sent, so a drive that says nothing by itself is not found: a CANopen drive whose heartbeat is off (1017h), or
one that answers only when asked.
"""

from typing import Final, NamedTuple

from firmware_protocol.codec import Decoder
from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveHeartbeat, DriveState
from hil_forceps.drives import odrive_messages as odrive
from hil_forceps.drives.canopen_messages import HEARTBEAT_ID, NmtState

FEWEST_BEATS: Final = 2  # of an ODrive: one frame of eight bytes may be anybody's
_LAST_AXIS_STATE: Final = 14
_NMT_WORDS: Final[dict[int, str]] = {
    NmtState.BOOT_UP: "just booted",
    NmtState.STOPPED: "stopped",
    NmtState.OPERATIONAL: "operational",
    NmtState.PRE_OPERATIONAL: "pre-operational",
}
_AXIS_WORDS: Final[dict[int, str]] = {
    odrive.AxisState.IDLE: "idle",
    odrive.AxisState.CLOSED_LOOP_CONTROL: "closed loop control",
}


class Found(NamedTuple):
    """A drive that was heard."""

    profile: str  # as a rig's `motor_driver.profile` names it
    node: int
    says: str  # its state, and what it sends


class _ODrive(NamedTuple):
    beats: int
    heartbeat: odrive.Heartbeat
    estimates: int
    currents: int


class Listener:
    """Frames in, drives out."""

    def __init__(self) -> None:
        self.frames = 0
        self._decoder = Decoder()
        self._native: dict[int, DriveHeartbeat] = {}
        self._canopen: dict[int, int] = {}
        self._odrive: dict[int, _ODrive] = {}

    def receive(self, frame: Frame) -> None:
        """Take one frame."""
        self.frames += 1
        message = self._decoder.decode(frame)
        if message is not None:
            if isinstance(message, DriveHeartbeat):
                self._native[message.node] = message
            return
        node, data = frame.arbitration_id & 0x7F, frame.data
        if frame.arbitration_id == HEARTBEAT_ID + node and node and len(data) == 1 and data[0] in _NMT_WORDS:
            self._canopen[node] = data[0]
        elif len(data) == 8:
            self._hear_odrive(frame)

    def found(self) -> list[Found]:
        """Return the drives heard so far, by profile and node."""
        return [
            *(Found("native", node, _native_words(said)) for node, said in sorted(self._native.items())),
            *(
                Found("odrive", node, _odrive_words(said))
                for node, said in sorted(self._odrive.items())
                if said.beats >= FEWEST_BEATS
            ),
            *(
                Found("cia402", node, f"{_NMT_WORDS[state]}; a CANopen node, perhaps no drive")
                for node, state in sorted(self._canopen.items())
            ),
        ]

    def _hear_odrive(self, frame: Frame) -> None:
        node, command = odrive.node_and_command(frame.arbitration_id)
        known = self._odrive.get(node)
        if command == odrive.Command.HEARTBEAT:
            heartbeat = odrive.parse_heartbeat(frame.data)
            if heartbeat is not None and heartbeat.axis_state <= _LAST_AXIS_STATE:
                self._odrive[node] = (
                    _ODrive(1, heartbeat, 0, 0)
                    if known is None
                    else known._replace(beats=known.beats + 1, heartbeat=heartbeat)
                )
        elif known is not None and command == odrive.Command.ENCODER_ESTIMATES:
            self._odrive[node] = known._replace(estimates=known.estimates + 1)
        elif known is not None and command == odrive.Command.GET_IQ:
            self._odrive[node] = known._replace(currents=known.currents + 1)


def _native_words(said: DriveHeartbeat) -> str:
    return f"{DriveState(said.state).name.lower()}; protocol {said.protocol_major}.{said.protocol_minor}"


def _odrive_words(said: _ODrive) -> str:
    state = _AXIS_WORDS.get(said.heartbeat.axis_state, f"axis state {said.heartbeat.axis_state}")
    error = f"; axis error 0x{said.heartbeat.axis_error:x}" if said.heartbeat.axis_error else ""
    sends = [name for name, count in (("encoder estimates", said.estimates), ("Iq", said.currents)) if count]
    lacks = [name for name, count in (("encoder estimates", said.estimates), ("Iq", said.currents)) if not count]
    return (
        state
        + error
        + (f"; sends {' and '.join(sends)}" if sends else "")
        + (f"; sends no {' and no '.join(lacks)}: set its cyclic messages" if lacks else "")
    )
