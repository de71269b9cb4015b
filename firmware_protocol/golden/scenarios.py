"""Traces of the drive's state machine: what happens, step by step, and what it must then say and be."""

from collections.abc import Callable
from dataclasses import asdict
from typing import Final

from firmware_protocol import codec
from firmware_protocol.drive.discovery import identity_delay_us
from firmware_protocol.drive.machine import DriveConfig, DriveMachine
from firmware_protocol.frames import BROADCAST_NODE, Frame, arbitration_id
from firmware_protocol.golden.vectors import Row, frame_row
from firmware_protocol.messages import (
    PROTOCOL_MAJOR,
    PROTOCOL_MINOR,
    AssignNode,
    Discover,
    Estop,
    FaultReason,
    Function,
    HostHeartbeat,
    ParamOp,
    ParamRequest,
)
from firmware_protocol.parameters import Index
from firmware_protocol.scales import wrap_int32

_SERIAL: Final = 0x0000_1234_5678
_NODE: Final = 3
_START_US: Final = 0xFFFF_FF00  # so that the clock wraps in every scenario
_LOW, _ENABLE, _RESET, _BOTH = 0, 1, 2, 3
_LIMITS: Final[dict[str, int | bool]] = {"theta_min_raw": -1_000, "theta_max_raw": 1_000}


class Script:
    """A drive and the record of what is done to it; time stands still but for `wait`."""

    def __init__(self, name: str, **settings: int | bool) -> None:
        self.name = name
        self.config = DriveConfig(node=_NODE, serial_number=_SERIAL, **settings)  # type: ignore[arg-type]
        self.drive = DriveMachine(self.config)
        self.now_us = _START_US
        self.theta = 0
        self.steps: list[Row] = []
        self._heartbeat = -1
        self._setpoint = -1
        self._samples = -1

    def _note(self, event: Row, frames: list[Frame]) -> None:
        drive = self.drive
        reference = None if drive.reference_raw is None else wrap_int32(drive.reference_raw)
        status = {"state": int(drive.state), "fault": int(drive.fault), "reference": reference}
        clock = {"now_us": self.now_us & 0xFFFF_FFFF, "theta_m": wrap_int32(self.theta)}
        self.steps.append({**event, **clock, "frames": [frame_row(frame) for frame in frames], **status})

    def receive(self, frame: Frame) -> None:
        """Let a frame arrive now."""
        answers = self.drive.receive(frame, self.now_us, self.theta)
        self._note({"event": "receive", **frame_row(frame)}, answers)

    def wait(self, delay_us: int) -> None:
        """Let time pass, then poll."""
        self.now_us += delay_us
        self._note({"event": "poll"}, self.drive.poll(self.now_us))

    def sample(self, current: int = 0) -> None:
        """Measure now."""
        self._samples += 1
        frames = self.drive.sample(self.now_us, self.theta, current)
        self._note({"event": "sample", "current": current}, frames)

    def trip(self, reason: FaultReason) -> None:
        """Let the device's own protection act."""
        self.drive.trip(reason)
        self._note({"event": "trip", "reason": int(reason)}, [])

    def heartbeat(self, control: int, advance: int = 1, major: int = PROTOCOL_MAJOR) -> None:
        """Receive HOST_HEARTBEAT."""
        self._heartbeat += advance
        message = HostHeartbeat(_NODE, control, major, PROTOCOL_MINOR, self._heartbeat & 0xFF)
        self.receive(codec.encode(message))

    def setpoint(self, theta: int, advance: int = 1, age: int = 0) -> None:
        """Receive a reference computed `age` samples ago."""
        self._setpoint += advance
        sequences = (self._setpoint & 0xFF, (self._samples - age) & 0xFF)
        self.receive(codec.encode_setpoint(_NODE, wrap_int32(theta), *sequences, self.config.fd))

    def param(self, op: int, index: int, value: int = 0) -> None:
        """Receive PARAM_REQUEST."""
        self.receive(codec.encode(ParamRequest(_NODE, op, index, value)))

    def arm(self) -> None:
        """Go to ARMED, with one sample taken."""
        self.sample()
        self.heartbeat(_LOW)
        self.heartbeat(_ENABLE)

    def run(self) -> None:
        """Go to OPERATIONAL at the measured angle."""
        self.arm()
        self.setpoint(self.theta)

    def row(self) -> Row:
        """Return the whole trace."""
        config = {key: int(value) for key, value in asdict(self.config).items()}
        counters = dict(self.drive.counters)
        return {"name": self.name, "config": config, "counters": counters, "steps": self.steps}


