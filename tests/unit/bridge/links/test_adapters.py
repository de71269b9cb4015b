"""Opening what isn't there ends in one clear line with what to do about it."""

import errno
import os
import pty
from pathlib import Path
from typing import NoReturn

import can
import pytest
import serial

from hil_forceps.bridge.links import adapters
from hil_forceps.bridge.links.adapters import LinkSpec, open_link, serial_notes
from hil_forceps.bridge.links.can_link import PythonCanLink
from hil_forceps.rig.errors import UserError


def problem(spec: LinkSpec) -> str:
    with pytest.raises(UserError) as caught:
        open_link(spec)
    (line,) = caught.value.problems
    assert "\n" not in line
    return line


def test_a_python_can_interface_opens_and_closes() -> None:
    connection = open_link(LinkSpec(interface="virtual", channel="adapters"))
    assert isinstance(connection.link, PythonCanLink)
    assert not connection.virtual_time
    connection.link.close()


def test_one_of_both_must_be_named() -> None:
    assert "either" in problem(LinkSpec())
    assert "either" in problem(LinkSpec(interface="virtual", serial_url="loop://"))


def test_an_unknown_interface_names_those_there_are() -> None:
    line = problem(LinkSpec(interface="socketkan", channel="can0"))
    assert line.startswith("socketkan:can0: ")
    assert "socketcan" in line


def test_a_port_that_is_not_there() -> None:
    assert "there is no such port" in problem(LinkSpec(serial_url="/dev/ttyUSB_none"))
    assert "protocol" in problem(LinkSpec(serial_url="nonsense://x"))
    assert "can't be opened" in problem(LinkSpec(serial_url="socket://127.0.0.1:1"))
    assert "can't be opened" in problem(LinkSpec(serial_url="/dev/null"))


def test_a_port_that_is_in_use() -> None:
    far, near = pty.openpty()
    first = open_link(LinkSpec(serial_url=os.ttyname(near)))
    assert "another program has it open" in problem(LinkSpec(serial_url=os.ttyname(near)))
    first.link.close()
    open_link(LinkSpec(serial_url=os.ttyname(near))).link.close()
    os.close(far)
    os.close(near)


@pytest.mark.parametrize(
    ("number", "remedy"),
    [
        (errno.EACCES, "dialout"),
        (errno.ENOENT, "list_ports"),
        (errno.EBUSY, "close that"),
    ],
)
def test_errors_of_serial_ports_have_a_remedy(monkeypatch: pytest.MonkeyPatch, number: int, remedy: str) -> None:
    def refuse(*_: object, **__: object) -> NoReturn:
        raise serial.SerialException(number, f"could not open port: {os.strerror(number)}")

    monkeypatch.setattr(serial, "serial_for_url", refuse)
    assert remedy in problem(LinkSpec(serial_url="/dev/ttyACM0"))


@pytest.mark.parametrize(
    ("number", "remedy"),
    [
        (errno.ENODEV, "ip link"),
        (errno.EAFNOSUPPORT, "modprobe can_raw"),
        (errno.EPERM, "not permitted"),
        (errno.ENETDOWN, "ip link set"),
    ],
)
def test_errors_of_can_devices_have_a_remedy(monkeypatch: pytest.MonkeyPatch, number: int, remedy: str) -> None:
    def refuse(*_: object, **__: object) -> NoReturn:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(can, "Bus", refuse)
    assert remedy in problem(LinkSpec(interface="socketcan", channel="can7"))


def test_multicast_without_a_route_says_how_to_get_one(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> NoReturn:
        raise can.CanInitializationError("could not connect to a multicast IP network")

    monkeypatch.setattr(can, "Bus", refuse)
    assert "ip route add 239.0.0.0/8 dev lo" in problem(LinkSpec(interface="udp_multicast", channel="239.74.163.2"))


def test_a_can_device_that_is_down_is_said_to_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(adapters, "NET_DEVICES", tmp_path)
    (tmp_path / "can0").mkdir()
    (tmp_path / "can0" / "flags").write_text("0x40080\n")
    line = problem(LinkSpec(interface="socketcan", channel="can0", bitrate_bit_per_s=500_000))
    assert "can0: the device is down; `ip link set can0 up type can bitrate 500000`" in line


def test_an_option_that_the_interface_does_not_know(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(**options: object) -> NoReturn:
        raise TypeError(f"unexpected keyword argument {sorted(options)[-1]!r}")

    monkeypatch.setattr(can, "Bus", refuse)
    assert "unexpected keyword argument 'zeal'" in problem(LinkSpec(interface="virtual", options={"zeal": 1}))


def test_a_slow_serial_adapter_is_pointed_out(tmp_path: Path) -> None:
    device = tmp_path / "ttyUSB0" / "device"
    device.mkdir(parents=True)
    assert serial_notes("/dev/ttyUSB0", tmp_path) == ()
    (device / "latency_timer").write_text("16\n")
    (note,) = serial_notes("/dev/ttyUSB0", tmp_path)
    assert "16 ms" in note
    link = tmp_path / "usb-FTDI_FT232R"  # as udev makes them in /dev/serial/by-id
    link.symlink_to("/dev/ttyUSB0")
    assert "16 ms" in serial_notes(str(link), tmp_path)[0]
    (device / "latency_timer").write_text("1\n")
    assert serial_notes("/dev/ttyUSB0", tmp_path) == ()
