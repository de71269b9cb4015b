"""ODrive's CANSimple in the house: from the rig to the machine, what doesn't go together, who is there, and words."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final, NamedTuple

from firmware_protocol.frames import Frame
from hil_forceps.drives.odrive import messages as wire
from hil_forceps.drives.odrive.inquiry import ODriveInquiry
from hil_forceps.drives.odrive.machine import ODrive, ODriveConfig
from hil_forceps.drives.port import DriveMachine
from hil_forceps.drives.profile import (
    Decoded,
    Finding,
    Found,
    Profile,
    check_node,
    classic_load,
    float_quantum,
    member_name,
)
from hil_forceps.rig import Rig
from hil_forceps.rig.sections import MotorDriver

MAX_ROUNDING_ERROR_MS: Final = 1e-6  # what rounding leaves
MIN_HEARTBEATS: Final = 2  # one frame of eight bytes may be anybody's
_LAST_AXIS_STATE: Final = 14
_AXIS_WORDS: Final[dict[int, str]] = {
    wire.AxisState.IDLE: "idle",
    wire.AxisState.CLOSED_LOOP_CONTROL: "closed loop control",
}


def _machine(rig: Rig, settings: MotorDriver) -> DriveMachine:
    check_node(settings, 0, wire.MAX_NODE)
    return ODrive(
        ODriveConfig(
            node=settings.node_id,
            firmware=settings.firmware,
            rev_per_pulley_rev=settings.encoder_rev_per_pulley_rev,
            zero_rev=settings.encoder_zero_rev,
            velocity_limit_rad_per_s=rig.limits.speed_max_rad_per_s,
            current_limit_A=settings.current_limit_A,
            feedback_period_ns=round(settings.feedback_period_s * 1e9),
            iq_period_ns=round(settings.current_period_s * 1e9),
        )
    )


def _findings(rig: Rig, settings: MotorDriver) -> Iterator[Finding]:
    feedback_s, period_s, age_s = settings.feedback_period_s, rig.bench.host_period_s, rig.limits.max_sample_age_s
    key = "motor_driver.feedback_period_s"
    if feedback_s > age_s:
        text = "most samples are too old for a reference; shorten it"
        yield Finding("problem", key, f"is {feedback_s:g} s, longer than limits.max_sample_age_s ({age_s:g} s): {text}")
    elif feedback_s > period_s:
        yield Finding(
            "note", key, f"is {feedback_s:g} s: references are sent with this period, not with {period_s:g} s"
        )
    for name, value_s in (("feedback_period_s", feedback_s), ("current_period_s", settings.current_period_s)):
        if abs(value_s * 1e3 - round(value_s * 1e3)) > MAX_ROUNDING_ERROR_MS:
            text = f"is {value_s:g} s, but the periods of an ODrive's cyclic messages are whole milliseconds; change it"
            yield Finding("problem", f"motor_driver.{name}", text)
    if settings.current_period_s > feedback_s:
        yield Finding(
            "note",
            "motor_driver.current_period_s",
            f"is {settings.current_period_s:g} s, longer than that of the angle, {feedback_s:g} s: some samples get an "
            "old current, and samples without a current are dropped",
        )


def _bus_load(rig: Rig, settings: MotorDriver) -> float:
    heartbeats_per_s = 10.0
    sends_per_s = 1.0 / settings.feedback_period_s + 1.0 / settings.current_period_s + heartbeats_per_s
    return classic_load(rig, sends_per_s + 1.0 / rig.bench.host_period_s)


class _Heard(NamedTuple):
    beats: int
    heartbeat: wire.Heartbeat
    estimates: int
    currents: int


class _Listener:
    """Tells an ODrive by its heartbeats."""

    def __init__(self) -> None:
        self._heard: dict[int, _Heard] = {}

    def receive(self, frame: Frame) -> bool:
        """Take one frame; its ids may be others' too."""
        if frame.is_extended:
            return False
        node, command = wire.node_and_command(frame.arbitration_id)
        known = self._heard.get(node)
        if command == wire.Command.HEARTBEAT:
            heartbeat = wire.parse_heartbeat(frame.data)
            if heartbeat is not None and heartbeat.axis_state <= _LAST_AXIS_STATE:
                first = _Heard(1, heartbeat, 0, 0)
                again = None if known is None else known._replace(beats=known.beats + 1, heartbeat=heartbeat)
                self._heard[node] = again or first
        elif known is not None and len(frame.data) == 8 and command == wire.Command.ENCODER_ESTIMATES:
            self._heard[node] = known._replace(estimates=known.estimates + 1)
        elif known is not None and len(frame.data) == 8 and command == wire.Command.GET_IQ:
            self._heard[node] = known._replace(currents=known.currents + 1)
        return False

    def found(self) -> list[Found]:
        """Return the drives heard so far, by node."""
        heard = sorted(self._heard.items())
        return [Found("odrive", node, _words(said)) for node, said in heard if said.beats >= MIN_HEARTBEATS]


