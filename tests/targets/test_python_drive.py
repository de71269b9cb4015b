"""The Python drive: in virtual time, and as a process over a pseudo terminal and over UDP multicast, in real time."""

import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.targets.closed_loop import ages_us, check_loop, figures_of, in_process
from tests.targets.record import ROOT, Part, recorded
from tests.targets.suite import DRIVE_AHEAD, ENVIRONMENT, check, judge, measure_torque_free

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

RIG = ROOT / "configs" / "paper.yaml"
GROUP = "239.74.163.79"


@contextmanager
def drive(*arguments: str) -> Iterator[None]:
    command = [*DRIVE_AHEAD, sys.executable, "-m", "virtual_bus", "--rig", str(RIG), "--simulation", "0", *arguments]
    with subprocess.Popen(command, cwd=ROOT, env=ENVIRONMENT, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            assert process.stdout.readline().startswith("ready ")
            yield
        finally:
            process.terminate()
            process.communicate(timeout=30)


def multicast_line() -> tuple[str, ...]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        port = f"port={probe.getsockname()[1]}"
    return ("--interface", "udp_multicast", "--channel", GROUP, "--option", port, "--fd")


def test_in_virtual_time(tmp_path: Path) -> None:
    line = ("--interface", "virtual_forceps", "--channel", "bench", "--option", f"rig={RIG}")
    with recorded("python-virtual-time", Part.CONFORMANCE) as record:
        certificate = judge(record, tmp_path, *line, "--option", "simulation=0")
        check(certificate, 77, least_share=1.0)
        assert certificate["time"] == "virtual"


def test_time_to_no_torque_in_virtual_time(tmp_path: Path) -> None:
    line = ("--interface", "virtual_forceps", "--channel", "bench", "--option", f"rig={RIG}")
    with recorded("python-virtual-time", Part.TORQUE_FREE) as record:
        measure_torque_free(record, tmp_path, *line, "--option", "simulation=0")


def test_simulation_2_in_virtual_time() -> None:
    """The figure beside which those of the other targets stand."""
    with recorded("python-virtual-time", Part.LOOP) as record:
        executed = in_process()
        latency = "virtual time, from a sample to its setpoint"
        figures = figures_of(executed, latency, ages_us(executed))
        record.loop(figures)
        check_loop(figures)


@pytest.mark.realtime
@pytest.mark.long
def test_over_a_pseudo_terminal(tmp_path: Path) -> None:
    link = tmp_path / "port"
    with recorded("python-pty", Part.CONFORMANCE) as record, drive("--serial-pty", str(link)):
        certificate = judge(record, tmp_path / "out", "--serial", str(link))
        check(certificate, 86)
        assert certificate["time"] == "real"
        assert "issued" in certificate


@pytest.mark.realtime
@pytest.mark.long
def test_time_to_no_torque_over_a_pseudo_terminal(tmp_path: Path) -> None:
    link = tmp_path / "port"
    with recorded("python-pty", Part.TORQUE_FREE) as record, drive("--serial-pty", str(link)):
        measure_torque_free(record, tmp_path / "out", "--serial", str(link))


@pytest.mark.realtime
@pytest.mark.long
def test_over_udp_multicast_fd(tmp_path: Path) -> None:
    line = multicast_line()
    with recorded("python-udp-multicast", Part.CONFORMANCE) as record, drive(*line):
        check(judge(record, tmp_path / "out", *line), 83)


@pytest.mark.realtime
@pytest.mark.long
def test_time_to_no_torque_over_udp_multicast_fd(tmp_path: Path) -> None:
    line = multicast_line()
    with recorded("python-udp-multicast", Part.TORQUE_FREE) as record, drive(*line):
        measure_torque_free(record, tmp_path / "out", *line)
