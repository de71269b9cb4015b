"""References over a real socket into a run, and estimates back: two processes and a sender."""

import json
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil_forceps.bridge.teleoperation.datagrams import (
    REFERENCE_BYTES,
    ReferenceDatagram,
    pack_reference,
)
from hil_forceps.bridge.teleoperation.reference_input import ReferenceInput
from hil_forceps.bridge.teleoperation.udp_server import UdpReferences
from hil_forceps.cli import main as cli
from hil_forceps.cli.arguments.references import open_references, read_token
from hil_forceps.data.recording.reader import read_recording
from hil_forceps.rig import load_rig
from hil_forceps.rig.errors import UserError

ROOT = Path(__file__).resolve().parents[3]
EXAMPLE = ROOT / "docs" / "examples" / "teleoperate.py"
PAPER = ROOT / "configs" / "paper.yaml"
TOKEN = b"0123456789abcdef-and-more"

# Fixtures of conftest.py; what they hand out is described there.
DriveFixture = Callable[..., Any]
RunFixture = Callable[..., Any]


def port_of(command: Any) -> int:
    """Wait until a run says where it waits for references."""
    for line in iter(command.process.stderr.readline, ""):
        if found := re.search(r"waiting for references at UDP port (\d+)", line):
            return int(found[1])
    raise AssertionError(command.end())


