"""Links over python-can: any interface it has, and the shorter way to a bus in virtual time.

A full queue is told from a dead bus by the error number under python-can's exception, or by the controller's state;
an error without a number counts as a full queue until it has come `MAX_UNNUMBERED_ERRORS_IN_A_ROW` times in a row.
"""

import errno
import time
from collections import deque
from typing import Final

import can

from firmware_protocol.frames import MAX_BASE_ID, MAX_EXTENDED_ID, Frame, make
from hil_forceps.bridge.clocks import VirtualTimeBus
from hil_forceps.bridge.ports import Clock, Received, SendResult

MAX_FRAMES_PER_CALL: Final = 512  # the rest waits in the kernel, so a flood can't hold up a tick
MAX_UNNUMBERED_ERRORS_IN_A_ROW: Final = 100
MAX_AWAITED_ECHOES: Final = 64
CAN_ERR_BUSOFF: Final = 0x40  # linux/can/error.h: class of a SocketCAN error frame, in its id
MAX_STAMP_AGE_NS: Final = 1_000_000_000  # a stamp further back isn't of this clock (devices that count from power-on)
DEAD = frozenset({
    errno.ENETDOWN, errno.ENETUNREACH, errno.ENODEV, errno.ENXIO, errno.EBADF, errno.EIO, errno.EPIPE,
    errno.ESHUTDOWN, errno.ENOTCONN, errno.ECONNRESET, errno.ECONNREFUSED, errno.EADDRNOTAVAIL,
})  # fmt: skip
_SENT: Final = SendResult.SENT  # looked up for every frame
ERRORS: Final = (can.CanError, OSError, ValueError)  # ValueError: select on a socket that was closed under us


