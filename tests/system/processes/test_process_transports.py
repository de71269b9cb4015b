"""The drive as a process of its own, a host in this one, real time: every frame accounted for, clean ends.

The host holds the angle that it measured first, at 1 kHz. Counts and ratios are asserted, never times.
"""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import serial

from firmware_protocol.frames import Frame
from firmware_protocol.host.machine import HostConfig, HostMachine, HostPhase
from firmware_protocol.messages import DriveState
from firmware_protocol.serial_framing import SerialReader, encode_serial
from virtual_bus.realtime.transports import Transport, open_can

pytestmark = [pytest.mark.realtime, pytest.mark.alone, pytest.mark.slow]

ROOT = Path(__file__).resolve().parents[3]
RIG = ROOT / "configs" / "paper.yaml"
GROUP = "239.74.163.77"
PERIOD_NS = 1_000_000


class SerialTransport:
    """The host's end of a serial port."""

    def __init__(self, path: Path) -> None:
        self._port = serial.Serial(str(path), timeout=0)
        self._reader = SerialReader()
        self.counters = self._reader.counters

    def receive(self, timeout_s: float) -> list[Frame]:
        self._port.timeout = timeout_s
        data = self._port.read(1)
        return self._reader.feed(data + self._port.read(self._port.in_waiting)) if data else []

    def send(self, frames: list[Frame]) -> None:
        self._port.write(b"".join(map(encode_serial, frames)))

    def close(self) -> None:
        self._port.close()


class HoldingHost:
    """Connects, enables, holds the first angle; counts what it sent."""

    def __init__(self, transport: Transport | SerialTransport, fd: bool = False) -> None:
        self.machine = HostMachine(HostConfig(node=1, fd=fd))
        self.samples = 0
        self.setpoints = 0
        self.ages_ns: list[int] = []
        self._transport = transport
        self._angle: int | None = None
        self.machine.connect(time.monotonic_ns())

    def run(self, seconds: float, until: HostPhase | None = None, quiet: bool = False) -> None:
        """Tick at 1 kHz for so long, or until a phase is reached; when quiet only listen."""
        next_ns = time.monotonic_ns()
        end_ns = next_ns + round(seconds * 1e9)
        while time.monotonic_ns() < end_ns and (until is None or self.machine.phase is not until):
            next_ns += PERIOD_NS
            while (left_ns := next_ns - time.monotonic_ns()) > 0:
                self._listen(left_ns * 1e-9)
            self._listen(0.0)
            if not quiet:
                self._tick()

    def _listen(self, timeout_s: float) -> None:
        for frame in self._transport.receive(timeout_s):
            self.machine.receive(frame, time.monotonic_ns())

    def _tick(self) -> None:
        now_ns = time.monotonic_ns()
        samples = self.machine.take_samples()
        self.machine.take_bench()
        self.samples += len(samples)
        frames = self.machine.poll(now_ns)
        if self.machine.phase is HostPhase.READY:
            self.machine.enable()
        if self.machine.phase is HostPhase.FAULT and not self.setpoints:  # left by the host before this one
            self.machine.reset_fault()
        if samples:
            self._angle = samples[-1].theta_m if self._angle is None else self._angle
            self.ages_ns.append(now_ns - samples[-1].received_ns)
            frame = self.machine.setpoint(self._angle)
            if frame is not None:
                frames.append(frame)
                self.setpoints += 1
        self._transport.send(frames)


class Drive:
    """A drive process that is ready, and what it says."""

    def __init__(self, process: "subprocess.Popen[str]", ready: str) -> None:
        self.process = process
        self.ready = ready

    def finish(self, number: int = signal.SIGTERM) -> dict[str, Any]:
        """End it by a signal; return its summary."""
        self.process.send_signal(number)
        output, errors = self.process.communicate(timeout=30)
        assert self.process.returncode == 0, errors
        assert errors == ""
        assert output.count("\n") == 1
        summary: dict[str, Any] = json.loads(output)
        return summary


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": f"{ROOT}:{os.environ.get('PYTHONPATH', '')}"}


