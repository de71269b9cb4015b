"""Nothing listens to a network unless it is told to."""

import ast
import json
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import pytest

from firmware_protocol.frames import Frame
from hil_forceps.bridge.links import loopback
from hil_forceps.bridge.links.adapters import LinkSpec, open_link
from hil_forceps.rig.errors import UserError
from virtual_bus.realtime import transports

ROOT = Path(__file__).parents[3]
PACKAGES = ("hil_forceps", "virtual_bus", "firmware_protocol")
GROUP = "239.74.163.77"
LISTENS = {"bind", "listen", "create_server", "start_server", "create_datagram_endpoint", "serve_forever"}
# Who listens, each with the test that it is loopback unless told otherwise.
LISTENING = {
    "hil_forceps/live/server.py",  # tests/system/live/test_live_page.py
    "hil_forceps/live/foxglove.py",  # tests/system/live/test_live_run.py
    "hil_forceps/bridge/teleoperation/udp_server.py",  # tests/system/processes/test_teleoperation.py
}
NO_SOCKETS = {"s", "drive"}  # a session of conformance, and a module: both listen to a drive


def calls() -> Iterator[tuple[Path, ast.Call]]:
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Call):
                    yield path, node


def test_no_code_of_ours_opens_a_port_for_others() -> None:
    """Sockets are connected; what python-can binds is looked at below."""
    found = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path, node in calls()
        if str(path.relative_to(ROOT)) not in LISTENING
        and isinstance(node.func, ast.Attribute)
        and node.func.attr in LISTENS
        and not (isinstance(node.func.value, ast.Name) and node.func.value.id in NO_SOCKETS)
    ]
    assert found == []


def test_no_address_of_all_interfaces_is_in_the_code() -> None:
    for path in (each for package in PACKAGES for each in (ROOT / package).rglob("*.py")):
        assert "0.0.0.0" not in path.read_text(encoding="utf-8"), path


def port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


@pytest.fixture
def number() -> int:
    """A port; skipped where python-can can't have a multicast socket at all."""
    free = port()
    try:
        can.Bus(interface="udp_multicast", channel=GROUP, port=free).shutdown()
    except (can.CanError, OSError) as error:
        pytest.skip(f"no multicast here: {error}")
    return free


def settings(descriptor: int) -> tuple[str, int]:
    with socket.socket(fileno=socket.dup(descriptor)) as same:
        device = same.getsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, 16)
        return device.rstrip(b"\0").decode(), same.getsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL)


def buses(monkeypatch: pytest.MonkeyPatch) -> list[can.BusABC]:
    opened: list[can.BusABC] = []
    make: Any = can.Bus

    def keep(*arguments: Any, **options: Any) -> can.BusABC:
        opened.append(make(*arguments, **options))
        return opened[-1]

    monkeypatch.setattr(can, "Bus", keep)
    return opened


def test_udp_multicast_stays_on_this_machine(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = buses(monkeypatch)
    spec = LinkSpec(interface="udp_multicast", channel=GROUP, options={"port": number})
    first, second = open_link(spec), open_link(spec)
    drive = transports.open_can("udp_multicast", GROUP, False, {"port": str(number)})
    try:
        assert first.notes == ()
        assert [settings(bus.fileno()) for bus in opened] == [("lo", 0)] * 3
        frame = Frame(0x123, b"ab")
        first.link.send(frame)
        assert [each.arbitration_id for each in drive.receive(1.0)] == [0x123]
        assert [each for _, each in second.link.receive()] == [frame]
    finally:
        for each in (first.link, second.link, drive):
            each.close()


def test_what_comes_over_another_interface_is_not_heard(number: int) -> None:
    drive = transports.open_can("udp_multicast", GROUP, False, {"port": str(number)})
    outside = can.Bus(interface="udp_multicast", channel=GROUP, port=number)  # as any program in the network
    try:
        outside.send(can.Message(arbitration_id=0x41, data=b"reference"[:8], is_extended_id=False))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as near:
            near.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
            near.sendto(b"\xc1 no frame", (GROUP, number))
        assert drive.receive(0.2) == []
        assert drive.counters["receive_failed"] == 1  # the one over loopback
    finally:
        outside.shutdown()
        drive.close()


def test_an_option_lets_it_out_and_says_so(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = buses(monkeypatch)
    spec = LinkSpec(interface="udp_multicast", channel=GROUP, options={"port": number, "hop_limit": 1})
    connection = open_link(spec)
    drive = transports.open_can("udp_multicast", GROUP, False, {"port": str(number), "hop_limit": "1"})
    try:
        (note,) = connection.notes
        assert "whoever is in this network can read frames and send references" in note
        assert [settings(bus.fileno()) for bus in opened] == [("", 1)] * 2
    finally:
        connection.link.close()
        drive.close()


def test_where_it_can_not_be_kept_it_is_not_opened(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = buses(monkeypatch)
    monkeypatch.setattr(loopback, "LOOPBACK", "no_such")
    with pytest.raises(UserError, match="can't be limited to this computer"):
        open_link(LinkSpec(interface="udp_multicast", channel=GROUP, options={"port": number}))
    assert opened[0].fileno() == -1 or getattr(opened[0], "_is_shutdown", False)


def test_a_pseudo_terminal_is_this_users_alone(tmp_path: Path) -> None:
    link = tmp_path / "port"
    command = [sys.executable, "-m", "virtual_bus", "--rig", str(ROOT / "configs" / "realistic.yaml"), "--serial-pty"]
    with subprocess.Popen([*command, str(link), "--duration", "1"], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        ready = process.stdout.readline()
        mode = link.stat().st_mode & 0o777
        assert json.loads(process.stdout.read())
    assert ready.startswith("ready serial")
    assert mode & 0o006 == 0  # nobody else reads or writes it
