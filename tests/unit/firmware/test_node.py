"""The node of the reference firmware: the drive with its loop behind the port, here one of Python functions."""

import ctypes
import random
from collections import deque
from collections.abc import Sequence
from typing import Any

import pytest

from firmware_protocol import codec
from firmware_protocol.drive.config import DriveConfig
from firmware_protocol.drive.machine import DriveMachine
from firmware_protocol.frames import Frame
from firmware_protocol.messages import AssignNode, DriveState, Estop, FaultReason, Feedback, HostHeartbeat, Timing
from tests.firmware_library import (
    PORT_TYPES,
    CDriveHead,
    CFrame,
    CLoopConfig,
    CPort,
    CReading,
    c_config,
    dirty_memory,
    library,
)
from virtual_bus.plant.position_loop import LoopParameters, LoopState, loop_step

NODE, SERIAL = 3, 0x1234
CONFIG = DriveConfig(NODE, SERIAL, heartbeat_period_us=1_000_000)
GAINS = LoopParameters(1.0e-3, 1.2, 15.0, 6.0e-3, 150.0, 1.0)
BURST = 32


class Device:
    """A node with everything about it: what it was given, what it did, in order."""

    def __init__(
        self,
        config: DriveConfig = CONFIG,
        gains: LoopParameters = GAINS,
        divider: int = 1,
        theta: int = 0,
    ) -> None:
        self.inbox: deque[Frame] = deque()
        self.sent: list[Frame] = []
        self.room = True
        self.clock_us, self.theta, self.current = 0, theta, 0
        self.fault = FaultReason.NONE
        self.done: list[str] = []
        self.current_A = float("nan")
        self.kept: list[int] = []
        self._lib = library()
        self._node = dirty_memory("node")
        self.head = CDriveHead.from_buffer(self._node)  # the drive comes first
        calls: tuple[Any, ...]
        calls = (self._receive, self._send, self._now, self._measure, self._protect, self._drive, self._keep)
        self._port = CPort(*(kind(call) for kind, call in zip(PORT_TYPES, calls, strict=True)))
        self.valid = bool(
            self._lib.hfp_node_init(
                self._node,
                ctypes.byref(c_config(config)),
                ctypes.byref(CLoopConfig(*gains)),
                ctypes.c_uint16(divider),
                ctypes.byref(self._port),
                ctypes.c_void_p(0x5A),
            )
        )

    def _receive(self, context: int, frame: Any) -> bool:
        assert context == 0x5A
        if not self.inbox:
            return False
        frame[0].fill(self.inbox.popleft())
        return True

    def _send(self, _: int, frame: Any) -> bool:
        self.sent.append(ctypes.cast(frame, ctypes.POINTER(CFrame))[0].frame())
        return self.room

    def _now(self, _: int) -> int:
        return self.clock_us & 0xFFFF_FFFF

    def _measure(self, _: int, reading: Any) -> None:
        self.done.append("measure")
        reading[0] = CReading(self.clock_us, self.theta, self.current)

    def _protect(self, _: int) -> int:
        return self.fault

    def _drive(self, _: int, current_A: float) -> None:
        self.done.append("current")
        self.current_A = current_A

    def _keep(self, _: int, node: int) -> None:
        self.kept.append(node)

    def service(self, *frames: Frame) -> list[Frame]:
        self.inbox.extend(frames)
        self._lib.hfp_node_service(self._node)
        return self.take()

    def sample(self) -> list[Frame]:
        self._lib.hfp_node_sample(self._node)
        return self.take()

    def take(self) -> list[Frame]:
        sent, self.sent = self.sent, []
        return sent

    def unsent(self) -> int:
        offset = ctypes.c_size_t.in_dll(self._lib, "hfp_offset_of_unsent").value
        return ctypes.c_uint64.from_buffer(self._node, offset).value

    def run(self) -> None:
        self.sample()
        for control in (0, 1):
            self.service(codec.encode(HostHeartbeat(NODE, control, 1, 0, control)))
        self.service(codec.encode_setpoint(NODE, self.theta, 0, 0))
        assert self.head.state == DriveState.OPERATIONAL


def kinds(frames: Sequence[Frame]) -> list[str]:
    return [type(codec.Decoder().decode(frame)).__name__ for frame in frames]


def test_power_up_takes_the_current_away_before_all_else() -> None:
    device = Device(theta=77)
    assert device.valid
    assert device.done == ["current", "measure"]
    assert device.current_A == 0.0
    assert device.sent == []


def test_settings_that_make_no_sense_are_refused() -> None:
    assert not Device(divider=0).valid
    assert not Device(gains=GAINS._replace(sample_time_s=0.0)).valid
    device = Device()
    bad = c_config(CONFIG)
    bad.node = 31
    arguments = ctypes.byref(bad), ctypes.byref(CLoopConfig(*GAINS)), ctypes.c_uint16(1), ctypes.byref(device._port)
    assert not library().hfp_node_init(device._node, *arguments, ctypes.c_void_p(0x5A))


