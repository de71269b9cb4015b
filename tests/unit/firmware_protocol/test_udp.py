"""The protocol over UDP, by the reference firmware as a process: what is in a datagram, and where it goes."""

import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import pytest

from firmware_protocol import codec
from firmware_protocol.frames import Frame
from firmware_protocol.messages import Function, ParamOp, ParamRequest, ParamResponse
from firmware_protocol.parameters import Index
from firmware_protocol.serial_framing import SerialReader, encode_serial
from tests.firmware_library import make

WAIT_S = 10.0
REQUEST = encode_serial(codec.encode(ParamRequest(1, ParamOp.READ, Index.NODE, 0)))
pytestmark = pytest.mark.realtime


@contextmanager
def firmware() -> Iterator[tuple[str, int]]:
    command = [str(make("host") / "hfp-drive"), "--udp", "127.0.0.1:0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout is not None
        try:
            host, _, port = process.stdout.readline().split()[2].partition(":")
            yield host, int(port)
        finally:
            process.terminate()
            process.communicate(timeout=30)


def socket_to(address: tuple[str, int], stack: ExitStack) -> socket.socket:
    ours = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    ours.connect(address)
    ours.settimeout(0.2)
    return ours


def datagrams(ours: socket.socket, count: int) -> list[bytes]:
    found: list[bytes] = []
    deadline = time.monotonic() + WAIT_S
    while len(found) < count and time.monotonic() < deadline:
        try:
            found.append(ours.recv(2048))
        except TimeoutError:
            continue
    return found


def is_answered(ours: socket.socket) -> bool:
    decoder, deadline = codec.Decoder(), time.monotonic() + WAIT_S
    while time.monotonic() < deadline:
        for frame in frames_of(datagrams(ours, 1)):
            if isinstance(decoder.decode(frame), ParamResponse):
                return True
    return False


def frames_of(found: list[bytes]) -> list[Frame]:
    return [frame for data in found for frame in SerialReader().feed(data)]


def test_hfp_180_each_datagram_is_one_whole_packet() -> None:
    with firmware() as address, ExitStack() as stack:
        ours = socket_to(address, stack)
        ours.send(REQUEST)
        found = datagrams(ours, 300)
    assert len(found) == 300
    for data in found:
        assert data.count(0) == 1
        assert data.endswith(b"\0")
        assert len(SerialReader().feed(data)) == 1
    functions = {frame.arbitration_id >> 5 for frame in frames_of(found)}
    assert functions >= {Function.FEEDBACK, Function.TIMING, Function.DRIVE_HEARTBEAT, Function.PARAM_RESPONSE}


def test_hfp_181_a_torn_datagram_spoils_no_other() -> None:
    with firmware() as address, ExitStack() as stack:
        ours = socket_to(address, stack)
        for cut in range(1, len(REQUEST) - 1):
            ours.send(REQUEST[:cut])
            ours.send(REQUEST)
            assert is_answered(ours), cut


def test_hfp_182_it_sends_to_where_the_last_datagram_came_from() -> None:
    with firmware() as address, ExitStack() as stack:
        first, second = socket_to(address, stack), socket_to(address, stack)
        for talks, listens in ((first, second), (second, first), (first, second)):
            talks.send(REQUEST)
            assert is_answered(talks)
            listens.setblocking(False)
            while True:  # what was sent before the other one spoke
                try:
                    listens.recv(2048)
                except BlockingIOError:
                    break
            assert len(datagrams(talks, 50)) == 50
            with pytest.raises(BlockingIOError):
                listens.recv(2048)
            listens.settimeout(0.2)
