"""The reference firmware as a process, under ASan and UBSan: its links, its clean end, a plant outside as its clock."""

import json
import os
import signal
import socket
import struct
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol import codec
from firmware_protocol.drive.config import DriveConfig
from firmware_protocol.drive.machine import DriveMachine
from firmware_protocol.frames import Frame
from firmware_protocol.host.machine import HostConfig, HostMachine, HostPhase
from firmware_protocol.messages import DriveState, FaultReason, HostHeartbeat, Timing
from firmware_protocol.serial_framing import SerialReader, encode_serial
from tests.firmware_library import make
from virtual_bus.plant.position_loop import LoopParameters, LoopState, loop_step

SERIAL = 0xC0DE_0000_0001
PATIENT = ("--watchdog_timeout_us", "500000", "--host_heartbeat_timeout_us", "2000000", "--max_sample_age", "127")
GAINS = LoopParameters(1.0e-3, 1.2, 15.0, 6.0e-3, 150.0, 1.0)


class Process:
    """A drive process that is ready; `summary` once it has ended."""

    def __init__(self, arguments: tuple[str, ...]) -> None:
        self.summary: dict[str, int] = {}
        self.child = subprocess.Popen(
            [str(make("host", "sanitize") / "hfp-drive"), *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        assert self.child.stdin
        assert self.child.stdout
        assert self.child.stderr
        self.told = self.child.stderr if "--stdio" in arguments else self.child.stdout
        self.ready = self.told.readline().decode().split()
        assert self.ready[:1] == ["ready"], self.child.stderr.read()

    def stop(self) -> None:
        if self.child.poll() is None:
            self.child.terminate()
        self.summary = json.loads(self.told.read().decode().splitlines()[-1])
        assert self.child.wait(5) == 0


@contextmanager
def drive(*arguments: str) -> Iterator[Process]:
    process = Process(arguments)
    try:
        yield process
        process.stop()
    finally:
        process.child.kill()
        process.child.wait()
        for stream in (process.child.stdin, process.child.stdout, process.child.stderr):
            if stream:
                stream.close()


Link = tuple[Callable[[], bytes], Callable[[bytes], Any]]


def file_link(read: int, write: int) -> Link:
    os.set_blocking(read, False)

    def take() -> bytes:
        try:
            return os.read(read, 4096)
        except BlockingIOError:
            return b""

    return take, lambda data: os.write(write, data)


def socket_link(address: tuple[str, int]) -> tuple[Link, socket.socket]:
    port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    port.connect(address)
    port.setblocking(False)

    def take() -> bytes:
        try:
            return port.recv(4096)
        except (BlockingIOError, ConnectionRefusedError):
            return b""

    return (take, port.send), port


def hold(link: Link, fd: bool = False, samples: int = 200) -> HostMachine:
    """Connect, enable and follow the measured angle until so many samples came while RUNNING; then disable."""
    take, give = link
    reader, host = SerialReader(), HostMachine(HostConfig(1, fd, SERIAL))
    running, started = 0, time.monotonic_ns()
    host.connect(started)
    while running < samples:
        now = time.monotonic_ns()
        assert now - started < 20e9, (host.phase, host.counters)
        for frame in reader.feed(take()):
            host.receive(frame, now)
        for sample in host.take_samples():
            running += sample.state == DriveState.OPERATIONAL
            if (setpoint := host.setpoint(sample.theta_m)) is not None:
                give(encode_serial(setpoint))
        if host.phase is HostPhase.READY:
            host.enable()
        for frame in host.poll(now):
            give(encode_serial(frame))
        time.sleep(2e-4)
    assert host.phase is HostPhase.RUNNING
    host.disable()
    for frame in host.poll(time.monotonic_ns()):
        give(encode_serial(frame))
    time.sleep(0.02)
    return host


@pytest.mark.realtime
@pytest.mark.parametrize("fd", [False, True])
def test_pseudo_terminal(tmp_path: Path, fd: bool) -> None:
    link = tmp_path / "drive"
    with drive("--serial-pty", str(link), *PATIENT, *(("--fd",) if fd else ())) as process:
        assert process.ready[1:3] == ["serial", str(link)]
        assert link.readlink() == Path(process.ready[3])
        port = os.open(link, os.O_RDWR | os.O_NOCTTY)
        host = hold(file_link(port, port), fd)
        os.close(port)
    assert process.summary["setpoints_accepted"] > 100
    assert process.summary["bad_crc"] == process.summary["faults"] == 0
    assert process.summary["state"] == DriveState.DISABLED
    assert host.counters["bad_crc"] == 0
    assert not link.exists()


@pytest.mark.realtime
def test_frames_that_nobody_reads_are_thrown_away(tmp_path: Path) -> None:
    """A host that comes late finds a buffer of the kernel at most, and then only what is new."""
    link = tmp_path / "drive"
    with drive("--serial-pty", str(link), "--sample_time_s", "2e-5") as process:
        time.sleep(0.8)
        port = os.open(link, os.O_RDWR | os.O_NOCTTY)
        take, _ = file_link(port, port)
        reader, frames = SerialReader(), 0
        while data := take():
            frames += len(reader.feed(data))
        os.close(port)
    assert frames > 0
    assert process.summary["unsent"] > 0


@pytest.mark.realtime
def test_standard_input_and_output() -> None:
    with drive("--stdio", *PATIENT) as process:
        assert process.child.stdin
        assert process.child.stdout
        hold(file_link(process.child.stdout.fileno(), process.child.stdin.fileno()))
        process.child.stdin.close()  # the drive ends with its host
        process.child.wait(5)
    assert process.summary["setpoints_accepted"] > 100


@pytest.mark.realtime
def test_datagrams() -> None:
    with drive("--udp", "127.0.0.1:0", *PATIENT) as process:
        host, _, port = process.ready[2].partition(":")
        link, ours = socket_link((host, int(port)))
        with ours:
            ours.send(encode_serial(Frame(0x101, bytes(8)))[:-3])  # cut: must not spoil the next
            ours.send(b"")
            ours.send(bytes(1_500))
            hold(link)
    assert process.summary["setpoints_accepted"] > 100
    assert process.summary["bad_crc"] == 0


@pytest.mark.realtime
def test_its_own_protection_by_signal() -> None:
    with drive("--udp", "127.0.0.1:0") as process:
        host, _, port = process.ready[2].partition(":")
        (take, give), ours = socket_link((host, int(port)))
        reader, fault, started = SerialReader(), 0, time.monotonic()
        with ours:
            give(encode_serial(Frame(0x7FF, b"")))  # so that the drive knows where to answer
            process.child.send_signal(signal.SIGUSR1)
            while not fault and time.monotonic() - started < 10.0:
                for message in map(codec.Decoder().decode, reader.feed(take())):
                    if isinstance(message, Timing):
                        fault = message.fault
    assert fault == process.summary["fault"] == FaultReason.OVERCURRENT


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ((), "one of --serial-pty"),
        (("--udp", "127.0.0.1:0", "--stdio"), "one of --serial-pty"),
        (("--udp", "nowhere"), "Invalid argument"),
        (("--udp", "127.0.0.1:70000"), "Invalid argument"),
        (("--serial-pty", "/nowhere/at/all"), "No such file"),
        (("--stdio", "--nonsense"), "--nonsense: no such option"),
        (("--stdio", "--node"), "--node: wants a value"),
        (("--stdio", "--node", "300"), "--node: wants a value"),
        (("--stdio", "--node", "31"), "out of its bounds"),
        (("--stdio", "--kp_A_per_rad", "nan"), "--kp_A_per_rad: wants a value"),
        (("--stdio", "--sample_time_s", "0"), "--sample_time_s"),
        (("--stdio", "--feedback_divider", "0"), "out of its bounds"),
        (("--stdio", "--plant", "127.0.0.1"), "--plant: Invalid argument"),
    ],
)
def test_what_makes_no_sense_is_said_in_one_line(arguments: tuple[str, ...], word: str) -> None:
    command = [str(make("host", "sanitize") / "hfp-drive"), *arguments]
    result = subprocess.run(command, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL, timeout=5)
    assert result.returncode == 2
    assert word in result.stderr.splitlines()[0]
    assert result.stdout == ""


