"""python-can: what is ours comes in, a full queue is told from a dead bus."""

import errno
import time

import can
import pytest

from firmware_protocol.frames import Frame
from hil_forceps.bridge.clocks import MonotonicClock, VirtualClock
from hil_forceps.bridge.links import can_link
from hil_forceps.bridge.links.can_link import PythonCanLink, VirtualTimeLink
from hil_forceps.bridge.ports import SendResult

FRAME = Frame(0x44, b"12345678")
MS = 1_000_000


class ScriptedBus(can.BusABC):
    """Gives what it was given; raises what it was told to."""

    def __init__(self) -> None:
        super().__init__(channel="x")
        self.messages: list[can.Message | Exception] = []
        self.error: Exception | None = None
        self.sent: list[can.Message] = []
        self.bus_state = can.BusState.ACTIVE

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        assert timeout == 0, "the loop never waits"
        if not self.messages:
            return None, False
        message = self.messages.pop(0)
        if isinstance(message, Exception):
            raise message
        return message, False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        assert timeout == 0, "the loop never waits"
        if self.error is not None:
            raise self.error
        self.sent.append(msg)

    @property
    def state(self) -> can.BusState:
        return self.bus_state

    @state.setter
    def state(self, new_state: can.BusState) -> None:
        self.bus_state = new_state


@pytest.fixture
def bus() -> ScriptedBus:
    return ScriptedBus()


@pytest.fixture
def link(bus: ScriptedBus) -> PythonCanLink:
    return PythonCanLink(bus, MonotonicClock())


def caused(number: int) -> can.CanOperationError:
    error = can.CanOperationError("failed to send via socket")
    error.__cause__ = OSError(number, "why")
    return error


def test_frames_pass_both_ways_unchanged(bus: ScriptedBus, link: PythonCanLink) -> None:
    for frame in (FRAME, Frame(0x64, bytes(16), is_fd=True)):
        assert link.send(frame) is SendResult.SENT
        message = bus.sent[-1]
        assert message.bitrate_switch == frame.is_fd
        message.timestamp = time.time()
        bus.messages = [message]
        assert [received[1] for received in link.receive()] == [frame]
    assert not any(link.counters.values())


FULL = [
    can.CanOperationError("Transmit buffer full"),
    can.CanOperationError("Failed to transmit: No buffer space available", errno.ENOBUFS),
    can.CanTimeoutError("late"),
    caused(errno.EAGAIN),
    OSError(errno.ENOBUFS, "No buffer space available"),
]
DEAD = [
    can.CanOperationError("Failed to transmit: Network is down", errno.ENETDOWN),
    can.CanOperationError("no such device", errno.ENODEV),
    caused(errno.ENETUNREACH),
    OSError(errno.EBADF, "Bad file descriptor"),
]


@pytest.mark.parametrize("error", FULL, ids=repr)
def test_a_full_queue_drops_the_frame_and_the_bus_stays(
    bus: ScriptedBus, link: PythonCanLink, error: Exception
) -> None:
    bus.error = error
    assert link.send(FRAME) is SendResult.QUEUE_FULL
    bus.error = None
    assert link.is_up()
    assert link.send(FRAME) is SendResult.SENT
    assert len(bus.sent) == 1
    assert link.counters["queue_full"] == 1


@pytest.mark.parametrize("error", DEAD, ids=repr)
def test_a_dead_bus_is_down_for_good(bus: ScriptedBus, link: PythonCanLink, error: Exception) -> None:
    bus.error = error
    assert link.send(FRAME) is SendResult.BUS_DOWN
    bus.error = None
    assert not link.is_up()
    assert link.send(FRAME) is SendResult.BUS_DOWN
    assert link.receive() == []
    assert bus.sent == []


