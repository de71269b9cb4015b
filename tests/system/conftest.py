"""What the system tests share: the installed command as processes, ends of a wire, and what they say."""

import json
import os
import signal
import socket
import stat
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAPER = ROOT / "configs" / "paper.yaml"
GROUP = "239.74.163.78"
PATIENCE_S = 120.0  # nothing takes so long where nothing else runs


class Ended(NamedTuple):
    """How a process ended."""

    code: int
    out: str
    err: str

    @property
    def told(self) -> dict[str, Any]:
        """The line of JSON that a drive ends with."""
        summary: dict[str, Any] = json.loads(self.out.splitlines()[-1])
        return summary


class Command:
    """A `hil-forceps` process in a session of its own."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self.process = process

    def signal(self, number: int) -> None:
        """Send a signal to this process alone."""
        self.process.send_signal(number)

    def first_line(self) -> str:
        """Wait for the first line on standard output."""
        assert self.process.stdout is not None
        return self.process.stdout.readline()

    def end(self, number: int | None = None) -> Ended:
        """Send a signal, if any, and wait for the end."""
        if number is not None:
            self.signal(number)
        out, err = self.process.communicate(timeout=PATIENCE_S)
        return Ended(self.process.returncode, out, err)


Start = Callable[..., Command]


@pytest.fixture
def start() -> Iterator[Start]:
    """Start `hil-forceps ARGUMENTS`; what is left at the end of the test is killed."""
    running: list[Command] = []

    def begin(*arguments: object, **options: Any) -> Command:
        process = subprocess.Popen(
            [sys.executable, "-m", "hil_forceps.cli.main", *map(str, arguments)],
            env={**os.environ, "PYTHONPATH": f"{ROOT}:{os.environ.get('PYTHONPATH', '')}"},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            **options,
        )
        # A host that sleeps through 20 ms meets the drive's watchdog: where allowed, be ahead of what else runs here.
        with suppress(PermissionError):
            os.setpriority(os.PRIO_PROCESS, process.pid, -15)
        running.append(Command(process))
        return running[-1]

    yield begin
    for command in running:
        if command.process.poll() is None:
            os.killpg(command.process.pid, signal.SIGKILL)
        command.process.communicate()


class Wire(NamedTuple):
    """What the two ends of a wire are called."""

    drive: tuple[str, ...]
    host: tuple[str, ...]


def make_wire(kind: str, folder: Path) -> Wire:
    """Name both ends of a new pty or of a multicast group on a free port."""
    if kind == "pty":
        return Wire(("--serial-pty", str(folder / "port")), ("--serial", str(folder / "port")))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("", 0))
        port = free.getsockname()[1]
    both = ("--interface", kind, "--channel", GROUP, "--option", f"port={port}")
    return Wire(both, both)


@pytest.fixture(params=["pty", "udp_multicast"])
def wire(request: pytest.FixtureRequest, tmp_path: Path) -> Wire:
    """One wire of each kind."""
    return make_wire(request.param, tmp_path)


@pytest.fixture
def pty_wire(tmp_path: Path) -> Wire:
    """A wire where the kind does not matter."""
    return make_wire("pty", tmp_path)


@pytest.fixture
def patient_rig(tmp_path: Path) -> Path:
    """The paper's rig with a host at 100 Hz, so with a watchdog of 50 ms: these tests do not run alone."""
    text = PAPER.read_text().replace("host_period_s: 1.0e-3", "host_period_s: 1.0e-2")
    assert text != PAPER.read_text()
    path = tmp_path / "patient.yaml"
    path.write_text(text)
    return path


@pytest.fixture
def drive(start: Start, patient_rig: Path) -> Callable[..., Command]:
    """Start a drive and wait until it listens."""

    def begin(wire: Wire, *more: str, rig: Path = patient_rig) -> Command:
        command = start("drive", "--rig", rig, "--simulation", "2", *wire.drive, *more)
        assert command.first_line().startswith("ready ")
        return command

    return begin


@pytest.fixture
def run(start: Start, patient_rig: Path) -> Callable[..., Command]:
    """Start `run` against a wire."""

    def begin(wire: Wire, out: Path, *more: str, rig: Path = patient_rig, **options: Any) -> Command:
        return start("run", "--rig", rig, "--out", out, *wire.host, *more, **options)

    return begin


def wait_until(what: Callable[[], bool], command: Command) -> None:
    """Wait for something to come true while a process lives."""
    end = time.monotonic() + PATIENCE_S
    while not what():
        assert command.process.poll() is None, f"ended: {command.end()}"
        assert time.monotonic() < end, "it did not come"
        time.sleep(0.02)


@pytest.fixture
def operational() -> Callable[[Command, Path], None]:
    """Wait until a run is well under way: its recording holds a chunk of operational samples."""

    def wait(command: Command, out: Path, chunks: int = 2) -> None:
        recording = out / "run.mcap"
        wait_until(lambda: recording.exists() and recording.stat().st_size > 12_000 + chunks * 20_000, command)

    return wait


@pytest.fixture
def always_full() -> Callable[[Path], None]:
    """Make a file that takes nothing: a device like /dev/full; skipped where making one is not permitted."""

    def make(path: Path) -> None:
        try:
            os.mknod(path, stat.S_IFCHR | 0o666, Path("/dev/full").stat().st_rdev)
            with path.open("wb", buffering=0):
                pass
        except OSError:
            pytest.skip("making a device is not permitted here")

    return make