@pytest.mark.realtime
@pytest.mark.slow
def test_the_example_leads_the_jaw_and_its_end_ends_the_run(
    drive: DriveFixture, run: RunFixture, start: Any, pty_wire: Any, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    other = drive(pty_wire)
    # Patient: this machine may do other things, too, and a sender that pauses for 50 ms is lost.
    service = run(pty_wire, out, "--references", "0", "--references-timeout", "0.5")
    port = port_of(service)
    command = [sys.executable, str(EXAMPLE), str(port), "4"]
    sender = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    ended = service.end()
    told = other.end(signal.SIGTERM).told
    result = json.loads((out / "run.json").read_text())
    assert ended.code == 2
    assert result["reason"] == "reference_lost"
    assert result["drive_disabled"]
    assert told["drive"]["state"] == "DISABLED"
    outside = result["counters"]["outside"]
    assert outside["accepted"] >= 200
    assert outside["wrong_session"] >= 1  # the first, before it knew
    lines = sender.stdout.splitlines()
    assert any(line.endswith("stage 2") for line in lines)
    assert all(re.match(r" *\d+\.\d\d s  θ_j [+-nan.\d]+ rad  τ_w [+-nan.\d]+ mN m  stage \d", line) for line in lines)
    recording = read_recording(out / "run.mcap")
    wanted = recording.references["theta_j_ref_rad"]
    assert np.nanmax(wanted) == pytest.approx(np.pi / 2 + 0.1, abs=1e-3)
    assert np.nanmin(wanted) == pytest.approx(np.pi / 2 - 0.1, abs=1e-3)
    assert np.ptp(recording.bench["theta_j_rad"][-1000:]) > 0.02  # the jaw went along
    replayed = start("replay", out / "run.mcap").end()
    assert (replayed.code, replayed.err) == (0, "")
    assert "all identical" in replayed.out


class Near:
    """A sender beside a socket that is looked at without any loop."""

    def __init__(self, token: bytes = b"", server_token: bytes | None = None) -> None:
        self.token = token
        self.taken = ReferenceInput(9, 50_000_000)
        wanted = token if server_token is None else server_token
        self.server = UdpReferences([self.taken], [load_rig(PAPER).plant()], ("127.0.0.1", 0), wanted)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(("127.0.0.1", self.server.port))
        self.socket.settimeout(0.2)
        self.number = 0

    def send(self, **changes: Any) -> None:
        self.number += 1
        made = ReferenceDatagram(9, 0, self.number, self.number * 1000, 0.5)._replace(**changes)
        self.socket.send(pack_reference(made, self.token))

    def look(self) -> None:
        time.sleep(0.01)
        self.server.receive(self.number * 1000)

    def close(self) -> None:
        self.server.close()
        self.socket.close()


@pytest.fixture
def near() -> Iterator[Callable[..., Near]]:
    opened: list[Near] = []

    def make(*arguments: Any) -> Near:
        opened.append(Near(*arguments))
        return opened[-1]

    yield make
    for each in opened:
        each.close()


def test_what_is_no_datagram_is_counted_and_not_answered(near: Callable[..., Near]) -> None:
    made = near()
    for data in (b"x", bytes(REFERENCE_BYTES), bytes(REFERENCE_BYTES + 1), b"\xff" * 1400):
        made.socket.send(data)
    made.look()
    assert made.server.counters["malformed"] == 4
    assert made.server._pending == []
    made.send()
    made.look()
    assert made.taken.counters["accepted"] == 1
    made.send(axis=7)
    made.look()
    assert made.server.counters["no_such_axis"] == 1


def test_who_has_not_the_token_is_not_answered(near: Callable[..., Near]) -> None:
    for token, wanted in ((b"", TOKEN), (b"another token 16", TOKEN), (TOKEN, b"")):
        made = near(token, wanted)
        made.send()
        made.look()
        assert made.server.counters["bad_tag"] == 1
        assert made.taken.counters["accepted"] == 0
        assert made.server._pending == []
    made = near(TOKEN)
    made.send()
    made.look()
    assert made.taken.counters["accepted"] == 1


def test_a_flood_is_taken_in_pieces_and_makes_nothing_old(near: Callable[..., Near]) -> None:
    made = near()
    for _ in range(5000):
        made.send()
    calls = 0
    while True:
        before = made.taken.counters["accepted"]
        made.look()
        calls += 1
        if made.taken.counters["accepted"] == before:
            break
        assert made.taken.counters["accepted"] - before <= 32
    assert calls > 2
    assert made.taken.counters["accepted"] < 500  # what the system keeps is small, the rest was pushed out
    made.send()
    made.look()
    assert made.taken.counters["accepted"] > 0


def test_it_listens_on_loopback_unless_told_otherwise_and_then_wants_a_token(tmp_path: Path) -> None:
    rig = load_rig(PAPER)
    opened = open_references([rig], "0", None, None)
    try:
        assert opened._socket.getsockname()[0] == "127.0.0.1"
        taken = opened.port
        with pytest.raises(UserError, match="can't be opened: Address already in use"):
            open_references([rig], str(taken), None, None)
    finally:
        opened.close()
    with pytest.raises(UserError, match="references from other computers require a token"):
        open_references([rig], "192.0.2.1:47100", None, None)
    token = tmp_path / "token"
    token.write_bytes(TOKEN + b"\n")
    token.chmod(0o644)
    with pytest.raises(UserError, match="other users can read the file; chmod 600"):
        read_token(token)
    token.chmod(0o600)
    assert read_token(token) == TOKEN
    with pytest.raises(UserError, match="can't be opened"):  # an address that this machine has not
        open_references([rig], "192.0.2.1:47100", token, None)
    token.write_bytes(b"short")
    with pytest.raises(UserError, match="must have 16 to 4096 bytes"):
        read_token(token)
    with pytest.raises(UserError, match="No such file"):
        read_token(tmp_path / "none")
    for timeout_s in (0.0, -1.0, 2.0, float("nan")):
        with pytest.raises(UserError, match="--references-timeout"):
            open_references([rig], "0", None, timeout_s)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--references", "nowhere"), "--references nowhere: must be PORT or ADDRESS:PORT"),
        (("--references-token", "token"), "--references-token: only with --references"),
        (("--references-timeout", "0.1"), "--references-timeout: only with --references"),
        (("--references", "0", "--trajectory", str(ROOT / "x.csv")), "the jaw follows only one of them"),
    ],
)
def test_options_that_do_not_go_together_are_told(
    tmp_path: Path, options: tuple[str, ...], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    bus = ("--interface", "udp_multicast", "--channel", "239.74.163.79")
    with pytest.raises(SystemExit) as ended:
        cli.main(["run", "--rig", str(PAPER), *bus, "--out", str(tmp_path / "out"), *options])
    assert ended.value.code == 2
    assert words in capsys.readouterr().err
