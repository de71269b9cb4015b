"""Virtual time: nodes and a bus, stepped from event to event by whoever waits. No threads, no clock.

Order at one instant: the bus ends its transmission and delivers, in order of attachment; what is rare happens (fault
windows, delayed frames); nodes whose time has come wake, in order of attachment. Only then, when time must move on,
does the next arbitration take place, so all that was queued at an instant takes part, whoever queued it first.
"""

from virtual_bus.bus.faults import FOREVER_NS, Side
from virtual_bus.bus.node import Node
from virtual_bus.bus.port import DEFAULT_QUEUE_FRAMES, Port
from virtual_bus.bus.wire import NOBODY_NS, Wire


class _Seat:
    """A node with its port; its methods are looked up once, they are called for every frame."""

    __slots__ = ("next_wake_ns", "port", "take_outbox", "wake")

    def __init__(self, node: Node, port: Port) -> None:
        self.port = port
        self.wake = node.wake
        self.next_wake_ns = node.next_wake_ns
        self.take_outbox = node.take_outbox


class Simulation:
    """Nodes on a medium. `now_ns` only grows; the same calls give the same events."""

    def __init__(self, medium: Wire) -> None:
        self.medium = medium
        self.now_ns = 0
        self._seats: list[_Seat] = []
        self._wakes: list[int] = [FOREVER_NS]  # of each node, and a last one so that there is always a least
        self._answering: list[int] = []  # places of nodes that may answer

    def add(
        self, node: Node, name: str, side: Side, queue_frames: int = DEFAULT_QUEUE_FRAMES, answers: bool = True
    ) -> Port:
        """Attach a node; what it has in its outbox already is queued now.

        `answers` False: by what it receives it never gets anything to send, nor another time to wake.
        """
        port = self.medium.attach(name, side, node.receive, queue_frames, answers)
        self._seats.append(_Seat(node, port))
        self._wakes.insert(-1, FOREVER_NS)
        self._answering = self._places_of_answering()
        self._settle(len(self._seats) - 1)
        return port

    def remove(self, port: Port) -> None:
        """Detach a node; ValueError when it isn't there."""
        index = self._index(port)
        self.medium.detach(port)
        del self._seats[index], self._wakes[index]
        self._answering = self._places_of_answering()

    def settle(self, port: Port) -> None:
        """Look again at a node that somebody outside has given something to do; ValueError when it isn't there."""
        self._settle(self._index(port))

    def advance_until(self, limit_ns: int) -> None:
        """Do everything up to and including `limit_ns`, but the arbitration at `limit_ns` itself.

        ValueError when the limit is no time.
        """
        if limit_ns >= FOREVER_NS:
            raise ValueError("time needs a limit to run to")
        medium, wakes = self.medium, self._wakes
        while True:
            wake_ns = min(wakes)
            until_ns = wake_ns if wake_ns < limit_ns else limit_ns
            told_ns = medium.carry(until_ns)
            if told_ns == FOREVER_NS:
                if wake_ns > limit_ns:
                    break
                self._wake_due(wake_ns)
                continue
            if told_ns != NOBODY_NS:
                self.now_ns = told_ns
                self._settle_told()
                continue
            # Frames that reach only nodes which have nothing to say to them: no need to look at every node each time.
            while (event_ns := medium.next_event_ns(until_ns)) < until_ns:
                self.now_ns = now_ns = event_ns if event_ns > self.now_ns else self.now_ns
                if medium.run(now_ns):
                    self._settle_told()
                    break
            else:
                if not self._do(wake_ns, event_ns, limit_ns):
                    break
        self.now_ns = max(self.now_ns, limit_ns)

    def step(self, limit_ns: int) -> bool:
        """Do what is due at the next instant; False when nothing is left up to `limit_ns`, below FOREVER_NS."""
        wake_ns = min(self._wakes)
        return self._do(wake_ns, self.medium.next_event_ns(min(wake_ns, limit_ns)), limit_ns)

    def _do(self, wake_ns: int, event_ns: int, limit_ns: int) -> bool:
        """Do what is due at the next instant: the first wake of a node, or the next event on the bus."""
        now_ns = event_ns if event_ns < wake_ns else wake_ns
        if now_ns > limit_ns:
            return False
        wakes = self._wakes
        # A node that has just been told something may want to wake at once: never back in time.
        self.now_ns = now_ns = now_ns if now_ns > self.now_ns else self.now_ns
        is_told = now_ns >= event_ns and self.medium.run(now_ns)
        for index, seat in enumerate(self._seats):
            if wakes[index] <= now_ns:
                self._wake(index)
            elif is_told and seat.port.answers:
                self._settle(index)
        return True

    def _wake_due(self, wake_ns: int) -> None:
        """Wake the nodes whose time has come."""
        self.now_ns = now_ns = wake_ns if wake_ns > self.now_ns else self.now_ns
        for index, due_ns in enumerate(self._wakes):
            if due_ns <= now_ns:
                self._wake(index)

    def _settle_told(self) -> None:
        for index in self._answering:
            self._settle(index)

    def _places_of_answering(self) -> list[int]:
        return [index for index, seat in enumerate(self._seats) if seat.port.answers]

    def _wake(self, index: int) -> None:
        self._seats[index].wake(self.now_ns)
        self._settle(index)
        if self._wakes[index] <= self.now_ns:
            name = self._seats[index].port.name
            raise ValueError(f"node {name} has been woken and wants it at the same time again")

    def _settle(self, index: int) -> None:
        """Queue what a node wants to send and ask when it wants to wake."""
        seat = self._seats[index]
        frames = seat.take_outbox()
        if frames:
            submit, port, now_ns = self.medium.submit, seat.port, self.now_ns
            for frame in frames:
                submit(port, frame, now_ns)
        self._wakes[index] = seat.next_wake_ns()

    def _index(self, port: Port) -> int:
        for index, seat in enumerate(self._seats):
            if seat.port is port:
                return index
        raise ValueError(f"{port.name} is not on this bus")
