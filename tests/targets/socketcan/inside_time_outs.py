"""Time-outs of drive and service over the kernel's CAN in virtual time: exact, since nothing there takes time.

What a program computes takes no time; only a system call that asks for the clock costs 256 ns. So a time-out is due at
its instant, and what is allowed on top is a sample period of the drive (it looks at its clocks once a sample) and the
period in which a sleep may be late (TICK_S).
"""

import json
import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import pytest

from firmware_protocol.codec import Decoder
from firmware_protocol.frames import Frame
from firmware_protocol.host.machine import HostConfig, HostMachine, HostPhase
from firmware_protocol.messages import DriveHeartbeat, DriveState, FaultReason, Function, ParamOp
from firmware_protocol.parameters import Index
from hil_forceps.bridge.links.adapters import LinkSpec, open_link
from hil_forceps.cli.kernels import ready_kernels
from hil_forceps.rig import load_rig
from tests.targets.socketcan.guest import IS_VIRTUAL, ROOT, Drive, c_drive, python_drive, running, service

DEVICE: Final = "vcan0"
SAMPLE_S: Final = 1.0e-3
TICK_S: Final = 0.3e-3  # timer slack of 50 us in each of a few sleeps, and the clock's own price
PATIENCE_S: Final = 5.0
START_S: Final = 0.02  # of clocks read while a process starts and ends
SERVICE_RIG: Final = ROOT / "configs" / "paper.yaml"

DRIVES: Final = pytest.mark.parametrize("command", [c_drive, python_drive], ids=["c", "python"])
Command = Callable[..., list[str]]


@pytest.fixture(scope="module", autouse=True)
def compiled() -> None:
    """Compile what the service needs before anything is timed: a compiler waits for its files, and that takes time."""
    rig = load_rig(SERVICE_RIG)
    ready_kernels(rig, rig.bench.host_period_s)


@pytest.mark.timeout(0)  # which would count the hour
def test_time_is_virtual() -> None:
    assert IS_VIRTUAL
    began_s = time.monotonic()
    time.sleep(3600.0)
    assert 3600.0 <= time.monotonic() - began_s < 3600.0 + TICK_S


class Host:
    """A host that does what it is told to: beats and sends the newest angle as reference, or does not."""

    def __init__(self) -> None:
        self.link = open_link(LinkSpec(interface="socketcan", channel=DEVICE, spin_ns=0)).link
        self.machine = HostMachine(HostConfig(node=1))
        self.beating = self.referring = True
        self.last_beat_s = self.last_reference_s = 0.0
        self.machine.connect(time.monotonic_ns())

    def until(self, what: Callable[[], bool]) -> float:
        """Go on until something holds, looking ten times a millisecond; return when it did."""
        end_s = time.monotonic() + PATIENCE_S
        while not what():
            assert time.monotonic() < end_s, f"{self.machine.phase} {self.machine.drive_state} {self.machine.fault}"
            time.sleep(1.0e-4)
            self._turn()
        return time.monotonic()

    def wait(self, phase: HostPhase) -> float:
        return self.until(lambda: self.machine.phase is phase)

    def enable(self) -> None:
        self.wait(HostPhase.READY)
        self.machine.enable()
        self.wait(HostPhase.RUNNING)
        end_s = time.monotonic() + 0.1  # of ordinary operation
        self.until(lambda: time.monotonic() > end_s)
        assert self.machine.drive_state is DriveState.OPERATIONAL

    def _turn(self) -> None:
        for time_ns, frame in self.link.receive():
            self.machine.receive(frame, time_ns)
        samples = self.machine.take_samples()
        self.machine.take_bench()
        now_s = time.monotonic()
        for frame in self.machine.poll(time.monotonic_ns()):
            if self.beating or frame.arbitration_id >> 5 != Function.HOST_HEARTBEAT:
                self.link.send(frame)
                self.last_beat_s = now_s
        reference = self.machine.setpoint(samples[-1].theta_m) if samples else None
        if reference is not None and self.referring:
            self.link.send(reference)
            self.last_reference_s = now_s


@pytest.fixture
def host() -> Any:
    one = Host()
    yield one
    one.link.close()


def within(duration_s: float, least_s: float, more_s: float = SAMPLE_S) -> None:
    """The time-out took what it should: never less, and no more than a drive's sample and a tick."""
    assert least_s - TICK_S <= duration_s <= least_s + more_s + TICK_S, f"{duration_s:.6f} s instead of {least_s} s"


def set_timeout(host: Host, number: Index, timeout_s: float) -> None:
    """Write a time-out of the drive and see it taken."""
    host.wait(HostPhase.READY)
    host.link.send(host.machine.write_parameter(number, round(timeout_s * 1e6)))
    answers: list[Any] = []

    def is_answered() -> bool:
        answers.extend(host.machine.take_responses())
        return bool(answers)

    host.until(is_answered)
    assert answers[0].op == ParamOp.OK


@pytest.mark.parametrize(("command", "timeout_s"), [(c_drive, 0.005), (c_drive, 0.137), (python_drive, 0.020)])
def test_watchdog(command: Command, timeout_s: float, host: Host) -> None:
    with running(command(DEVICE)):
        set_timeout(host, Index.WATCHDOG_TIMEOUT, timeout_s)
        host.enable()
        host.referring = False
        faulted_s = host.wait(HostPhase.FAULT)
    assert host.machine.fault is FaultReason.WATCHDOG
    within(faulted_s - host.last_reference_s, timeout_s)


