"""A simulated mini cheetah drive on a simulated forceps, as a node of the virtual bus.

It speaks only when spoken to, and has the states, defaults and traps of three firmwares:

bgkatz    its filter looks at the lower seven bits of an id alone; a command is kept outside of motor mode too; an
          answer is made before the command is taken in, and tells the largest current since the last command; the angle
          wraps; behind the time-out it has no gains, but stays in motor mode; "set zero" works outside of motor mode
cubemars  outside of motor mode a command is neither kept nor answered; the angle saturates; no time-out is documented,
          so none ends a command
damiao    the answer tells disabled, enabled or the fault; the angle saturates; the time-out is a fault, which stays
          until it is cleared

Its law is kp (p - angle) + kd (v - speed) + t, as torque of its own shaft, with the gains of the last command.
"""

import math
from typing import Final, NamedTuple

from firmware_protocol.frames import Frame
from firmware_protocol.scales import ANGLE_LSB_RAD, CURRENT_LSB_A
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.sections import MotorDriver
from virtual_bus.drive import PAPER_JAW_START_RAD, forceps_of
from virtual_bus.plant.load import LoadProfile
from virtual_bus.truth_log import TruthLog

CLEAR, ENTER, EXIT, SET_ZERO = 0xFB, 0xFC, 0xFD, 0xFE
DISABLED, ENABLED, COMMUNICATION_LOST = 0x0, 0x1, 0xD
STIFF_COMMANDS: Final = 3  # the load begins with the answer to this one: what a host can see
_ROOM_DEGC: Final = 25


class Command(NamedTuple):
    """What a command frame says, of the drive's own shaft."""

    position_rad: float
    speed_rad_per_s: float
    kp: float
    kd: float
    torque_N_m: float


NOTHING: Final = Command(0.0, 0.0, 0.0, 0.0, 0.0)


class Spans(NamedTuple):
    """Ranges of the fields."""

    position_rad: float
    speed_rad_per_s: float
    kp: float
    kd: float
    torque_N_m: float


def _spans_of(settings: MotorDriver) -> Spans:
    values = (
        settings.position_range_rad,
        settings.speed_range_rad_per_s,
        settings.kp_range_N_m_per_rad,
        settings.kd_range_N_m_s_per_rad,
        settings.torque_range_N_m,
    )
    found = [value for value in values if value is not None]
    if len(found) < len(values):
        raise UserError("motor_driver: ranges are missing; a simulated mini cheetah drive takes them from the rig")
    return Spans(*found)


def _to_float(code: int, low: float, high: float, bits: int) -> float:
    return code * (high - low) / ((1 << bits) - 1) + low


def _to_code(value: float, limit: float, bits: int) -> int:
    """Cut off, as the C cast of all these firmwares does."""
    return int((value + limit) * ((1 << bits) - 1) / (2.0 * limit))