class PythonCanLink:
    """A python-can bus.

    A frame arrived at the kernel's or adapter's stamp where that is of the system's clock, else when it was read.
    """

    def __init__(self, bus: can.BusABC, clock: Clock, echoes: bool = False, marks_own: bool = True) -> None:
        """`echoes`: the interface plays back what we send and does not mark it; then we know it again by its bytes.

        `marks_own`: a frame marked as sent is one that we sent. The kernel marks what any process of this machine sent.
        """
        self.counters = dict.fromkeys(
            ("error_frames", "not_ours", "own", "read_errors", "queue_full", "send_errors", "unstamped"), 0
        )
        self._bus = bus
        self._clock = clock
        self._echoes = echoes
        self._marks_own = marks_own
        self._sent: deque[Frame] = deque(maxlen=MAX_AWAITED_ECHOES)
        self._up = True
        self._closed = False
        self._strange_in_a_row = 0

    def send(self, frame: Frame) -> SendResult:
        """Hand over one frame now or not at all."""
        if not self._up:
            return SendResult.BUS_DOWN
        message = can.Message(
            arbitration_id=frame.arbitration_id,
            data=frame.data,
            is_extended_id=frame.is_extended,
            is_fd=frame.is_fd,
            bitrate_switch=frame.is_fd,
            check=False,
        )
        result = self._put(message)
        if self._echoes and result is SendResult.SENT:
            self._sent.append(frame)
        return result

    def send_foreign(self, frame: Frame, remote: bool) -> SendResult:
        """Send what no drive's protocol has: the frame with an extended id, or as a remote frame of that length."""
        if not self._up:
            return SendResult.BUS_DOWN
        message = can.Message(
            arbitration_id=frame.arbitration_id,
            data=None if remote else frame.data,
            dlc=len(frame.data),
            is_extended_id=not remote,
            is_remote_frame=remote,
            check=False,
        )
        return self._put(message)

    def _put(self, message: can.Message) -> SendResult:
        try:
            self._bus.send(message, timeout=0)
        except ERRORS as error:
            return self._not_sent(error)
        self._strange_in_a_row = 0
        return SendResult.SENT

    def receive(self) -> list[Received]:
        """Return what has arrived since the last call, at most `MAX_FRAMES_PER_CALL`, oldest first."""
        frames: list[Received] = []
        if not self._up:
            return frames
        now_ns = self._clock.now_ns()
        to_host_ns = now_ns - time.time_ns()
        for _ in range(MAX_FRAMES_PER_CALL):
            try:
                message = self._bus.recv(0)
            except ERRORS as error:
                self._not_read(error)
                break
            if message is None:
                break
            if self._is_data(message):
                frame = make(
                    Frame,
                    (message.arbitration_id, bytes(message.data), message.is_fd, message.is_extended_id),
                )
                if self._sent and frame in self._sent:
                    self._sent.remove(frame)
                    self.counters["own"] += 1
                else:
                    frames.append(Received(self._arrival_ns(message.timestamp, to_host_ns, now_ns), frame))
        return frames

    def is_up(self) -> bool:
        """Tell whether the bus is there: false once it was found dead or the controller bus-off, for good."""
        if self._up and self._bus.state is can.BusState.ERROR:
            self._up = False
        return self._up

    def close(self) -> None:
        """Release the bus; safe to call twice."""
        self._up = False
        if not self._closed:
            self._closed = True
            self._bus.shutdown()

    def _is_data(self, message: can.Message) -> bool:
        if message.is_error_frame:
            self.counters["error_frames"] += 1
            if message.arbitration_id & CAN_ERR_BUSOFF:
                self._up = False
            return False
        if self._marks_own and not message.is_rx:  # our own, played back by the interface
            self.counters["own"] += 1
            return False
        highest = MAX_EXTENDED_ID if message.is_extended_id else MAX_BASE_ID
        if message.is_remote_frame or message.arbitration_id > highest:
            self.counters["not_ours"] += 1
            return False
        return True

    def _arrival_ns(self, stamp_s: float, to_host_ns: int, now_ns: int) -> int:
        time_ns = int(stamp_s * 1e9) + to_host_ns
        if now_ns - MAX_STAMP_AGE_NS < time_ns <= now_ns:
            return time_ns
        self.counters["unstamped"] += time_ns <= now_ns - MAX_STAMP_AGE_NS
        return now_ns  # a stamp later than the reading is one from while we read

    def _not_sent(self, error: Exception) -> SendResult:
        self.counters["send_errors"] += 1
        if self._is_deadly(error):
            self._up = False
            return SendResult.BUS_DOWN
        self.counters["queue_full"] += 1
        return SendResult.QUEUE_FULL

    def _not_read(self, error: Exception) -> None:
        self.counters["read_errors"] += 1
        if self._is_deadly(error):
            self._up = False

    def _is_deadly(self, error: Exception) -> bool:
        number = error_number(error)
        if number is not None:
            return number in DEAD
        self._strange_in_a_row += 1
        return self._strange_in_a_row >= MAX_UNNUMBERED_ERRORS_IN_A_ROW or self._bus.state is can.BusState.ERROR


class VirtualTimeLink:
    """A bus in virtual time, without python-can's messages in between."""

    def __init__(self, bus: VirtualTimeBus) -> None:
        self.counters = {"queue_full": 0}
        self._bus = bus
        self._send = bus.send_frame
        self._receive = bus.receive_frames
        self._up = True
        self._closed = False

    def send(self, frame: Frame) -> SendResult:
        """Hand over one frame now or not at all."""
        if not self._up:
            return SendResult.BUS_DOWN
        if self._send(frame):
            return _SENT
        if self._bus.state is can.BusState.ERROR:  # asked only here: every tick sends something
            self._up = False
            return SendResult.BUS_DOWN
        self.counters["queue_full"] += 1
        return SendResult.QUEUE_FULL

    def receive(self) -> list[tuple[int, Frame]]:
        """Return what has arrived since the last call, oldest first; the bus bounds it."""
        return self._receive() if self._up else []

    def is_up(self) -> bool:
        """Tell whether the bus is there: false once a frame was refused because it was gone or bus-off, for good."""
        return self._up

    def close(self) -> None:
        """Release the bus; safe to call twice."""
        self._up = False
        if not self._closed:
            self._closed = True
            self._bus.shutdown()


def error_number(error: BaseException) -> int | None:
    """Return the errno at the bottom of an exception; python-can keeps it in one of three places."""
    if isinstance(error, can.CanError) and error.error_code:
        return int(error.error_code)
    if isinstance(error, OSError) and error.errno:
        return error.errno
    return error_number(error.__cause__) if error.__cause__ is not None else None
