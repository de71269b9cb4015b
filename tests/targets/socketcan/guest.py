"""What the parts that run where SocketCAN is have in common: drives as processes, and a serial line with slcan."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final

import pytest

ROOT: Final = Path(__file__).resolve().parents[3]
RIG: Final = ROOT / "configs" / "paper.yaml"
FIRMWARE_VARIABLE: Final = (
    "HIL_FORCEPS_FIRMWARE"  # where hfp-drive is: nothing can be built where nothing can be written
)
SLCAN_DEVICES: Final = ("slcan0", "slcan1")
PATIENCE_S: Final = 20.0
IS_VIRTUAL: Final = os.environ.get("HIL_FORCEPS_TIME") == "virtual"  # there no sleep ends late: see punctual.py


def c_drive(device: str, *arguments: str) -> list[str]:
    """Return the command of the reference firmware on a CAN device."""
    return [os.environ[FIRMWARE_VARIABLE], "--can", device, *arguments]


def python_drive(device: str, *arguments: str) -> list[str]:
    """Return the command of the simulated drive on a CAN device."""
    where = ["--interface", "socketcan", "--channel", device, *(["--spin", "0"] if IS_VIRTUAL else [])]
    return [sys.executable, "-m", "virtual_bus", "--rig", str(RIG), *where, *arguments]


def service(*arguments: str) -> list[str]:
    """Return a `hil-forceps` command."""
    module = "tests.targets.socketcan.punctual" if IS_VIRTUAL else "hil_forceps.cli.main"
    return [sys.executable, "-m", module, *arguments]


class Drive:
    """A drive process that is ready; `ready` holds the words that it said."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        assert process.stdout is not None
        self.process = process
        self.ready = process.stdout.readline().split()
        if self.ready[:1] != ["ready"]:
            pytest.fail(f"the drive did not start: {process.communicate(timeout=PATIENCE_S)}")


@contextmanager
def running(command: Sequence[str]) -> Iterator[Drive]:
    """Run a drive while the body runs."""
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        try:
            yield Drive(process)
        finally:
            process.send_signal(signal.SIGCONT)  # one that a test has stopped could not end
            process.terminate()
            try:
                process.communicate(timeout=PATIENCE_S)
            except subprocess.TimeoutExpired:
                process.kill()
                raise


@contextmanager
def slcan_line() -> Iterator[tuple[str, str]]:
    """Make a serial line with a CAN device of the kernel at either end, both by slcand, as a user would."""
    with running([sys.executable, "-m", "tests.targets.socketcan.relay"]) as cable, ExitStack() as daemons:
        for port, device in zip(cable.ready[1:], SLCAN_DEVICES, strict=True):
            command = ["slcand", "-F", "-o", "-s8", port, device]
            daemon = daemons.enter_context(
                subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            )
            daemons.callback(daemon.terminate)
            _wait_for(device)
            subprocess.run(["ip", "link", "set", device, "txqueuelen", "1000", "up"], check=True)
        yield SLCAN_DEVICES


def _wait_for(device: str) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while not Path("/sys/class/net", device).exists():
        assert time.monotonic() < end_s, f"{device} did not come"
        time.sleep(0.01)