@contextmanager
def running(*arguments: str) -> Iterator[Drive]:
    process = subprocess.Popen(
        [sys.executable, "-m", "virtual_bus", "--rig", str(RIG), *arguments],
        cwd=ROOT,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    try:
        ready = process.stdout.readline()
        if not ready.startswith("ready "):
            pytest.fail(f"the drive did not start: {ready}{process.communicate(timeout=30)[1]}")
        yield Drive(process, ready)
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate(timeout=30)


def free_udp_port() -> str:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return str(probe.getsockname()[1])


def check_accounts(host: HoldingHost, summary: dict[str, Any], fd: bool) -> None:
    """Every frame that one side sent was received by the other or is known by its sequence to be lost."""
    machine, drive = host.machine, summary["drive"]
    sent = summary["sent"]["FD_FEEDBACK" if fd else "FEEDBACK"]
    seen = machine.counters["samples"] + machine.counters["lost_feedback"]
    # What was sent before the host had its ear at the bus is in neither count.
    assert 0 <= sent - seen < 0.2 * sent
    assert machine.counters["lost_feedback"] <= 0.01 * sent
    refused = sum(drive[name] for name in ("setpoint_stale", "sample_old", "sample_future", "not_enabled"))
    assert drive["setpoints_accepted"] + drive["setpoints_lost"] + refused >= host.setpoints - 1
    assert summary["received"]["FD_SETPOINT" if fd else "SETPOINT"] <= host.setpoints
    assert drive["setpoints_lost"] <= 0.01 * host.setpoints
    assert summary["wakes"] + summary["overruns"] >= 0.9 * sent
    assert summary["lateness"]["count"] == summary["wakes"]


def hold(transport: Transport | SerialTransport, drive: Drive, seconds: float, fd: bool = False) -> HoldingHost:
    """Enable and hold for a while, then listen only until the drive has ended."""
    host = HoldingHost(transport, fd)
    host.run(20.0, until=HostPhase.RUNNING)
    assert host.machine.phase is HostPhase.RUNNING, f"{host.machine.phase} {host.machine.counters}"
    host.run(seconds)
    assert drive.process.poll() is None
    assert host.machine.phase is HostPhase.RUNNING, f"{host.machine.fault} {host.machine.counters}"
    assert host.machine.drive_state == DriveState.OPERATIONAL
    host.run(0.2, quiet=True)
    return host


@pytest.mark.parametrize("fd", [False, True])
def test_udp_multicast(fd: bool) -> None:
    port = free_udp_port()
    mode = ["--fd"] if fd else []
    with running("--interface", "udp_multicast", "--channel", GROUP, "--option", f"port={port}", *mode) as drive:
        assert drive.ready.split()[1:3] == ["udp_multicast", GROUP]
        transport = open_can("udp_multicast", GROUP, fd, {"port": port})
        try:
            host = hold(transport, drive, 2.0, fd)
            check_accounts(host, drive.finish(), fd)
        finally:
            transport.close()


def test_serial_port_and_a_host_that_comes_back(tmp_path: Path) -> None:
    link = tmp_path / "port"
    with running("--serial-pty", str(link)) as drive:
        for _ in range(2):
            transport = SerialTransport(link)
            try:
                host = hold(transport, drive, 1.0)
            finally:
                transport.close()
            time.sleep(0.3)
        summary = drive.finish(signal.SIGINT)
        assert summary["drive"]["setpoints_accepted"] > host.setpoints
        assert host.machine.counters["lost_feedback"] <= 0.01 * summary["sent"]["FEEDBACK"]
    assert not link.is_symlink()


def test_faults_reach_a_real_transport(tmp_path: Path) -> None:
    faults = tmp_path / "faults.yaml"
    faults.write_text("- {fault: drop, function: SETPOINT, probability: 0.2}\n- {fault: duplicate, function: TIMING}\n")
    link = tmp_path / "port"
    with running("--serial-pty", str(link), "--faults", str(faults), "--seed", "3") as drive:
        transport = SerialTransport(link)
        try:
            host = hold(transport, drive, 1.0)
        finally:
            transport.close()
        summary = drive.finish()
    assert summary["faults"]["drop"] > 0.1 * host.setpoints
    assert summary["faults"]["duplicate"] == summary["sent"]["TIMING"]
    assert summary["drive"]["setpoints_lost"] > 0.1 * host.setpoints


def test_duration_ends_it_by_itself(tmp_path: Path) -> None:
    with running("--serial-pty", str(tmp_path / "port"), "--duration", "0.3") as drive:
        output, _ = drive.process.communicate(timeout=30)
    summary = json.loads(output)
    assert 0.9 * 300 <= summary["sent"]["FEEDBACK"] <= 301
    assert summary["drive"]["state"] == "DISABLED"


def test_garbage_on_the_group_is_counted_and_changes_nothing() -> None:
    port = free_udp_port()
    with running("--interface", "udp_multicast", "--channel", GROUP, "--option", f"port={port}") as drive:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
            for _ in range(50):
                stranger.sendto(b"\xc1 this is no frame", (GROUP, int(port)))
        transport = open_can("udp_multicast", GROUP, False, {"port": port})
        try:
            host = hold(transport, drive, 0.5)
        finally:
            transport.close()
        summary = drive.finish()
    assert summary["transport"]["receive_failed"] == 50
    assert host.machine.counters["samples"] > 0