@pytest.mark.parametrize("error", DEAD, ids=repr)
def test_a_bus_found_dead_by_reading_is_down(bus: ScriptedBus, link: PythonCanLink, error: Exception) -> None:
    bus.messages = [can.Message(arbitration_id=0x44, is_extended_id=False), error]
    assert len(link.receive()) == 1
    assert not link.is_up()


def test_a_frame_that_can_not_be_read_is_counted(bus: ScriptedBus, link: PythonCanLink) -> None:
    bus.messages = [can.CanOperationError("could not unpack received message")]
    assert link.receive() == []
    assert link.counters["read_errors"] == 1
    assert link.is_up()


def test_errors_without_a_number_are_a_dead_bus_when_they_do_not_end(bus: ScriptedBus, link: PythonCanLink) -> None:
    bus.error = can.CanOperationError("who knows")
    results = [link.send(FRAME) for _ in range(can_link.MAX_UNNUMBERED_ERRORS_IN_A_ROW)]
    assert results == [SendResult.QUEUE_FULL] * (can_link.MAX_UNNUMBERED_ERRORS_IN_A_ROW - 1) + [SendResult.BUS_DOWN]


def test_bus_off_is_noticed_by_state_and_by_error_frame(bus: ScriptedBus, link: PythonCanLink) -> None:
    bus.messages = [can.Message(arbitration_id=can_link.CAN_ERR_BUSOFF, is_error_frame=True)]
    assert link.receive() == []
    assert not link.is_up()
    other = PythonCanLink(ScriptedBus(), MonotonicClock())
    assert other.is_up()
    other._bus.state = can.BusState.ERROR
    assert not other.is_up()


def test_what_is_not_for_us_is_counted_apart(bus: ScriptedBus, link: PythonCanLink) -> None:
    bus.messages = [
        can.Message(arbitration_id=4, is_error_frame=True),
        can.Message(arbitration_id=0x800, is_extended_id=False, check=False),
        can.Message(arbitration_id=0x44, is_extended_id=False, is_remote_frame=True),
        can.Message(arbitration_id=0x44, is_extended_id=False, is_rx=False),
        can.Message(arbitration_id=0x44, is_extended_id=False, data=b"1"),
    ]
    assert [frame for _, frame in link.receive()] == [Frame(0x44, b"1")]
    assert (link.counters["error_frames"], link.counters["not_ours"], link.counters["own"]) == (1, 2, 1)
    assert link.is_up()


def test_frames_with_extended_ids_come_in_and_go_out_as_such(bus: ScriptedBus, link: PythonCanLink) -> None:
    frames = [Frame(0x44, b"1", is_extended=True), Frame(0x1FFFFFFF, bytes(12), True, True), Frame(0x44, b"2")]
    for frame in frames:
        assert link.send(frame) is SendResult.SENT
    assert [(m.arbitration_id, m.is_extended_id, m.is_fd) for m in bus.sent] == [
        (0x44, True, False),
        (0x1FFFFFFF, True, True),
        (0x44, False, False),
    ]
    bus.messages = [*bus.sent, can.Message(arbitration_id=0x20000000, is_extended_id=True, check=False)]
    assert [frame for _, frame in link.receive()] == frames
    assert link.counters["not_ours"] == 1


def test_an_echo_is_told_from_the_same_number_with_29_bits(bus: ScriptedBus) -> None:
    link = PythonCanLink(bus, MonotonicClock(), echoes=True)
    link.send(FRAME)
    bus.messages = [can.Message(arbitration_id=FRAME.arbitration_id, data=FRAME.data, is_extended_id=True)]
    assert [frame for _, frame in link.receive()] == [FRAME._replace(is_extended=True)]


