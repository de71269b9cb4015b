"""The pseudo terminal: frames both ways, hosts that come and go, links."""

import os
import time
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial

from firmware_protocol.frames import Frame
from firmware_protocol.serial_framing import SerialReader, encode_serial
from hil_forceps.rig.errors import UserError
from virtual_bus.realtime.serial_server import SerialServer

FRAMES = [Frame(0x41, bytes(range(8))), Frame(0x001, b""), Frame(0x61, bytes(24), is_fd=True)]


@pytest.fixture
def server(tmp_path: Path) -> Iterator[SerialServer]:
    served = SerialServer(tmp_path / "port")
    yield served
    served.close()


def read_frames(port: serial.Serial, count: int) -> list[Frame]:
    reader = SerialReader()
    frames: list[Frame] = []
    deadline = time.monotonic() + 10.0
    while len(frames) < count and time.monotonic() < deadline:
        frames += reader.feed(port.read(max(port.in_waiting, 1)))
    return frames


def take(server: SerialServer, count: int) -> list[Frame]:
    frames: list[Frame] = []
    deadline = time.monotonic() + 10.0
    while len(frames) < count and time.monotonic() < deadline:
        frames += server.receive(0.1)
    return frames


def test_frames_travel_both_ways(server: SerialServer, tmp_path: Path) -> None:
    with serial.Serial(str(tmp_path / "port"), timeout=0.1) as host:
        server.send(FRAMES)
        assert read_frames(host, 3) == FRAMES
        host.write(b"".join(map(encode_serial, FRAMES)))
        assert take(server, 3) == FRAMES


def test_nothing_there_is_an_empty_list(server: SerialServer) -> None:
    assert server.receive(0.0) == []
    assert server.receive(0.001) == []


def test_every_byte_value_passes_unchanged(server: SerialServer, tmp_path: Path) -> None:
    """Raw mode: no echo, no newline translation, no flow control, also for a host that sets nothing."""
    frames = [Frame(0x100, bytes(range(start, start + 8))) for start in range(0, 256, 8)]
    host = os.open(tmp_path / "port", os.O_RDWR | os.O_NOCTTY)
    try:
        os.write(host, b"".join(map(encode_serial, frames)))
        assert take(server, len(frames)) == frames
        server.send(frames)
        time.sleep(0.05)
        assert SerialReader().feed(os.read(host, 4096)) == frames
    finally:
        os.close(host)


def test_a_host_may_go_and_come_back(server: SerialServer, tmp_path: Path) -> None:
    for _ in range(3):
        with serial.Serial(str(tmp_path / "port"), timeout=0.1) as host:
            server.send(FRAMES[:1])
            assert read_frames(host, 1) == FRAMES[:1]
        assert server.receive(0.0) == []
        server.send(FRAMES)  # nobody there


def test_nobody_reading_never_blocks_and_is_counted(server: SerialServer, tmp_path: Path) -> None:
    host = os.open(tmp_path / "port", os.O_RDWR | os.O_NOCTTY)
    tty.setraw(host)
    try:
        for k in range(60_000):
            server.send([Frame(0x100, k.to_bytes(4, "little"))])
        assert server.counters["unread"] > 0
        os.set_blocking(host, False)
        old = b""
        try:
            while chunk := os.read(host, 65536):
                old += chunk
        except BlockingIOError:
            pass
        numbers = [int.from_bytes(frame.data, "little") for frame in SerialReader().feed(b"\x00" + old)]
        assert numbers == sorted(numbers)
        assert min(numbers, default=60_000) > 40_000  # the newest are kept, not the oldest
        server.send(FRAMES)
        time.sleep(0.05)
        assert SerialReader().feed(b"\x00" + os.read(host, 65536))[-3:] == FRAMES
    finally:
        os.close(host)


def test_garbage_is_counted_and_what_follows_is_read(server: SerialServer, tmp_path: Path) -> None:
    with serial.Serial(str(tmp_path / "port")) as host:
        host.write(b"\x01\x02\xff" * 100 + b"\x00" + encode_serial(FRAMES[0]))
        assert take(server, 1) == FRAMES[:1]
    assert sum(server.counters.values()) >= 1


def test_a_flood_is_handed_over_in_portions(server: SerialServer, tmp_path: Path) -> None:
    packet = encode_serial(Frame(0x41, b""))
    host = os.open(tmp_path / "port", os.O_RDWR | os.O_NOCTTY)
    try:
        os.write(host, packet * 600)
        time.sleep(0.05)
        first = server.receive(0.0)
        assert 0 < len(first) <= 256
        assert len(take(server, 600 - len(first))) == 600 - len(first)
    finally:
        os.close(host)


def test_the_link_goes_with_the_server(tmp_path: Path) -> None:
    link = tmp_path / "port"
    served = SerialServer(link)
    assert link.readlink() == Path(served.device)
    served.close()
    assert not link.is_symlink()


def test_a_link_left_over_is_replaced_and_another_server_keeps_its_own(tmp_path: Path) -> None:
    link = tmp_path / "port"
    link.symlink_to("/dev/pts/987654")
    first = SerialServer(link)
    second = SerialServer(link)  # takes the path over
    first.close()
    assert link.readlink() == Path(second.device)
    second.close()


@pytest.mark.parametrize("kind", ["file", "directory", "foreign link", "no parent"])
def test_nothing_else_is_overwritten(tmp_path: Path, kind: str) -> None:
    link = tmp_path / "port"
    if kind == "file":
        link.write_text("precious")
    elif kind == "directory":
        link.mkdir()
    elif kind == "foreign link":
        link.symlink_to(tmp_path / "elsewhere")
    else:
        link = tmp_path / "none" / "port"
    with pytest.raises(UserError, match="port"):
        SerialServer(link)
    assert kind != "file" or link.read_text() == "precious"
