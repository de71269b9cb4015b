"""The C firmware on a Cortex-M4F: QEMU's mps2-an386, serial packets over its UART."""

import shutil
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from hil_forceps.bridge.links.adapters import LinkSpec, open_link
from tests.firmware_library import make
from tests.targets.closed_loop import check_loop, check_same_motion, close_loop
from tests.targets.lockstep import ANSWER_BYTES, PATIENCE_S
from tests.targets.record import Part, TargetRecord, recorded
from tests.targets.setting import LONG, without_long
from tests.targets.suite import DRIVE_AHEAD, check, judge, measure_torque_free

# The suite is real time; QEMU stops now and then for longer than a bus, and takes a flood byte by byte.
pytestmark = [pytest.mark.realtime, pytest.mark.slow, pytest.mark.timeout(600)]

TARGET = "qemu-mps2-uart"
QEMU = "qemu-system-arm"
MARGINS = ("--line-ms", "60", "--flood-s", "200")


class StreamPlantLine:
    """Requests and answers one after the other over a Unix socket: QEMU's second UART."""

    def __init__(self, path: Path) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.settimeout(PATIENCE_S)
        self._socket.connect(str(path))

    def exchange(self, request: bytes) -> bytes:
        self._socket.sendall(request)
        answer = b""
        while len(answer) < ANSWER_BYTES:
            part = self._socket.recv(ANSWER_BYTES - len(answer))
            if not part:
                raise ConnectionResetError("the emulator is gone")
            answer += part
        return answer

    def close(self) -> None:
        self._socket.close()


def require_emulator(record: TargetRecord) -> None:
    for tool, package in ((QEMU, "qemu-system-arm"), ("arm-none-eabi-gcc", "gcc-arm-none-eabi")):
        if shutil.which(tool) is None:
            record.not_available(f"no {tool}; tools/installation/install_targets.sh installs {package}")


@contextmanager
def emulator(image: str, second_uart: Path | None = None) -> Iterator[str]:
    """Run an image; yields the pyserial URL of its first UART. The second is a Unix socket."""
    make("mps2")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    lines = [f"tcp:127.0.0.1:{port},server=on,wait=off,nodelay=on"]
    if second_uart is not None:
        lines.append(f"unix:{second_uart},server=on,wait=off")
    machine = ["-M", "mps2-an386", "-nographic", "-monitor", "none", "-kernel", str(image_path(image))]
    command = [*DRIVE_AHEAD, QEMU, *machine]
    command += [word for line in lines for word in ("-serial", line)]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    try:
        await_true(process, lambda: takes_connections(port) and (second_uart is None or second_uart.exists()))
        yield f"socket://127.0.0.1:{port}"
    finally:
        process.kill()
        process.communicate(timeout=30)


def image_path(image: str) -> Path:
    return make("mps2").parent / "arm" / f"{image}.elf"


def takes_connections(port: int) -> bool:
    try:
        with socket.create_connection(("127.0.0.1", port), 1.0):
            return True
    except OSError:
        return False


def await_true(process: "subprocess.Popen[str]", what: Callable[[], bool]) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while not what():
        if process.poll() is not None or time.monotonic() > end_s:
            process.kill()
            pytest.fail(f"{QEMU} did not come up: {process.communicate()[1]}")
        time.sleep(0.02)


@pytest.mark.long
def test_conformance(tmp_path: Path) -> None:
    with recorded(TARGET, Part.CONFORMANCE) as record:
        require_emulator(record)
        with emulator("mps2") as url:
            check(judge(record, tmp_path / "out", "--serial", url, *MARGINS, *without_long()), 86 - len(LONG))


def test_time_to_no_torque(tmp_path: Path) -> None:
    with recorded(TARGET, Part.TORQUE_FREE) as record:
        require_emulator(record)
        with emulator("mps2") as url:
            measure_torque_free(record, tmp_path / "out", "--serial", url, *MARGINS[:2])


def test_simulation_2(tmp_path: Path) -> None:
    path = tmp_path / "plant"
    with recorded(TARGET, Part.LOOP) as record:
        require_emulator(record)
        with emulator("mps2_plant", path) as url:
            plant = StreamPlantLine(path)
            try:
                figures = close_loop(record, open_link(LinkSpec(serial_url=url)).link, plant, tmp_path)
                check_loop(figures)
                check_same_motion(figures)
            finally:
                plant.close()
