"""Half duplex: one question on the line at a time, its answer told from echoes, others' packets and late answers.

A status packet says neither what it answers nor when the servo took the value. So the next question waits for the
answer to the last, or until that can't be expected any more.
"""

from collections import deque
from typing import Final, Literal, NamedTuple

from firmware_protocol.frames import Frame
from hil_forceps.drives.dynamixel import packets as wire

MAX_AWAITED_ECHOES: Final = 8  # packets sent that may still come back

COUNTERS: Final = ("echoes", "other_hosts", "not_for_us", "bad_length", "unexpected", "late_answers", "unanswered")


Purpose = Literal["feedback", "set up", "order", "off", "is off", "reboot"]


class Request(NamedTuple):
    """A question to the servo, and how many bytes the answer has; None: it isn't answered."""

    purpose: Purpose
    frame: Frame
    answer_size: int | None
    timeout_ns: int
    least_ns: int = 0  # an answer that comes sooner is one to a question of before


class Answer(NamedTuple):
    """What came back to a request, when that was sent, and when it came."""

    request: Request
    status: wire.Status
    sent_ns: int
    received_ns: int


class HalfDuplex:
    """The line to one servo."""

    def __init__(self, servo_id: int, counters: dict[str, int]) -> None:
        """`counters`: those of the profile, with the names of `COUNTERS` among them."""
        self.waiting_for: Request | None = None
        self._servo_id = servo_id
        self._counters = counters
        self._sent: deque[bytes] = deque(maxlen=MAX_AWAITED_ECHOES)
        self._sent_ns = 0

    def send(self, request: Request, now_ns: int) -> Frame:
        """Return the packet of a request, and wait for its answer."""
        if self.waiting_for is not None:
            raise ValueError("the servo may be answering: one request at a time")
        if request.answer_size is not None:
            self.waiting_for, self._sent_ns = request, now_ns
        return self.announce(request.frame)

    def announce(self, frame: Frame) -> Frame:
        """Return a packet that isn't answered; its echo will be known."""
        self._sent.append(frame.data)
        return frame

    def receive(self, frame: Frame, now_ns: int) -> Answer | None:
        """Return the answer that a packet is, None for any other, which is counted."""
        status = wire.parse_status(frame.data)
        name = self._other_than_answer(frame, status, now_ns)
        if name is not None or status is None:
            self._counters[name or "bad_length"] += 1
            return None
        assert self.waiting_for is not None
        answer = Answer(self.waiting_for, status, self._sent_ns, now_ns)
        self.waiting_for = None
        return answer

    def forget(self) -> None:
        """Wait for nothing: what still comes answers a question of before."""
        self.waiting_for = None

    def gives_up(self, now_ns: int) -> Request | None:
        """Return the request whose answer can't be expected any more, once."""
        request = self.waiting_for
        if request is None or now_ns - self._sent_ns < request.timeout_ns:
            return None
        self.waiting_for = None
        self._counters["unanswered"] += 1
        return request

    def _other_than_answer(self, frame: Frame, status: wire.Status | None, now_ns: int) -> str | None:
        """Return the counter of a packet that is no answer to what was asked."""
        if status is None:
            if frame.data in self._sent:  # a two-wire adapter hears itself
                self._sent.remove(frame.data)
                return "echoes"
            return "bad_length" if frame.data[:1] == bytes((wire.Instruction.STATUS,)) else "other_hosts"
        if frame.arbitration_id != self._servo_id:
            return "not_for_us"
        request = self.waiting_for
        if request is None:
            return "unexpected"
        if len(status.data) != (0 if status.error else request.answer_size):
            return "bad_length"
        return "late_answers" if now_ns - self._sent_ns < request.least_ns else None