def _start(s: Script) -> None:
    s.wait(0)
    s.wait(99_999)
    s.wait(1)
    s.run()
    for i in range(3):
        s.wait(1_000)
        s.theta += 10
        s.sample(current=(-40_000, 5, 40_000)[i])
        s.setpoint(s.theta + 100)
    s.heartbeat(_LOW)
    s.wait(0)


def _watchdog(s: Script) -> None:
    s.run()
    s.wait(19_999)
    s.sample()
    s.setpoint(0)
    for _ in range(19):  # neither heartbeats, nor reading, nor repeats, nor a bad CRC feed it
        s.wait(1_000)
        s.sample()
        s.heartbeat(_ENABLE)
        s.param(ParamOp.READ, Index.THETA_MAX)
        s.setpoint(0, advance=0)
    s.receive(Frame(arbitration_id(Function.SETPOINT, _NODE), bytes(8)))
    s.wait(999)
    s.wait(1)


def _late_reference(s: Script) -> None:
    s.run()
    s.now_us += 20_000
    s.setpoint(0)


def _host_lost(s: Script) -> None:
    s.arm()
    s.wait(99_999)
    s.heartbeat(_ENABLE)
    s.wait(99_999)
    s.heartbeat(_ENABLE, advance=0)
    s.wait(1)
    s.heartbeat(_RESET)  # the first after a silence: no edge yet
    s.heartbeat(_LOW)
    s.heartbeat(_RESET)


def _arm_expires(s: Script) -> None:
    s.arm()
    for _ in range(19):
        s.wait(50_000)
        s.heartbeat(_ENABLE)
    s.wait(49_999)
    s.wait(1)


def _arming(s: Script) -> None:
    for offset in (100, 101, -100, -101):
        s.theta = 5_000
        s.sample()
        s.heartbeat(_LOW)
        s.heartbeat(_ENABLE)
        s.setpoint(s.theta + offset)
        s.heartbeat(_LOW)
        s.heartbeat(_RESET)


def _limits(s: Script) -> None:
    for target in (1_000, 1_001, -1_000, -1_001):
        s.theta = target // 2
        s.run()
        s.setpoint(target)
        s.heartbeat(_LOW)
        s.heartbeat(_RESET)


def _steps(s: Script) -> None:
    for step, advance in ((500, 1), (501, 1), (1_000, 2), (1_001, 2), (4_000, 8), (4_001, 8), (4_001, 9)):
        s.run()
        s.setpoint(step, advance)
        s.heartbeat(_LOW)
        s.heartbeat(_RESET)


def _freshness(s: Script) -> None:
    s.setpoint(0)
    s.heartbeat(_LOW)
    s.heartbeat(_ENABLE)
    s.setpoint(0)  # no sample yet: of the future
    for _ in range(30):
        s.sample()
    for age in (21, -1, 20):
        s.setpoint(0, age=age)
    for advance in (0, -1, 128, 1, 127):
        s.setpoint(0, advance)


def _version(s: Script) -> None:
    s.heartbeat(_LOW, major=2)
    s.heartbeat(_ENABLE, major=2)
    s.heartbeat(_LOW)
    s.heartbeat(_RESET)
    s.run()
    s.heartbeat(_ENABLE, major=0)


def _edges(s: Script) -> None:
    s.sample()
    s.heartbeat(_ENABLE)  # high since before the drive listened: no edge
    s.heartbeat(_LOW)
    s.heartbeat(_ENABLE, advance=128)  # older than the last
    s.heartbeat(_ENABLE, advance=-127)
    s.trip(FaultReason.OVERCURRENT)
    s.trip(FaultReason.ENCODER)
    s.heartbeat(_BOTH)  # resets, does not enable
    s.heartbeat(_ENABLE)
    s.heartbeat(_LOW)
    s.heartbeat(_ENABLE)
    s.heartbeat(_BOTH)


def _estop(s: Script) -> None:
    for node, payload in ((_NODE, b""), (BROADCAST_NODE, b"\x01\x02"), (_NODE + 1, b"")):
        for prepare in (Script.sample, Script.arm, Script.run):
            prepare(s)
            s.receive(Frame(arbitration_id(Function.ESTOP, node), payload))
            s.receive(codec.encode(Estop(_NODE)))
            s.heartbeat(_LOW)
            s.heartbeat(_RESET)
    s.receive(Frame(arbitration_id(Function.ESTOP, _NODE), bytes(64), True))