class SimulatedMit:
    """One mini cheetah drive on a forceps; a `Node`.

    `truth` is kept for `truth_duration_s`, once a period of the host.
    """

    def __init__(
        self,
        rig: Rig,
        load: LoadProfile,
        seed: int = 0,
        truth_duration_s: float = 0.0,
        jaw_start_rad: float = PAPER_JAW_START_RAD,
    ) -> None:
        """UserError when the rig doesn't say enough."""
        settings = rig.motor_driver
        if settings is None or settings.profile != "mit" or settings.mit_variant is None:
            raise UserError("motor_driver: profile must be mit here, with a mit_variant")
        law = rig.require_drive()
        self._forceps = forceps_of(rig, load, seed, jaw_start_rad)
        self._node = settings.node_id
        self._variant = settings.mit_variant
        self._spans = _spans_of(settings)
        default_id = self._node if self._variant == "cubemars" else 0
        self._reply_id = default_id if settings.reply_id is None else settings.reply_id
        self._ratio = settings.encoder_rev_per_pulley_rev
        self._zero_rad = 2.0 * math.pi * settings.encoder_zero_rev
        self._torque_constant = rig.plant().torque_constant_N_m_per_A
        self._tells_current_A = settings.feedback_current_range_A
        self._current_limit_A = law.current_limit_A
        self._period_ns = round(law.sample_time_s * 1e9)
        self._period_s = law.sample_time_s
        self._speed_gain = -math.expm1(-2.0 * math.pi * law.derivative_cutoff_Hz * law.sample_time_s)
        self._timeout_ns = 0 if self._variant == "cubemars" else round(settings.watchdog_s * 1e9)
        self._truth_every = max(round(rig.bench.host_period_s / law.sample_time_s), 1)
        self.truth = TruthLog(math.ceil(truth_duration_s / rig.bench.host_period_s))
        self.counters = {"not_understood": 0, "unanswered": 0}
        self.zero_ns: int | None = None
        self.enabled = False
        self.fault = 0
        self.command = NOTHING
        self._commanded_ns = 0
        self._stiff = 0  # commands with stiffness so far, at most `STIFF_COMMANDS`
        self._is_off_bus = False
        self._loops = 0
        self._angle_raw = self._forceps.read(0).theta_m  # wire's units, of the pulley
        self._speed_rad_per_s = 0.0  # of the pulley
        self._current_A = 0.0
        self._largest_A = 0.0  # since the last command
        self._outbox: list[Frame] = []

    def trip(self) -> None:
        """Leave the bus, as a controller does that is bus-off; the last command lasts as long as the time-out."""
        self._is_off_bus = True

    def reset(self) -> None:
        """Lose all state, as at power on."""
        self.enabled, self.fault, self.command = False, 0, NOTHING

    def reference_rad(self) -> float | None:
        """Return the angle of the motor pulley that the drive is led to; None where nothing leads it."""
        if not self.enabled or self.command.kp == 0.0:
            return None
        return (self.command.position_rad - self._zero_rad) / self._ratio

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Take a frame from the bus; the answer is made of the last loop's measurements."""
        self.wake(now_ns - 1)
        mask = 0x7F if self._variant == "bgkatz" else 0x7FF
        if self._is_off_bus or frame.is_fd or frame.is_extended or frame.arbitration_id & mask != self._node:
            return
        if len(frame.data) != 8:
            self.counters["not_understood"] += 1
            return
        is_special = frame.data[:7] == b"\xff" * 7 and frame.data[7] >= CLEAR
        if self._variant == "cubemars" and not is_special and not self.enabled:
            self.counters["unanswered"] += 1
            return
        self._answer()
        if is_special:
            self._obey(frame.data[7], now_ns)
        else:
            self._take(frame.data, now_ns)

    def next_wake_ns(self) -> int:
        """Return the bus time of the next loop."""
        return self._loops * self._period_ns

    def wake(self, now_ns: int) -> None:
        """Do all that is due, each at its own time."""
        while self.next_wake_ns() <= now_ns:
            self._loop(self.next_wake_ns())
            self._loops += 1

    def take_outbox(self) -> list[Frame]:
        """Hand over the frames to send."""
        frames, self._outbox = self._outbox, []
        return frames

    def _take(self, data: bytes, now_ns: int) -> None:
        spans = self._spans
        self._commanded_ns = now_ns
        self._largest_A = self._current_A
        self.command = Command(
            _to_float(data[0] << 8 | data[1], -spans.position_rad, spans.position_rad, 16),
            _to_float(data[2] << 4 | data[3] >> 4, -spans.speed_rad_per_s, spans.speed_rad_per_s, 12),
            _to_float((data[3] & 0xF) << 8 | data[4], 0.0, spans.kp, 12),
            _to_float(data[5] << 4 | data[6] >> 4, 0.0, spans.kd, 12),
            _to_float((data[6] & 0xF) << 8 | data[7], -spans.torque_N_m, spans.torque_N_m, 12),
        )
        if self.enabled and self.command.kp and self.zero_ns is None:
            self._stiff += 1
            if self._stiff == STIFF_COMMANDS:
                self.zero_ns = now_ns
                self._forceps.start_load(now_ns)

    def _obey(self, order: int, now_ns: int) -> None:
        if order == ENTER:
            self.enabled = self.enabled or not self.fault
            self._commanded_ns = max(self._commanded_ns, 0 if self._variant == "bgkatz" else now_ns)
        elif order == EXIT:
            self.enabled = False
            if self._variant == "bgkatz":
                self.command = NOTHING
        elif order == SET_ZERO and not self.enabled:
            self._zero_rad = -self._angle_raw * ANGLE_LSB_RAD * self._ratio
        elif order == CLEAR and self._variant == "damiao":
            self.fault = 0

    def _loop(self, at_ns: int) -> None:
        forceps, period_ns = self._forceps, self._period_ns
        if self._loops % self._truth_every == 0 and self.truth.capacity:
            self.truth.append(at_ns, at_ns, forceps.truth(at_ns))
        reading = forceps.read(at_ns)
        difference = (reading.theta_m - self._angle_raw) * ANGLE_LSB_RAD / self._period_s
        self._speed_rad_per_s += self._speed_gain * (difference - self._speed_rad_per_s)
        self._angle_raw, self._current_A = reading.theta_m, reading.current * CURRENT_LSB_A
        self._largest_A = max(self._largest_A, math.copysign(1.0, self._ratio) * self._current_A)
        if self.enabled and self._timeout_ns and at_ns - self._commanded_ns > self._timeout_ns:
            self.command = NOTHING
            if self._variant == "damiao":
                self.enabled, self.fault = False, COMMUNICATION_LOST
        forceps.hold(at_ns, at_ns + period_ns, self._wanted_A())

    def _wanted_A(self) -> float:
        if not self.enabled:
            return 0.0
        command, ratio = self.command, self._ratio
        reference_rad = self.reference_rad()
        torque_N_m = command.torque_N_m + command.kd * (command.speed_rad_per_s - self._speed_rad_per_s * ratio)
        if reference_rad is not None:
            torque_N_m += command.kp * ratio * (reference_rad - self._angle_raw * ANGLE_LSB_RAD)
        wanted_A = torque_N_m * ratio / self._torque_constant
        return min(max(wanted_A, -self._current_limit_A), self._current_limit_A)

    def _answer(self) -> None:
        spans, bgkatz = self._spans, self._variant == "bgkatz"
        position_rad = self._zero_rad + self._angle_raw * ANGLE_LSB_RAD * self._ratio
        sign = math.copysign(1.0, self._ratio)
        current_A = self._largest_A if bgkatz else sign * self._current_A
        last, span = current_A, self._tells_current_A
        if span is None:
            last, span = current_A * self._torque_constant / abs(self._ratio), spans.torque_N_m
        if not bgkatz:
            position_rad = min(max(position_rad, -spans.position_rad), spans.position_rad)
        speed_rad_per_s = self._speed_rad_per_s * self._ratio
        speed_rad_per_s = min(max(speed_rad_per_s, -spans.speed_rad_per_s), spans.speed_rad_per_s)
        packed = _to_code(position_rad, spans.position_rad, 16) & 0xFFFF
        packed = packed << 12 | _to_code(speed_rad_per_s, spans.speed_rad_per_s, 12)
        packed = packed << 12 | _to_code(min(max(last, -span), span), span, 12)
        status = self.fault or (ENABLED if self.enabled else DISABLED)
        head = status << 4 | self._node & 0xF if self._variant == "damiao" else self._node
        extra = {
            "bgkatz": b"\xff",  # what is left of the voltage
            "cubemars": bytes((_ROOM_DEGC, self.fault)),
            "damiao": bytes((_ROOM_DEGC, _ROOM_DEGC)),
        }[self._variant]
        self._outbox.append(Frame(self._reply_id, bytes((head,)) + packed.to_bytes(5, "big") + extra))
