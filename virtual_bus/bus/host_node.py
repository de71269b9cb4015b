"""The host's adapter as a node: what a program sends and receives, with the delay between program and wire."""

import random
from collections import deque

from firmware_protocol.frames import Frame
from virtual_bus.bus.faults import FOREVER_NS

DEFAULT_RECEIVE_FRAMES = 4096


class HostNode:
    """Queues to and from the wire, both bounded by who fills them.

    Each frame is delayed by `latency_ns` and up to `jitter_ns` more, uniform and seeded, each way; order is kept.
    """

    def __init__(
        self, latency_ns: int = 0, jitter_ns: int = 0, seed: str = "", receive_frames: int = DEFAULT_RECEIVE_FRAMES
    ) -> None:
        if latency_ns < 0 or jitter_ns < 0:
            raise ValueError(f"latency and jitter can't be negative: {latency_ns} ns, {jitter_ns} ns")
        if receive_frames < 1:
            raise ValueError(f"a receive queue holds at least one frame, not {receive_frames}")
        self.overrun = 0  # frames dropped because nobody took those before them
        self._latency_ns = latency_ns
        self._jitter_ns = jitter_ns
        self._random = random.Random(f"latency {seed}")
        self._receive_frames = receive_frames
        self._delayed = latency_ns > 0 or jitter_ns > 0
        self._received: deque[tuple[int, Frame]] = deque()
        self._to_wire: deque[tuple[int, Frame]] = deque()
        self._outbox: list[Frame] = []

    def send(self, frame: Frame, now_ns: int) -> int:
        """Take a frame towards the wire; return how many are on their way there."""
        last_ns = self._to_wire[-1][0] if self._to_wire else 0
        self._to_wire.append((self._due_ns(now_ns, last_ns), frame))
        return len(self._to_wire)

    def is_delayed(self) -> bool:
        """Tell whether frames take time between program and wire."""
        return self._delayed

    def on_the_way(self) -> int:
        """Return the number of frames that were sent and haven't reached the controller."""
        return len(self._to_wire)

    def flush(self) -> None:
        """Forget the frames on their way to the controller."""
        self._to_wire.clear()

    def next_received_ns(self) -> int:
        """Return when the oldest received frame is, or was, there for the program."""
        return self._received[0][0] if self._received else FOREVER_NS

    def take(self, now_ns: int) -> tuple[int, Frame] | None:
        """Return the oldest frame with its time of arrival, None when none has arrived."""
        if self._received and self._received[0][0] <= now_ns:
            return self._received.popleft()
        return None

    def take_all(self, now_ns: int) -> list[tuple[int, Frame]]:
        """Return all frames that have arrived, oldest first, each with its time."""
        received = self._received
        if not received or received[-1][0] <= now_ns:
            taken = list(received)
            received.clear()
            return taken
        taken = []
        while received[0][0] <= now_ns:
            taken.append(received.popleft())
        return taken

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Take a frame from the wire."""
        received = self._received
        if len(received) >= self._receive_frames:
            received.popleft()
            self.overrun += 1
        if self._delayed:
            now_ns = self._due_ns(now_ns, received[-1][0] if received else 0)
        received.append((now_ns, frame))

    def next_wake_ns(self) -> int:
        """Return when the next frame reaches the controller."""
        return self._to_wire[0][0] if self._to_wire else FOREVER_NS

    def wake(self, now_ns: int) -> None:
        """Pass on what has reached the controller."""
        while self._to_wire and self._to_wire[0][0] <= now_ns:
            self._outbox.append(self._to_wire.popleft()[1])

    def take_outbox(self) -> list[Frame]:
        """Hand over the frames for the controller."""
        if not self._outbox:
            return self._outbox
        frames, self._outbox = self._outbox, []
        return frames

    def _due_ns(self, now_ns: int, not_before_ns: int) -> int:
        due_ns = now_ns + self._latency_ns
        if self._jitter_ns:
            due_ns += int(self._random.random() * self._jitter_ns)
        return due_ns if due_ns > not_before_ns else not_before_ns
