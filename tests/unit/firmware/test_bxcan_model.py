"""The model of the bxCAN, register by register: what it lets pass, what it loses, what goes out first."""

import pytest

from firmware_protocol.frames import Frame
from tests.bxcan import F0R1, F0R2, FA1R, FIFO_DEPTH, RDT0R, RF0R, RI0R, TDH0R, TDL0R, TDT0R, TI0R, TSR, BxCan

NODE = 5
ESTOP_ALL, OWN, OTHER = 0x000, 0x040 | NODE, 0x040 | NODE + 1


def started() -> BxCan:
    """As bxcan_filter sets it: node 5 and node 0, data frames, 11-bit ids."""
    can = BxCan()
    mask = 0x1F << 5 | 3 << 3
    can.write(F0R1, mask << 16 | NODE << 5)
    can.write(F0R2, mask << 16)
    can.write(FA1R, 1)
    return can


def request(can: BxCan, box: int, identifier: int, data: bytes) -> None:
    at = 0x10 * box
    can.write(at + TDT0R, len(data))
    can.write(at + TDL0R, int.from_bytes(data[:4].ljust(4, b"\0"), "little"))
    can.write(at + TDH0R, int.from_bytes(data[4:].ljust(4, b"\0"), "little"))
    can.write(at + TI0R, identifier << 21 | 1)


def free(can: BxCan) -> int:
    return can.read(TSR) >> 26 & 7


def test_the_filter_passes_own_and_common_data_frames_only() -> None:
    can = started()
    assert [can.passes(i) for i in (ESTOP_ALL, OWN, OTHER, 0x7FF)] == [True, True, False, False]
    assert not can.passes(OWN, remote=True)
    assert not can.passes(OWN << 18, extended=True)  # the same bits where the standard id stands
    assert not can.passes(OWN, extended=True)
    can.write(FA1R, 0)
    assert not can.passes(OWN)


def test_the_fifo_holds_three_and_loses_what_comes_after() -> None:
    can = started()
    for number in range(FIFO_DEPTH + 2):
        can.deliver(Frame(OWN, bytes((number,))))
    can.deliver(Frame(OTHER, b""))
    assert (can.overruns, can.filtered) == (2, 1)
    assert can.read(RF0R) & 3 == FIFO_DEPTH
    seen = []
    while can.read(RF0R) & 3:
        assert can.read(RI0R) >> 21 == OWN
        assert can.read(RDT0R) == 1
        seen.append(can.read(RDT0R + 4))
        can.write(RF0R, 1 << 5)
    assert seen == [0, 1, 2]


def test_mailboxes_go_in_order_of_request_and_are_taken_until_the_frame_has_left() -> None:
    can = started()
    frames = [Frame(0x7FF, b"last"), Frame(0x001, b"first id"), Frame(0x100, b"")]
    for box, frame in ((2, frames[0]), (0, frames[1]), (1, frames[2])):
        request(can, box, frame.arbitration_id, frame.data)
    assert free(can) == 0
    assert can.offer() == frames[0]
    assert can.offer() is None  # while it is on the bus
    assert can.transmitted()  # all were taken
    assert free(can) == 0b100
    assert can.read(TSR) >> 24 & 3 == 2  # CODE
    assert can.offer() == frames[1]
    assert not can.transmitted()
    assert can.offer() == frames[2]
    assert not can.transmitted()
    assert can.offer() is None
    assert free(can) == 0b111


def test_a_taken_mailbox_must_not_be_written() -> None:
    can = started()
    request(can, 0, OWN, b"")
    with pytest.raises(AssertionError):
        request(can, 0, OWN, b"")
