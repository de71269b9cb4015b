"""The C firmware as a process, over a pseudo terminal and over UDP."""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import pytest

from hil_forceps.bridge.links.adapters import LinkSpec, open_link
from tests.firmware_library import make
from tests.targets.closed_loop import check_loop, check_same_motion, close_loop, drive_arguments
from tests.targets.lockstep import UdpPlantLine
from tests.targets.record import Part, recorded
from tests.targets.suite import DRIVE_AHEAD, check, judge, measure_torque_free

pytestmark = [pytest.mark.realtime, pytest.mark.slow, pytest.mark.timeout(600)]

# UDP keeps packets whole, so HFP-162, which cuts them, says nothing there.
LINES = pytest.mark.parametrize(("line", "applicable"), [("pty", 86), pytest.param("udp", 87, marks=pytest.mark.long)])


class Process(NamedTuple):
    """A drive that is ready."""

    url: str
    plant_port: int  # 0: a test plant of its own


@contextmanager
def drive(line: str, folder: Path, *arguments: str) -> Iterator[Process]:
    where = ("--serial-pty", str(folder / "port")) if line == "pty" else ("--udp", "127.0.0.1:0")
    command = [*DRIVE_AHEAD, str(make("host") / "hfp-drive"), *where, *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            ready = process.stdout.readline().split()
            assert ready[:1] == ["ready"]
            plant_port = int(ready[-1]) if "plant" in ready else 0
            yield Process(str(folder / "port") if line == "pty" else f"udp://{ready[2]}", plant_port)
        finally:
            process.terminate()
            process.communicate(timeout=30)


@LINES
def test_conformance(line: str, applicable: int, tmp_path: Path) -> None:
    with recorded(f"c-process-{line}", Part.CONFORMANCE) as record, drive(line, tmp_path) as process:
        check(judge(record, tmp_path / "out", "--serial", process.url), applicable)


@LINES
def test_time_to_no_torque(line: str, applicable: int, tmp_path: Path) -> None:  # noqa: ARG001 - the same lines
    with recorded(f"c-process-{line}", Part.TORQUE_FREE) as record, drive(line, tmp_path) as process:
        measure_torque_free(record, tmp_path / "out", "--serial", process.url)


@LINES
def test_simulation_2(line: str, applicable: int, tmp_path: Path) -> None:  # noqa: ARG001 - the same lines
    arguments = ("--plant", "127.0.0.1:0", *drive_arguments())
    with recorded(f"c-process-{line}", Part.LOOP) as record, drive(line, tmp_path, *arguments) as process:
        plant = UdpPlantLine(("127.0.0.1", process.plant_port))
        try:
            link = open_link(LinkSpec(serial_url=process.url)).link
            figures = close_loop(record, link, plant, tmp_path)
            check_loop(figures)
            check_same_motion(figures)
        finally:
            plant.close()