def _parameters(s: Script) -> None:
    for index in (*Index, 0, 0xFFFF):
        s.param(ParamOp.READ, index)
    for value in (999, 1_000, 500_000, 500_001):
        s.param(ParamOp.WRITE, Index.WATCHDOG_TIMEOUT, value)
    s.param(ParamOp.WRITE, Index.THETA_MAX, -5)
    s.param(ParamOp.WRITE, Index.THETA_MIN, -4)
    s.param(ParamOp.WRITE, Index.THETA_MIN, -5)
    s.param(ParamOp.WRITE, Index.NODE, 4)
    s.param(ParamOp.WRITE, 0xFFFF, 4)
    s.param(7, Index.NODE)
    s.arm()
    s.param(ParamOp.WRITE, Index.THETA_MIN, -6)
    s.setpoint(0)


def _discovery(s: Script) -> None:
    s.wait(0)
    for count, node in enumerate((BROADCAST_NODE, _NODE, BROADCAST_NODE)):
        s.receive(codec.encode(Discover(node)))
        s.receive(codec.encode(Discover(_NODE + 1)))
        s.receive(codec.encode(Discover(node)))  # while the answer waits
        s.wait(identity_delay_us(_SERIAL, count) - 1)
        s.wait(1)
    s.receive(codec.encode(AssignNode(BROADCAST_NODE, _SERIAL + 1, 9)))
    s.receive(codec.encode(AssignNode(BROADCAST_NODE, _SERIAL, 0)))
    s.receive(codec.encode(AssignNode(BROADCAST_NODE, _SERIAL, 31)))
    s.arm()
    s.receive(codec.encode(AssignNode(BROADCAST_NODE, _SERIAL, 9)))
    s.heartbeat(_LOW)
    s.receive(codec.encode(AssignNode(BROADCAST_NODE, _SERIAL, 9)))
    s.param(ParamOp.READ, Index.NODE)
    s.wait(100_000)


def _wrap(s: Script) -> None:
    s.theta = (1 << 31) - 50
    s.run()
    for _ in range(4):
        s.wait(1_000)
        s.theta += 40
        s.sample()
        s.setpoint(s.theta + 30)


def _rubbish(s: Script) -> None:
    s.run()
    setpoint = arbitration_id(Function.SETPOINT, _NODE)
    for length in (0, 7, 8):
        s.receive(Frame(setpoint, bytes(length)))
    s.receive(Frame(setpoint, bytes(8), True))
    s.receive(Frame(arbitration_id(Function.FD_SETPOINT, _NODE), bytes(8), True))
    s.receive(Frame(0x7FF, bytes(8)))
    s.receive(codec.encode_feedback(_NODE, 0, 0, 0))
    s.wait(0)


def _precedence(s: Script) -> None:
    """Beyond a limit and beyond the tolerance; then beyond a limit and beyond the step."""
    s.arm()
    s.setpoint(5_000)
    s.heartbeat(_LOW)
    s.heartbeat(_RESET)
    s.heartbeat(_LOW)
    s.run()
    s.setpoint(-5_000)
    s.wait(0)


def _same_node(s: Script) -> None:
    """ASSIGN_NODE to the present id: answered, no answer to DISCOVER, and the host starts over."""
    s.heartbeat(_LOW)
    for _ in range(3):
        s.receive(codec.encode(AssignNode(BROADCAST_NODE, _SERIAL, _NODE)))
        s.heartbeat(_ENABLE, -5)
    s.heartbeat(_LOW)
    s.heartbeat(_ENABLE)
    s.heartbeat(_LOW)
    for answers in range(2):
        s.receive(codec.encode(Discover(BROADCAST_NODE)))
        s.wait(identity_delay_us(_SERIAL, answers) - 1)
        s.wait(1)


_SCENARIOS: Final[dict[str, tuple[Callable[[Script], None], dict[str, int | bool]]]] = {
    "start, run, stop": (_start, {}),
    "start, run, stop over FD": (_start, {"fd": True}),
    "watchdog": (_watchdog, {}),
    "reference too late": (_late_reference, {}),
    "host lost": (_host_lost, {}),
    "armed too long": (_arm_expires, {}),
    "first reference": (_arming, {"reference_tolerance_raw": 100}),
    "position limits": (_limits, _LIMITS),
    "step limit": (_steps, {"max_step_raw": 500}),
    "freshness": (_freshness, {}),
    "version": (_version, {}),
    "edges": (_edges, {}),
    "emergency stop": (_estop, {}),
    "parameters": (_parameters, {}),
    "discovery": (_discovery, {}),
    "angle wraps": (_wrap, {}),
    "rubbish": (_rubbish, {}),
    "limits before all else": (_precedence, {**_LIMITS, "reference_tolerance_raw": 100, "max_step_raw": 500}),
    "same node again": (_same_node, {}),
}


def scenarios() -> list[Row]:
    """Return every trace."""
    rows = []
    for name, (play, settings) in _SCENARIOS.items():
        script = Script(name, **settings)
        play(script)
        rows.append(script.row())
    return rows