def _words(said: _Heard) -> str:
    state = _AXIS_WORDS.get(said.heartbeat.axis_state, f"axis state {said.heartbeat.axis_state}")
    error = f"; axis error 0x{said.heartbeat.axis_error:x}" if said.heartbeat.axis_error else ""
    counts = (("encoder estimates", said.estimates), ("Iq", said.currents))
    sends = [name for name, count in counts if count]
    lacks = [name for name, count in counts if not count]
    has = f"; sends {' and '.join(sends)}" if sends else ""
    return state + error + has + (f"; sends no {' and no '.join(lacks)}: set its cyclic messages" if lacks else "")


def decode(frame: Frame) -> Decoded | None:
    """Return a frame of CANSimple; None for a command that isn't known here or has another length."""
    if frame.is_extended:
        return None
    (node, number), data = wire.node_and_command(frame.arbitration_id), frame.data
    try:
        command = wire.Command(number)
    except ValueError:
        return None
    values = _values(command, data)
    return None if values is None else Decoded(command.name, {"node": node, **values})


def _values(command: wire.Command, data: bytes) -> Mapping[str, Any] | None:
    if command in {wire.Command.ESTOP, wire.Command.CLEAR_ERRORS}:
        return {}
    return _VALUES[command](data) if len(data) == 8 else None


def _integers(data: bytes) -> tuple[int, int]:
    return int.from_bytes(data[:4], "little"), int.from_bytes(data[4:], "little")


def _pair(data: bytes, *names: str) -> dict[str, Any] | None:
    pair = wire.parse_pair(data)
    return None if pair is None else dict(zip(names, pair, strict=True))


_VALUES: Mapping[wire.Command, Callable[[bytes], Mapping[str, Any] | None]] = {
    wire.Command.HEARTBEAT: lambda data: {
        "axis_error": f"0x{_integers(data)[0]:x}",
        "axis_state": member_name(wire.AxisState, data[4]),
    },
    wire.Command.SET_AXIS_STATE: lambda data: {"axis_state": member_name(wire.AxisState, _integers(data)[0])},
    wire.Command.SET_CONTROLLER_MODE: lambda data: dict(
        zip(("control_mode", "input_mode"), _integers(data), strict=True)
    ),
    wire.Command.SET_INPUT_POS: wire.parse_input_pos,
    wire.Command.ENCODER_ESTIMATES: lambda data: _pair(data, "position_rev", "velocity_rev_per_s"),
    wire.Command.GET_IQ: lambda data: _pair(data, "setpoint_A", "measured_A"),
    wire.Command.SET_LIMITS: lambda data: _pair(data, "velocity_rev_per_s", "current_A"),
}

PROFILE: Final = Profile(
    name="odrive",
    link="can",
    machine=_machine,
    sample_period_s=lambda _, settings: settings.feedback_period_s,
    findings=_findings,
    bus_load=_bus_load,
    quantum=float_quantum,
    listener=_Listener,
    decode=decode,
    ids=lambda settings: frozenset((settings.node_id << 5 | command, False) for command in range(32)),
    tells_current_limit=True,
    inquiry=lambda settings: ODriveInquiry(settings.node_id, settings.firmware),
)
