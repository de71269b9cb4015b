"""What the kernel's CAN does wrong, and what becomes of it: told in a line, counted, never raised."""

import socket
import struct
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import pytest

from firmware_protocol.codec import Decoder, encode
from firmware_protocol.frames import Frame
from firmware_protocol.messages import Discover, Identity
from hil_forceps.bridge.links.adapters import LinkSpec, open_link
from hil_forceps.bridge.links.can_link import PythonCanLink
from hil_forceps.bridge.ports import SendResult
from hil_forceps.rig.errors import UserError
from tests.targets.socketcan.guest import PATIENCE_S, RIG, c_drive, python_drive, running, service

DEVICE: Final = "vcan7"  # made and unmade here
HELLO: Final = encode(Discover(0))
FD_FRAME: Final = Frame(0x61, bytes(8), is_fd=True)
CAN_ERR_FLAG: Final = 0x2000_0000
CAN_ERR_CRTL: Final = 0x04  # linux/can/error.h, as the next
CAN_ERR_BUSOFF: Final = 0x40
Opener = Callable[..., PythonCanLink]


def ip(words: str) -> None:
    subprocess.run(["ip", *words.split()], check=True)


@pytest.fixture
def device() -> Iterator[str]:
    ip(f"link add {DEVICE} mtu 72 type vcan")
    ip(f"link set {DEVICE} up")
    yield DEVICE
    subprocess.run(["ip", "link", "del", DEVICE], check=False, stderr=subprocess.DEVNULL)


@pytest.fixture
def opened() -> Iterator[Opener]:
    links: list[PythonCanLink] = []

    def begin(channel: str, fd: bool = False) -> PythonCanLink:
        link = open_link(LinkSpec(interface="socketcan", channel=channel, fd=fd)).link
        assert isinstance(link, PythonCanLink)
        links.append(link)
        return link

    yield begin
    for link in links:
        link.close()


def refusal(channel: str, fd: bool = False) -> str:
    with pytest.raises(UserError) as caught:
        open_link(LinkSpec(interface="socketcan", channel=channel, fd=fd))
    (problem,) = caught.value.problems
    return problem


def test_device_that_is_down(device: str) -> None:
    ip(f"link set {device} down")
    assert "the device is down; `ip link set vcan7 up" in refusal(device)


@pytest.mark.parametrize("command", ["run", "conformance"])
def test_commands_say_it_in_a_line(command: str, tmp_path: Path) -> None:
    rig = ["--rig", str(RIG)] if command == "run" else []
    words = service(command, *rig, "--out", str(tmp_path), "--interface", "socketcan", "--channel", "no_such_can")
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=PATIENCE_S)
    assert done.returncode == 2
    assert "there is no such CAN device" in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr


def test_drives_say_it_in_a_line() -> None:
    for command, words in ((c_drive, "No such device"), (python_drive, "ip link add")):
        done = subprocess.run(command("no_such_can"), capture_output=True, text=True, check=False, timeout=PATIENCE_S)
        assert done.returncode == 2
        assert words in done.stderr.splitlines()[-1]


@pytest.mark.parametrize("how", ["link set vcan7 down", "link del vcan7"])
def test_device_that_goes_while_running(device: str, opened: Opener, how: str) -> None:
    link = opened(device)
    assert link.send(HELLO) is SendResult.SENT
    ip(how)
    assert link.receive() == []
    assert link.send(HELLO) is SendResult.BUS_DOWN
    assert not link.is_up()
    assert link.receive() == []


def test_transmit_queue_full(device: str, opened: Opener) -> None:
    ip(f"link set {device} txqueuelen 10")
    # A device that takes one frame of 16 bytes in 20 ms, and lets no more than a few wait for it.
    subprocess.run(f"tc qdisc add dev {device} root tbf rate 6400bit burst 80 limit 200".split(), check=True)
    link, ear = opened(device), opened(device)
    results = [link.send(HELLO) for _ in range(50)]
    assert set(results) == {SendResult.SENT, SendResult.QUEUE_FULL}
    assert link.counters["queue_full"] == results.count(SendResult.QUEUE_FULL)
    assert link.is_up()
    time.sleep(0.5)
    assert len(ear.receive()) == results.count(SendResult.SENT)
    assert link.send(HELLO) is SendResult.SENT


def test_error_frames(device: str, opened: Opener) -> None:
    link = opened(device)
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as controller:
        controller.bind((device,))
        controller.send(struct.pack("=IB3x8s", CAN_ERR_FLAG | CAN_ERR_CRTL, 8, bytes(8)))
        assert link.receive() == []
        assert link.counters["error_frames"] == 1
        assert link.is_up()
        controller.send(struct.pack("=IB3x8s", CAN_ERR_FLAG | CAN_ERR_BUSOFF, 8, bytes(8)))
        assert link.receive() == []
    assert link.counters["error_frames"] == 2
    assert not link.is_up()


def test_fd_frame_on_a_classic_device(device: str, opened: Opener) -> None:
    ip(f"link set {device} down")
    ip(f"link set {device} mtu 16 up")
    link = opened(device, fd=True)
    assert link.send(FD_FRAME) is SendResult.QUEUE_FULL  # dropped and counted: the line is well, this frame is not
    assert link.counters["send_errors"] == 1
    assert link.is_up()
    assert link.send(HELLO) is SendResult.SENT


def test_frames_of_another_process_of_this_machine_are_heard_and_our_own_are_not(opened: Opener) -> None:
    with running(c_drive("vcan0")):
        link = opened("vcan0")
        identities: list[Frame] = []
        link.send(HELLO)
        end_s = time.monotonic() + PATIENCE_S
        while not identities and time.monotonic() < end_s:
            frames = [frame for _, frame in link.receive()]
            assert HELLO not in frames
            identities = [frame for frame in frames if isinstance(Decoder().decode(frame), Identity)]
            time.sleep(0.001)
    assert identities
    assert link.counters["own"] == 0


@pytest.mark.parametrize("command", [c_drive, python_drive], ids=["c", "python"])
def test_drive_whose_device_comes_back(command: Callable[..., list[str]], device: str, opened: Opener) -> None:
    with running(command(device)) as drive:
        ip(f"link set {device} down")
        time.sleep(0.05)
        ip(f"link set {device} up")
        link = opened(device)
        time.sleep(0.05)
        assert len(link.receive()) > 20
        assert drive.process.poll() is None