def test_what_an_interface_plays_back_unmarked_is_known_again(bus: ScriptedBus) -> None:
    link = PythonCanLink(bus, MonotonicClock(), echoes=True)
    other = Frame(0x84, b"12345678")
    for _ in range(2):
        link.send(FRAME)
        echo = can.Message(arbitration_id=FRAME.arbitration_id, data=FRAME.data, is_extended_id=False)
        theirs = can.Message(arbitration_id=other.arbitration_id, data=other.data, is_extended_id=False)
        bus.messages = [theirs, echo, echo]
        assert [frame for _, frame in link.receive()] == [other, FRAME], "one echo for one frame"
    assert link.counters["own"] == 2


def test_a_flood_is_taken_in_parts(bus: ScriptedBus, link: PythonCanLink) -> None:
    bus.messages = [can.Message(arbitration_id=0x44, is_extended_id=False)] * (can_link.MAX_FRAMES_PER_CALL + 5)
    assert len(link.receive()) == can_link.MAX_FRAMES_PER_CALL
    assert len(link.receive()) == 5


def test_the_kernels_stamp_becomes_the_hosts_time(bus: ScriptedBus, link: PythonCanLink) -> None:
    def message(stamp_s: float) -> can.Message:
        return can.Message(timestamp=stamp_s, arbitration_id=0x44, is_extended_id=False)

    before_ns = time.monotonic_ns()
    bus.messages = [message(time.time() - 0.25), message(12.0), message(time.time() + 9.0)]
    (stamped, _), (from_power_on, _), (future, _) = link.receive()
    after_ns = time.monotonic_ns()
    assert before_ns - 251 * MS < stamped < after_ns - 249 * MS
    assert before_ns <= from_power_on <= after_ns
    assert before_ns <= future <= after_ns
    assert link.counters["unstamped"] == 1


def test_closing_twice_does_no_harm(link: PythonCanLink) -> None:
    link.close()
    link.close()
    assert link.send(FRAME) is SendResult.BUS_DOWN


class TimeBus:
    """A bus with virtual time, reduced to what the link uses."""

    def __init__(self) -> None:
        self.time_ns = 0
        self.room = True
        self.state = can.BusState.ACTIVE
        self.shut = 0

    def now_ns(self) -> int:
        return self.time_ns

    def advance_until_ns(self, time_ns: int) -> None:
        assert time_ns > self.time_ns
        self.time_ns = time_ns

    def send_frame(self, frame: Frame) -> bool:
        return self.room and frame == FRAME

    def receive_frames(self) -> list[tuple[int, Frame]]:
        return [(7, FRAME)]

    def shutdown(self) -> None:
        self.shut += 1


def test_virtual_time_passes_only_when_the_host_waits() -> None:
    bus = TimeBus()
    clock = VirtualClock(bus)
    clock.sleep_until_ns(5)
    clock.sleep_until_ns(5)
    clock.sleep_until_ns(3)
    assert clock.now_ns() == 5


def test_the_link_in_virtual_time_tells_full_from_dead_too() -> None:
    bus = TimeBus()
    link = VirtualTimeLink(bus)
    assert link.send(FRAME) is SendResult.SENT
    assert link.receive() == [(7, FRAME)]
    bus.room = False
    assert link.send(FRAME) is SendResult.QUEUE_FULL
    assert link.counters["queue_full"] == 1
    bus.state = can.BusState.ERROR
    assert link.is_up()
    assert link.send(FRAME) is SendResult.BUS_DOWN
    assert not link.is_up()
    bus.state = can.BusState.ACTIVE
    assert link.send(FRAME) is SendResult.BUS_DOWN, "for good: what was queued must not burst out later"
    link.close()
    link.close()
    assert bus.shut == 1
    assert link.receive() == []


def test_the_monotonic_clock_never_wakes_early() -> None:
    clock = MonotonicClock(spin_ns=50_000)
    for ahead_ns in (-MS, 0, 10_000, 3 * MS):
        due_ns = clock.now_ns() + ahead_ns
        clock.sleep_until_ns(due_ns)
        assert clock.now_ns() >= due_ns
    with pytest.raises(ValueError, match="spin"):
        MonotonicClock(spin_ns=-1)