def test_a_sample_is_what_was_measured_at_its_instant() -> None:
    device = Device()
    device.clock_us, device.theta, device.current = 123_456, -99, 40_000
    assert kinds(device.sample()) == ["DriveHeartbeat", "Feedback", "Timing"]
    device.clock_us += 1_000
    feedback, timing = (codec.Decoder().decode(frame) for frame in device.sample())
    assert feedback == Feedback(NODE, -99, 32_767, 1)
    assert timing == Timing(NODE, 124_456, 1, 0, 0, 0)


def test_the_loop_runs_on_the_newest_reference_and_its_current_is_held() -> None:
    """Sample by sample the currents of the world's loop, and the frames of the Python drive."""
    rng = random.Random(2)
    device, drive = Device(theta=1_000), DriveMachine(CONFIG)
    state, sequence = LoopState(0.0, 0.0, 1_000.0), 0
    for control in (0, 1):
        heartbeat = codec.encode(HostHeartbeat(NODE, control, 1, 0, control))
        device.service(heartbeat)
        drive.receive(heartbeat, 0, 1_000)
    for i in range(300):
        device.clock_us = 1_000 * i
        wanted = drive.poll(device.clock_us) + drive.sample(device.clock_us, device.theta, i)
        device.current = i
        reference = drive.reference_raw
        state, current = loop_step(state, GAINS, reference is not None, reference or 0, device.theta)
        sent = device.sample()
        assert [f for f in sent if f.arbitration_id != 0x123] == [f for f in wanted if f.arbitration_id != 0x123]
        assert device.current_A == pytest.approx(current, rel=1e-5, abs=1e-9)
        setpoint = codec.encode_setpoint(NODE, device.theta + 100 * (i > 0), sequence, i & 0xFF)
        heartbeat = codec.encode(HostHeartbeat(NODE, 1, 1, 0, (2 + i) & 0xFF))
        sequence = (sequence + 1) & 0xFF
        for frame in (setpoint, heartbeat):
            device.service(frame)
            drive.receive(frame, device.clock_us, device.theta)
        device.theta += rng.randrange(-50, 60)
    assert drive.state == device.head.state == DriveState.OPERATIONAL
    assert current != 0.0


def test_a_reference_is_judged_by_the_angle_measured_last() -> None:
    """HFP-096, HFP-097: far from where the motor was at power-up."""
    for distance, fault in ((16_384, FaultReason.NONE), (16_385, FaultReason.REFERENCE_MISMATCH)):
        device = Device()
        device.theta = 1 << 22
        device.sample()
        device.service(*(codec.encode(HostHeartbeat(NODE, control, 1, 0, control)) for control in (0, 1)))
        device.service(codec.encode_setpoint(NODE, device.theta + distance, 0, 0))
        assert device.head.fault == fault


def test_the_current_goes_at_once_when_the_reference_does() -> None:
    device = Device()
    device.run()
    device.theta = -10_000
    device.sample()
    assert device.current_A > 0.0
    device.service(codec.encode(Estop(0)))
    assert (device.head.fault, device.current_A) == (FaultReason.ESTOP, 0.0)
    device.sample()
    assert device.current_A == 0.0


def test_the_watchdog_takes_the_current_in_service_and_in_sample() -> None:
    for call in (Device.service, Device.sample):
        device = Device()
        device.run()
        device.theta = -10_000
        device.sample()
        device.clock_us = 19_999
        call(device)
        assert device.current_A > 0.0
        device.clock_us = 20_000
        call(device)
        assert (device.head.fault, device.current_A) == (FaultReason.WATCHDOG, 0.0)


def test_the_devices_own_protection_faults_it() -> None:
    device = Device()
    device.run()
    device.fault = FaultReason.OVERTEMPERATURE
    assert kinds(device.service()) == ["DriveHeartbeat"]
    assert (device.head.state, device.head.fault) == (DriveState.FAULT, FaultReason.OVERTEMPERATURE)


def test_a_node_that_was_assigned_is_kept_once() -> None:
    device = Device()
    device.service(codec.encode(AssignNode(0, SERIAL + 1, 9)), codec.encode(AssignNode(0, SERIAL, 31)))
    assert device.kept == []
    assert "Identity" in kinds(device.service(codec.encode(AssignNode(0, SERIAL, 9))))
    device.service(codec.encode(AssignNode(0, SERIAL, 9)))
    assert device.kept == [9]
    assert device.head.node == 9


def test_a_flood_is_taken_in_bursts() -> None:
    device = Device()
    device.service(*[Frame(0x7FF, b"")] * (2 * BURST + 1))
    assert len(device.inbox) == BURST + 1
    device.service()
    device.service()
    assert not device.inbox
    assert device.head.counters[11] == 2 * BURST + 1


def test_feedback_every_nth_sample() -> None:
    device = Device(divider=3)
    device.service()
    sent = [len(device.sample()) for _ in range(9)]
    assert sent == [2, 0, 0] * 3
    assert device.done.count("measure") == 1 + 9


def test_frames_without_room_are_gone_and_counted() -> None:
    device = Device()
    device.room = False
    assert len(device.sample()) == device.unsent() == 3
    device.room = True
    assert len(device.sample()) == 2
    assert device.unsent() == 3


def test_an_fd_node_sends_one_frame_a_sample() -> None:
    device = Device(DriveConfig(NODE, SERIAL, fd=True))
    device.service()
    (frame,) = device.sample()
    assert frame.is_fd
    assert kinds([frame]) == ["FdFeedback"]
