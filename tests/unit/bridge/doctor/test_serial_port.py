"""A serial port, by recorded trees of /dev and /sys/class/tty."""

import errno
from pathlib import Path

import pytest

from hil_forceps.bridge.doctor import multicast, serial_port
from hil_forceps.bridge.doctor.check import Check, Verdict
from hil_forceps.rig.sections import Limits
from tests.recorded_machine import Recorded

TIMER = "/sys/class/tty/ttyUSB0/device/latency_timer"


def port(root: Path, latency: str = "1\n") -> Recorded:
    recorded = Recorded(
        root,
        {"/dev/ttyUSB0": "", TIMER: latency, "/sys/bus/usb-serial/drivers/ftdi_sio/x": "", "/dev/serial/by-id/x": ""},
    )
    driver = root / "sys/class/tty/ttyUSB0/device/driver"
    driver.symlink_to(root / "sys/bus/usb-serial/drivers/ftdi_sio")
    (root / "dev/serial/by-id/usb-FTDI").symlink_to(root / "dev/ttyUSB0")
    return recorded


def looked(recorded: Recorded, path: str = "/dev/ttyUSB0") -> dict[str, Check]:
    return {check.id: check for check in serial_port.checks(recorded, path, Limits())}


@pytest.mark.parametrize("path", ["/dev/ttyUSB0", "/dev/serial/by-id/usb-FTDI"])
def test_a_port_that_is_set_up_is_well(tmp_path: Path, path: str) -> None:
    found = looked(port(tmp_path), path)
    assert found["serial.port"].verdict is Verdict.OK
    assert (found["serial.driver"].verdict, found["serial.driver"].text) == (Verdict.OK, "ftdi_sio")
    assert found["serial.latency"].verdict is Verdict.OK
    assert found["serial.low_latency"].verdict is Verdict.UNKNOWN


@pytest.mark.parametrize(
    ("latency", "verdict", "text"),
    [
        ("16\n", Verdict.FAIL, "16 ms: samples are older than limits.max_sample_age_s (3 ms)"),
        ("2\n", Verdict.WARN, "2 ms"),
        ("sixteen", Verdict.UNKNOWN, "contains no number"),
    ],
)
def test_an_adapter_that_holds_bytes_back(tmp_path: Path, latency: str, verdict: Verdict, text: str) -> None:
    check = looked(port(tmp_path, latency))["serial.latency"]
    assert check.verdict is verdict
    assert text in check.text
    if verdict is not Verdict.UNKNOWN:
        assert check.remedy == f"echo 1 | sudo tee {TIMER}"
        assert check.value == float(latency)


def test_a_port_of_another_users_or_none_fails(tmp_path: Path) -> None:
    recorded = port(tmp_path)
    recorded.opens = False
    assert "dialout" in looked(recorded)["serial.port"].remedy
    recorded.opens = None
    assert "list_ports" in looked(recorded)["serial.port"].remedy
    (only,) = looked(recorded, "/dev/ttyUSB7").values()
    assert only.verdict is Verdict.FAIL


def test_a_uart_tells_its_flag(tmp_path: Path) -> None:
    recorded = Recorded(tmp_path, {"/dev/ttyS0": "", "/sys/class/tty/ttyS0/flags": "0x10000040\n"})
    check = looked(recorded, "/dev/ttyS0")["serial.low_latency"]
    assert (check.verdict, check.remedy) == (Verdict.WARN, "setserial /dev/ttyS0 low_latency")
    recorded.put({"/sys/class/tty/ttyS0/flags": "0x10002040\n"})
    assert looked(recorded, "/dev/ttyS0")["serial.low_latency"].verdict is Verdict.OK
    recorded.put({"/sys/class/tty/ttyS0/flags": "0x"})
    assert looked(recorded, "/dev/ttyS0")["serial.low_latency"].verdict is Verdict.UNKNOWN


def test_odd_paths_do_not_raise(tmp_path: Path) -> None:
    recorded = port(tmp_path)
    (tmp_path / "dev/circle").symlink_to(tmp_path / "dev/circle")
    for path in ("/dev/circle", "/dev/\0", "", "n" * 5000, "../../../etc/passwd"):
        assert looked(recorded, path)["serial.port"].id == "serial.port"
    assert looked(recorded, "socket://127.0.0.1:1")["serial.port"].verdict is Verdict.UNKNOWN


def test_a_port_that_can_not_be_looked_at_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorded = port(tmp_path)

    def refuse(path: str) -> str:
        raise OSError(errno.EACCES, "Permission denied", path)

    monkeypatch.setattr(recorded, "text", refuse)
    assert "Permission denied" in looked(recorded)["serial.low_latency"].text


def test_multicast_that_leaves_the_machine_is_warned_of() -> None:
    (check,) = multicast.checks({})
    assert check.verdict is Verdict.OK
    (check,) = multicast.checks({"hop_limit": 1, "port": 5})
    assert check.verdict is Verdict.WARN
    assert "hop_limit" in check.remedy