@pytest.mark.parametrize(("command", "timeout_s"), [(c_drive, 0.050), (c_drive, 1.0), (python_drive, 0.100)])
def test_host_heartbeat(command: Command, timeout_s: float, host: Host) -> None:
    with running(command(DEVICE)):
        set_timeout(host, Index.HOST_HEARTBEAT_TIMEOUT, timeout_s)
        host.enable()
        host.beating = False
        faulted_s = host.wait(HostPhase.FAULT)
    assert host.machine.fault is FaultReason.HOST_HEARTBEAT_LOST
    within(faulted_s - host.last_beat_s, timeout_s)


@DRIVES
def test_arm_timeout(command: Command, host: Host) -> None:
    with running(command(DEVICE)):
        set_timeout(host, Index.ARM_TIMEOUT, 0.4)
        host.referring = False
        host.machine.enable()
        armed_s = host.until(lambda: host.machine.drive_state is DriveState.ARMED)
        faulted_s = host.wait(HostPhase.FAULT)
    assert host.machine.fault is FaultReason.ENABLE_TIMEOUT
    assert abs(faulted_s - armed_s - 0.4) <= SAMPLE_S + TICK_S  # both seen through samples


@DRIVES
def test_a_drive_that_stands_still_is_gone_and_known_again(command: Command, host: Host) -> None:
    with running(command(DEVICE)) as drive:
        host.wait(HostPhase.READY)
        stop(drive)
        stopped_s = time.monotonic()
        gone_s = host.wait(HostPhase.DISCONNECTED)
        within(gone_s - stopped_s, host.machine.config.drive_timeout_ns * 1e-9 - SAMPLE_S, 2.0 * SAMPLE_S)
        drive.process.send_signal(signal.SIGCONT)
        host.machine.connect(time.monotonic_ns())
        again_s = host.wait(HostPhase.READY)
    assert host.machine.counters["drive_gone"] == 1
    assert again_s - gone_s <= 0.035 + 2 * SAMPLE_S  # the answer to DISCOVER takes up to 35 ms (HFP-060)


@DRIVES
def test_a_drive_that_was_restarted_is_known_again(command: Command, host: Host) -> None:
    for _ in range(2):
        with running(command(DEVICE)):
            host.enable()
            assert host.machine.identity is not None
        host.wait(HostPhase.DISCONNECTED)
        host.machine.connect(time.monotonic_ns())
    assert host.machine.counters["drive_gone"] == 2


class Run:
    """`hil-forceps run` as a process."""

    def __init__(self, out: Path, *more: str) -> None:
        self.out = out
        self.began_s = time.monotonic()
        line = ["--interface", "socketcan", "--channel", DEVICE]
        command = service("run", "--rig", str(SERVICE_RIG), "--out", str(out), *line, *more)
        self.process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)

    def operational(self, host: Host) -> None:
        """Wait until references flow, as another ear on the bus hears them."""
        heard: list[int] = []

        def is_flowing() -> bool:
            ids = [frame.arbitration_id >> 5 for _, frame in host.link.receive()]
            heard.extend(number for number in ids if number == Function.SETPOINT)
            return len(heard) >= 200

        end_s = time.monotonic() + PATIENCE_S
        while not is_flowing():
            assert self.process.poll() is None, self.process.communicate()
            assert time.monotonic() < end_s, "no references"
            time.sleep(0.005)

    def end(self) -> tuple[float, dict[str, Any]]:
        """Wait for its end; return when that was, and run.json."""
        while self.process.poll() is None:
            time.sleep(1.0e-4)
        ended_s = time.monotonic()
        self.process.communicate()
        content: dict[str, Any] = json.loads((self.out / "run.json").read_text())
        return ended_s, content


def test_service_without_a_drive(tmp_path: Path) -> None:
    run = Run(tmp_path)
    ended_s, content = run.end()
    assert content["reason"] == "no_drive"
    within(ended_s - run.began_s, 2.0, more_s=START_S)


def test_service_whose_drive_falls_silent(tmp_path: Path, host: Host) -> None:
    with running(python_drive(DEVICE, "--simulation", "0")) as drive:
        run = Run(tmp_path)
        run.operational(host)
        stop(drive)
        stopped_s = time.monotonic()
        ended_s, content = run.end()
        host.link.receive()
        drive.process.send_signal(signal.SIGCONT)
        end_s = time.monotonic() + PATIENCE_S
        while not any(is_without_torque(frame) for _, frame in host.link.receive()):
            time.sleep(1.0e-4)
            assert time.monotonic() < end_s
    assert content["reason"] == "drive_lost"
    assert "did not confirm that it is disabled within 500 ms" in content["message"]
    # 100 ms of silence, seen at a tick, then half a second for the drive's word
    within(ended_s - stopped_s, 0.1 - SAMPLE_S + 0.5, more_s=3.0 * SAMPLE_S + START_S)


def test_sample_that_is_too_old_moves_nothing(tmp_path: Path, host: Host) -> None:
    with running(python_drive(DEVICE, "--simulation", "0")) as drive:
        run = Run(tmp_path, "--duration", "0.5")
        run.operational(host)
        # Both stand still for 8 ms. What the service finds then is 8 ms old by the kernel's stamp; 3 ms are allowed.
        os.kill(run.process.pid, signal.SIGSTOP)
        time.sleep(0.0011)
        stop(drive)
        time.sleep(0.008)
        os.kill(run.process.pid, signal.SIGCONT)
        time.sleep(0.002)
        drive.process.send_signal(signal.SIGCONT)
        _, content = run.end()
    assert content["reason"] == "completed"
    assert 2 <= content["counters"]["pipeline"]["stale"] <= 4  # a tick each ms until the drive goes on


def stop(drive: Drive) -> None:
    os.kill(drive.process.pid, signal.SIGSTOP)


def is_without_torque(frame: Frame) -> bool:
    message = Decoder().decode(frame)
    return isinstance(message, DriveHeartbeat) and message.state in (DriveState.DISABLED, DriveState.FAULT)
