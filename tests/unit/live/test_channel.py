"""The channel between loop and page: nothing is torn, nothing is lost unsaid, nothing waits."""

import struct
import threading
from collections.abc import Iterator
from contextlib import closing
from mmap import mmap

import numpy as np
import pytest

from hil_forceps.live import channel
from hil_forceps.live.channel import PAYLOAD_BYTES, Operator, Reader, Writer, size_bytes

SLOTS = 16


@pytest.fixture
def memory() -> Iterator[mmap]:
    with closing(mmap(-1, size_bytes(SLOTS))) as made:
        yield made


def message(number: int) -> bytes:
    return struct.pack("<q", number)


def numbers(reader: Reader) -> tuple[list[int], int]:
    taken = reader.take()
    return [int.from_bytes(slot["data"].tobytes()[:8], "little") for slot in taken.slots], taken.lost


def test_what_is_written_is_read_once_and_in_order(memory: mmap) -> None:
    writer, reader = Writer(memory), Reader(memory)
    assert numbers(reader) == ([], 0)
    seen: list[int] = []
    for number in range(5 * SLOTS):
        writer.put(number % 3, number % 2, message(number))
        if number % 7 == 6:
            found, lost = numbers(reader)
            assert lost == 0
            seen += found
    seen += numbers(reader)[0]
    assert seen == list(range(5 * SLOTS))
    assert numbers(reader) == ([], 0)


def test_topic_axis_and_bytes_come_through(memory: mmap) -> None:
    Writer(memory).put(2, 1, bytes(range(PAYLOAD_BYTES)))
    (slot,) = Reader(memory).take().slots
    assert (slot["topic"], slot["axis"], slot["size"]) == (2, 1, PAYLOAD_BYTES)
    assert slot["data"].tobytes() == bytes(range(PAYLOAD_BYTES))


def test_a_reader_that_is_too_slow_loses_the_oldest_and_counts_them(memory: mmap) -> None:
    writer, reader = Writer(memory), Reader(memory)
    for number in range(3 * SLOTS + 5):
        writer.put(0, 0, message(number))
    found, lost = numbers(reader)
    assert found == list(range(2 * SLOTS + 5, 3 * SLOTS + 5))
    assert lost == 2 * SLOTS + 5


def test_a_limit_leaves_the_rest_for_the_next_call(memory: mmap) -> None:
    writer, reader = Writer(memory), Reader(memory)
    for number in range(10):
        writer.put(0, 0, message(number))
    assert [len(reader.take(4).slots) for _ in range(4)] == [4, 4, 2, 0]


def slot_at(number: int) -> int:
    return channel._SLOTS_AT + number % SLOTS * channel._SLOT_BYTES


def test_a_slot_that_is_seen_before_it_is_whole_is_taken_later(memory: mmap) -> None:
    """As where another processor sees the count before what it counts."""
    writer, reader = Writer(memory), Reader(memory)
    for number in range(3):
        writer.put(0, 0, message(number))
    at = slot_at(1) + 16
    memory[at] ^= 0xFF
    assert numbers(reader) == ([0], 0)
    memory[at] ^= 0xFF
    assert numbers(reader) == ([1, 2], 0)


def test_a_slot_that_never_becomes_whole_is_lost_and_the_others_are_not(memory: mmap) -> None:
    writer, reader = Writer(memory), Reader(memory)
    for number in range(4):
        writer.put(0, 0, message(number))
    memory[slot_at(1) + 16] ^= 0xFF
    assert numbers(reader) == ([0], 0)
    assert numbers(reader) == ([2, 3], 1)


def test_a_size_that_can_not_be_is_no_message(memory: mmap) -> None:
    Writer(memory).put(0, 0, message(0))
    memory[slot_at(0) + 14 : slot_at(0) + 16] = b"\xff\xff"
    reader = Reader(memory)
    assert [len(reader.take().slots) for _ in range(2)] == [0, 0]


def test_a_writer_that_runs_over_the_reader_leaves_no_torn_message() -> None:
    """A writer in a thread, as fast as it can, around a ring so small that it laps the reader often."""
    count = 60_000
    with closing(mmap(-1, size_bytes(64))) as memory:
        writer, reader = Writer(memory), Reader(memory)

        def write() -> None:
            for number in range(count):
                writer.put(0, 0, message(number) * (PAYLOAD_BYTES // 8))

        thread = threading.Thread(target=write)
        thread.start()
        got, lost = 0, 0
        while got + lost < count:
            taken = reader.take()
            rows = np.ascontiguousarray(taken.slots["data"]).view("<u8").reshape(-1, PAYLOAD_BYTES // 8)
            assert (rows == rows[:, :1]).all()
            got, lost = got + len(rows), lost + taken.lost
        thread.join()
    assert got + lost == count
    assert got > 0


def test_the_newest_status_is_read_once(memory: mmap) -> None:
    writer, reader = Writer(memory), Reader(memory)
    assert reader.status() is None
    for number in range(3):
        writer.post({"number": number, "text": "θ"})
    assert reader.status() == {"number": 2, "text": "θ"}
    assert reader.status() is None
    writer.post([3])
    assert reader.status() == [3]


def test_a_torn_status_is_none_and_the_one_before_stands(memory: mmap) -> None:
    writer, reader = Writer(memory), Reader(memory)
    writer.post("first")
    writer.post("second")
    at = channel._BOARDS_AT + channel._BOARD.size  # the second stands on board 0
    assert memory[at : at + 8] == b'"second"'
    memory[at + 1] ^= 0xFF
    assert reader.status() == "first"


def test_a_status_too_long_for_its_board_is_left_out(memory: mmap) -> None:
    writer, reader = Writer(memory), Reader(memory)
    writer.post("short")
    writer.post("x" * channel.BOARD_BYTES)
    assert reader.status() == "short"


def test_what_an_operator_asks_for_reaches_the_loop(memory: mmap) -> None:
    writer, operator = Writer(memory), Operator(memory)
    assert (writer.stop_asked(), writer.clears_asked()) == (False, 0)
    operator.stop()
    operator.stop()
    assert writer.stop_asked()
    for _ in range(257):
        operator.clear()
    assert writer.clears_asked() == 1


def test_memory_that_is_too_small_is_a_wrong_call() -> None:
    with closing(mmap(-1, 64)) as memory, pytest.raises(ValueError, match="takes"):
        Reader(memory)