class Lockstep:
    """The plant's end, and a Python drive with the world's loop beside it that must do the same."""

    def __init__(self, process: Process) -> None:
        host, _, port = process.ready[2].partition(":")
        self.link, self.frames = socket_link((host, int(port)))
        self.plant = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.plant.connect((host, int(process.ready[-1])))
        self.plant.settimeout(5.0)
        self.reader = SerialReader()

    def step(self, now_us: int, theta: int, current: int, sample: bool) -> tuple[float, int, int]:
        self.plant.send(struct.pack("<IiiI", now_us & 0xFFFF_FFFF, theta, current, sample))
        current_A, state, fault, _, _ = struct.unpack("<fBBBB", self.plant.recv(64))
        return current_A, state, fault

    def take(self) -> list[Frame]:
        frames: list[Frame] = []
        while data := self.link[0]():
            frames += self.reader.feed(data)
        return frames


def test_a_plant_outside_is_the_clock() -> None:
    """No time but the plant's: the frames and currents are those of the Python drive with the world's loop."""
    options = ("--node", "1", "--serial_number", hex(SERIAL), "--watchdog_timeout_us", "6000")
    with drive("--udp", "127.0.0.1:0", "--plant", "127.0.0.1:0", *options) as process:
        twin = DriveMachine(DriveConfig(1, SERIAL, watchdog_timeout_us=6_000))
        wire = Lockstep(process)
        loop, theta, moved, faults = LoopState(0.0, 0.0, 0.0), 0, 0, 0
        wire.link[1](encode_serial(Frame(0x7FF, b"")))  # so that the drive knows where to answer
        for i in range(400):
            now_us = 1_000 * i
            control = 0 if i < 2 else 1
            frames = [codec.encode(HostHeartbeat(1, control, 1, 0, i & 0xFF))] if i % 5 == 0 else []
            if 10 < i < 300:
                frames.append(codec.encode_setpoint(1, theta + (40 if i > 12 else 0), i & 0xFF, (i - 1) & 0xFF))
            wanted = []
            for frame in frames:
                wire.link[1](encode_serial(frame))
                wanted += twin.receive(frame, now_us, theta)
            theta += 3 * (i > 20)
            wanted += twin.poll(now_us) + twin.sample(now_us, theta, i)
            active = twin.reference_raw is not None
            loop, current = loop_step(loop, GAINS, active, twin.reference_raw or 0, theta)
            current_A, state, fault = wire.step(now_us, theta, i, True)
            assert wire.take() == wanted
            assert (state, fault) == (twin.state, twin.fault)
            assert current_A == pytest.approx(current, rel=1e-5, abs=1e-9)
            moved += current_A > 0.0
            faults += fault == FaultReason.WATCHDOG
        wire.plant.close()
        wire.frames.close()
    assert moved > 200
    assert faults > 50


def test_time_waits_for_the_frames_that_the_plant_names(tmp_path: Path) -> None:
    """A pseudo terminal is slower than datagrams: the answer comes when the last of five frames is there."""
    link = tmp_path / "drive"
    with drive("--serial-pty", str(link), "--plant", "127.0.0.1:0") as process:
        port = os.open(link, os.O_RDWR | os.O_NOCTTY)
        plant = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        plant.connect(("127.0.0.1", int(process.ready[-1])))
        plant.settimeout(5.0)
        sent = 0
        for i in range(20):
            plant.send(struct.pack("<IiiI", 1_000 * i, 0, 0, 1 | 2 | (5 * i + 5) << 8))
            for _ in range(5):
                time.sleep(2e-3 if i == 0 else 0.0)
                os.write(port, encode_serial(Frame(0x7E1, b"")))
            *_, sent = struct.unpack("<fBBBB", plant.recv(64))
        assert sent >= 40  # feedback and timing of each sample, and the first heartbeat
        os.close(port)
        plant.close()
    assert process.summary["not_for_us"] == 100
