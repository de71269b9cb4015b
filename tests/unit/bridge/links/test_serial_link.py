"""Serial ports: pseudo-terminals, TCP and loop://, whole frames or none, ends noticed."""

import os
import pty
import select
import socket
import tty
from collections.abc import Iterator

import pytest
import serial

from firmware_protocol.frames import Frame
from firmware_protocol.serial_framing import SerialReader, encode_serial
from hil_forceps.bridge.clocks import MonotonicClock
from hil_forceps.bridge.links.adapters import LinkSpec, open_link
from hil_forceps.bridge.links.serial_link import SerialLink
from hil_forceps.bridge.ports import SendResult
from hil_forceps.drives.registry import PROFILES

FRAME = Frame(0x44, b"12345678")
Line = tuple[int, SerialLink]


@pytest.fixture
def line() -> Iterator[Line]:
    """The far end of a pseudo-terminal as a descriptor, the near end as a link."""
    far, near = pty.openpty()
    tty.setraw(near)
    os.set_blocking(far, False)
    link = open_link(LinkSpec(serial_url=os.ttyname(near))).link
    assert isinstance(link, SerialLink)
    yield far, link
    link.close()
    for descriptor in (far, near):
        try:
            os.close(descriptor)
        except OSError:
            continue


def read_all(far: int) -> bytes:
    data = b""
    while select.select([far], [], [], 0.05)[0]:
        data += os.read(far, 65536)
    return data


def await_frames(link: SerialLink, count: int) -> list[Frame]:
    frames: list[Frame] = []
    for _ in range(1000):
        frames += [frame for _, frame in link.receive()]
        if len(frames) >= count:
            break
        select.select([], [], [], 0.001)
    return frames


def test_frames_pass_both_ways(line: Line) -> None:
    far, link = line
    assert link.receive() == []
    assert link.send(FRAME) is SendResult.SENT
    assert SerialReader().feed(read_all(far)) == [FRAME]
    data = encode_serial(FRAME) * 3
    for k in range(0, len(data), 5):
        os.write(far, data[k : k + 5])
    assert await_frames(link, 3) == [FRAME] * 3
    os.write(far, b"\x05garb\x00" + encode_serial(FRAME))
    assert await_frames(link, 1) == [FRAME]
    assert sum(link.counters.values()) == 1, "garbage is counted by name"


def test_a_full_line_drops_frames_whole_and_costs_no_other(line: Line) -> None:
    """Nobody reads: the line fills, which must not hold us up; then somebody does."""
    far, link = line
    results = [link.send(Frame(0x44, k.to_bytes(8, "little"))) for k in range(4000)]
    assert set(results) == {SendResult.SENT, SendResult.QUEUE_FULL}
    assert link.is_up()
    reader = SerialReader()
    seen = reader.feed(read_all(far))
    assert link.send(FRAME) is SendResult.SENT
    assert link.send(FRAME) is SendResult.SENT
    seen += reader.feed(read_all(far))
    sent = [k for k, result in enumerate(results) if result is SendResult.SENT]
    assert [int.from_bytes(frame.data, "little") for frame in seen[:-2]] == sent
    assert seen[-2:] == [FRAME, FRAME]
    assert sum(reader.counters.values()) <= link.counters["torn"]


def test_packets_are_packed_as_the_drives_protocol_has_it() -> None:
    far, near = pty.openpty()
    tty.setraw(near)
    ping = Frame(1, b"\x01")
    link = open_link(LinkSpec(serial_url=os.ttyname(near), framing=PROFILES["dynamixel"].framing)).link
    assert isinstance(link, SerialLink)
    assert link.send(ping) is SendResult.SENT
    assert read_all(far) == bytes.fromhex("fffffd0001030001194e")
    os.write(far, b"\x00" + bytes.fromhex("fffffd000104005500a10c"))
    assert await_frames(link, 1) == [Frame(1, b"\x55\x00")]
    assert link.counters["skipped_bytes"] == 1
    link.close()
    os.close(far)
    os.close(near)


def test_a_torn_frame_is_followed_by_a_delimiter() -> None:
    class Narrow:
        """Takes the first three bytes, then all."""

        def __init__(self) -> None:
            self.taken = b""
            self.room = 3

        def read(self) -> bytes:
            return b""

        def write(self, data: bytes) -> int:
            part = data[: self.room]
            self.taken += part
            self.room = 1000
            return len(part)

    link = SerialLink(serial.serial_for_url("loop://", timeout=0), MonotonicClock())
    narrow = Narrow()
    link._stream = narrow
    other = Frame(0x44, b"other")
    assert [link.send(FRAME), link.send(other), link.send(FRAME)] == [
        SendResult.QUEUE_FULL,
        SendResult.SENT,
        SendResult.SENT,
    ]
    reader = SerialReader()
    assert reader.feed(narrow.taken) == [other, FRAME]
    assert link.counters["torn"] == 1


def test_the_other_end_hanging_up_is_a_dead_bus() -> None:
    far, near = pty.openpty()
    tty.setraw(near)
    link = open_link(LinkSpec(serial_url=os.ttyname(near))).link
    os.close(near)
    os.write(far, encode_serial(FRAME))
    os.close(far)
    for _ in range(10):
        link.receive()
    assert not link.is_up()
    assert link.send(FRAME) is SendResult.BUS_DOWN
    link.close()
    link.close()


def test_tcp_is_a_serial_port_too_and_its_end_is_noticed() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = open_link(LinkSpec(serial_url=f"socket://127.0.0.1:{server.getsockname()[1]}")).link
        assert isinstance(link, SerialLink)
        peer, _ = server.accept()
        with peer:
            peer.sendall(encode_serial(FRAME))
            assert await_frames(link, 1) == [FRAME]
            assert link.send(FRAME) is SendResult.SENT
            assert SerialReader().feed(peer.recv(100)) == [FRAME]
        for _ in range(100):
            link.receive()
            select.select([], [], [], 0.001)
            if not link.is_up():
                break
        assert not link.is_up()
        link.close()


def test_loop_is_a_port_without_a_descriptor() -> None:
    link = open_link(LinkSpec(serial_url="loop://")).link
    assert isinstance(link, SerialLink)
    assert link.send(FRAME) is SendResult.SENT
    assert await_frames(link, 1) == [FRAME]
    results = [link.send(FRAME) for _ in range(400)]
    assert results[-1] is SendResult.QUEUE_FULL
    link.close()


def test_tcp_sends_each_packet_by_itself() -> None:
    """Held back until the packet before is acknowledged, a frame would be up to 40 ms late."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = serial.serial_for_url(f"socket://127.0.0.1:{server.getsockname()[1]}", timeout=0)
        link = SerialLink(port, MonotonicClock())
        with socket.socket(fileno=os.dup(port.fileno())) as same:
            assert same.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
        link.close()
