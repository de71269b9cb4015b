"""Serial packets as datagrams: whole ones, none spoilt by another, a missing drive noticed."""

import socket
import time
from collections.abc import Iterator

import pytest

from firmware_protocol.conformance.port import Capability
from firmware_protocol.frames import Frame
from firmware_protocol.serial_framing import encode_serial
from hil_forceps.bridge.links.adapters import Connection, LinkSpec, open_link
from hil_forceps.bridge.links.conformance_port import LinkPort
from hil_forceps.bridge.links.udp_port import MAX_DATAGRAMS_PER_CALL
from hil_forceps.bridge.ports import SendResult
from hil_forceps.rig.errors import UserError

FRAMES = [Frame(0x80 + i, bytes([i] * 8)) for i in range(20)]
Line = tuple[socket.socket, Connection]


@pytest.fixture
def line() -> Iterator[Line]:
    """A drive's socket, and a link to it; the drive knows the host by its first frame."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as drive:
        drive.bind(("127.0.0.1", 0))
        connection = open_link(LinkSpec(serial_url=f"udp://127.0.0.1:{drive.getsockname()[1]}"))
        assert connection.link.send(FRAMES[0]) is SendResult.SENT
        data, host = drive.recvfrom(4096)
        assert data == encode_serial(FRAMES[0])
        drive.connect(host)
        yield drive, connection
        connection.link.close()


def test_each_packet_is_a_datagram(line: Line) -> None:
    drive, (link, *_) = line
    for frame in FRAMES:
        assert link.send(frame) is SendResult.SENT
    assert [drive.recv(4096) for _ in FRAMES] == [encode_serial(frame) for frame in FRAMES]


def test_all_that_waits_is_taken_at_once(line: Line) -> None:
    drive, (link, *_) = line
    for frame in FRAMES:
        drive.send(encode_serial(frame))
    assert [frame for _, frame in link.receive()] == FRAMES
    assert link.receive() == []


def test_a_torn_or_empty_datagram_spoils_no_other(line: Line) -> None:
    drive, (link, *_) = line
    drive.send(encode_serial(FRAMES[0])[:7])
    drive.send(b"")
    drive.send(encode_serial(FRAMES[1]) + encode_serial(FRAMES[2]))
    drive.send(bytes(5000))
    drive.send(encode_serial(FRAMES[3]))
    assert [frame for _, frame in link.receive()] == FRAMES[1:4]
    assert link.is_up()


def test_one_call_takes_only_so_many(line: Line) -> None:
    drive, (link, *_) = line
    for _ in range(MAX_DATAGRAMS_PER_CALL + 3):
        drive.send(b"")
    drive.send(encode_serial(FRAMES[0]))
    assert link.receive() == []
    assert [frame for _, frame in link.receive()] == FRAMES[:1]


def test_a_drive_that_is_gone_is_noticed(line: Line) -> None:
    drive, (link, *_) = line
    drive.close()
    end = time.monotonic() + 10.0
    while link.is_up() and time.monotonic() < end:
        link.send(FRAMES[0])
        link.receive()
    assert not link.is_up()
    assert link.send(FRAMES[0]) is SendResult.BUS_DOWN


def test_the_suite_is_told_that_packets_stay_whole(line: Line) -> None:
    can = LinkPort(line[1], fd=False).capabilities
    assert Capability.SERIAL in can
    assert Capability.STREAM not in can


@pytest.mark.parametrize("url", ["udp://", "udp://127.0.0.1", "udp://:5", "udp://127.0.0.1:99999", "udp://a:5/b"])
def test_what_is_no_address_is_said(url: str) -> None:
    with pytest.raises(UserError, match="can't be opened"):
        open_link(LinkSpec(serial_url=url))
