"""The set-up of a CiA 402 drive by SDO: the device type is read, objects are written, one request at a time. Pure."""

from collections.abc import Iterable
from typing import Final

from firmware_protocol.frames import Frame
from hil_forceps.drives.cia402 import messages as wire
from hil_forceps.drives.cia402.messages import Entry

SDO_TIMEOUT_NS: Final = 200_000_000
SDO_TRIES: Final = 3
DEVICE_PROFILE: Final = 402
_DEVICE_TYPE: Final = (0x1000, 0)


class SetUp:
    """What is left to be asked of one node; none of it blocks."""

    def __init__(self, node: int, entries: Iterable[Entry]) -> None:
        self.refusal = ""  # why the node can't be set up, in one line
        self._node = node
        self._entries = list(entries)
        self._is_identified = False
        self._sent_ns: int | None = None
        self._tries = 0

    @property
    def is_done(self) -> bool:
        """Whether all is written and taken."""
        return self._is_identified and not self._entries

    def poll(self, now_ns: int) -> list[Frame]:
        """Return the request that is due, or due again."""
        is_waiting = self._sent_ns is not None and now_ns - self._sent_ns < SDO_TIMEOUT_NS
        if self.is_done or self.refusal or is_waiting:
            return []
        self._sent_ns = now_ns
        if not self._is_identified:  # as long as nobody is there; the service's own time-out ends that
            return [wire.sdo_read(self._node, *_DEVICE_TYPE)]
        self._tries += 1
        if self._tries > SDO_TRIES:
            self.refusal = f"node {self._node} does not answer requests for {_place(*self._wanted())}"
            return []
        return [wire.sdo_write(self._node, self._entries[0])]

    def receive(self, answer: wire.SdoAnswer) -> bool:
        """Take an answer; False where it answers no request of this set-up."""
        if self.is_done or self._sent_ns is None or (answer.object_index, answer.subindex) != self._wanted():
            return False
        place = _place(answer.object_index, answer.subindex)
        if answer.abort is not None:
            self.refusal = f"node {self._node} refuses {place} ({wire.abort_words(answer.abort)})"
        elif not self._is_identified:
            profile = (answer.value or 0) & 0xFFFF
            if profile != DEVICE_PROFILE:
                self.refusal = f"node {self._node} is not a CiA 402 drive: its device type has the profile {profile}"
            self._is_identified = True
        else:
            self._entries.pop(0)
        self._sent_ns, self._tries = None, 0
        return True

    def _wanted(self) -> tuple[int, int]:
        return (self._entries[0].object_index, self._entries[0].subindex) if self._is_identified else _DEVICE_TYPE


def _place(index: int, subindex: int) -> str:
    return f"{index:04X}h:{subindex:02X}"
