"""Who is on a bus, by listening alone: what heartbeats say of their protocols, nodes and states.

Nothing is sent here, so a drive that says nothing by itself is not found: a CANopen drive whose heartbeat is off
(1017h), or one that answers only when asked, as all of the profile mit. Some of these can be asked (`Profile.ask`).
"""

from firmware_protocol.codec import Decoder
from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveHeartbeat, DriveState
from hil_forceps.drives.profile import Found, Listener, Profile
from hil_forceps.drives.registry import PROFILES


class NativeListener:
    """Tells drives of the project's own protocol by their heartbeats."""

    def __init__(self) -> None:
        self._decoder = Decoder()
        self._heard: dict[int, DriveHeartbeat] = {}

    def receive(self, frame: Frame) -> bool:
        """Take one frame; its CRC says whose it is."""
        message = self._decoder.decode(frame)
        if isinstance(message, DriveHeartbeat):
            self._heard[message.node] = message
        return message is not None

    def found(self) -> list[Found]:
        """Return the drives heard so far, by node."""
        return [
            Found(
                "native",
                node,
                f"{DriveState(said.state).name.lower()}; protocol {said.protocol_major}.{said.protocol_minor}",
            )
            for node, said in sorted(self._heard.items())
        ]


class BusListener:
    """Frames in, drives of all profiles of a CAN bus out; or of the one that is asked for, whatever its line."""

    def __init__(self, asked: Profile | None = None) -> None:
        self.frames = 0
        on_can = (profile.listener() for profile in PROFILES.values() if profile.link == "can")
        self._listeners: list[Listener] = [NativeListener(), *on_can] if asked is None else [asked.listener()]

    def receive(self, frame: Frame) -> None:
        """Take one frame."""
        self.frames += 1
        for listener in self._listeners:
            if listener.receive(frame):
                return

    def found(self) -> list[Found]:
        """Return the drives heard so far, by profile and node."""
        return [found for listener in self._listeners for found in listener.found()]
