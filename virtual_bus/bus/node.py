"""What hangs on the virtual bus: anything that takes frames, wakes by itself and sends frames."""

from typing import Protocol

from firmware_protocol.frames import Frame


class Node(Protocol):
    """One participant of the bus in its time, nanoseconds that never go back."""

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Take a frame that has just been completed on the bus."""

    def next_wake_ns(self) -> int:
        """Return when this node wants `wake` to be called next."""

    def wake(self, now_ns: int) -> None:
        """Do all that is due by now."""

    def take_outbox(self) -> list[Frame]:
        """Hand over the frames to send, oldest first, and forget them."""
