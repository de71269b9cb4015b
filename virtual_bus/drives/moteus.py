"""A simulated moteus: registers over CAN FD on a simulated forceps, as a node of the virtual bus.

It has the maker's states, defaults and traps: it answers only where it is asked, and shows the mode as it was before
the command of the same frame; a command forgets the one before as a whole; it leads its reference at 50 rev/s² unless
told otherwise; a watchdog of 0.1 s that only commands feed, and that latches; faults and timeouts that only a stop
ends, and which any stop ends; a code in the fault register that is no fault; after a reset it obeys the next command as
if nothing had been. Its position loop is that of the rig's `drive:`. In its timeout it has no torque, where a real one
damps.
"""

import math
import struct
from typing import Final

from firmware_protocol.frames import Frame
from firmware_protocol.scales import ANGLE_LSB_PER_REV, CURRENT_LSB_A
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError
from virtual_bus.drive import PAPER_JAW_START_RAD, forceps_of
from virtual_bus.plant.load import LoadProfile
from virtual_bus.truth_log import TruthLog

STOPPED, FAULT, ENABLING, CALIBRATING, POSITION, TIMEOUT = 0, 1, 2, 3, 10, 11
REGISTER_MAP, FIRMWARE = 5, 0x010100
DEFAULT_TIMEOUT_S, DEFAULT_ACCEL_LIMIT, DEFAULT_VELOCITY_LIMIT = 0.1, 50.0, math.nan
ENABLING_NS, CALIBRATING_NS = 2_000_000, 8_000_000
MAX_TORQUE_LIMITS: Final = 102
_LAST_MODE: Final = 15
_UNKNOWN, _READ_ONLY = 1, 2
_BROADCAST: Final = 0x7F
_LENGTHS: Final = (*range(9), 12, 16, 20, 24, 32, 48, 64)
_FORMATS: Final = "bhif"
_FLOAT: Final = 3
_LARGEST_REV: Final = 32768.0
# Command registers by what they are before a command says otherwise.
_COMMAND: Final[dict[int, float]] = {
    0x020: 0.0, 0x021: 0.0, 0x022: 0.0, 0x023: 1.0, 0x024: 1.0, 0x025: 100.0, 0x026: math.nan, 0x027: 0.0,
    0x028: math.nan, 0x029: math.nan,
}  # fmt: skip
_POSITION_COUNTS, _SPEED_COUNTS, _TORQUE_COUNTS = (1e-2, 1e-4, 1e-5), (0.1, 2.5e-4, 1e-5), (0.5, 1e-2, 1e-3)
_ONE_COUNTS, _CURRENT_COUNTS, _VOLT_COUNTS = (1.0, 1.0, 1.0), (1.0, 0.1, 1e-3), (0.5, 0.1, 1e-3)
_PART_COUNTS: Final = (1.0 / 127.0, 1.0 / 32767.0, 1.0 / 2147483647.0)
# What one count of an int8, int16, int32 is.
_COUNTS: Final[dict[int, tuple[float, float, float]]] = {
    0x000: _ONE_COUNTS, 0x001: _POSITION_COUNTS, 0x002: _SPEED_COUNTS, 0x003: _TORQUE_COUNTS,
    0x004: _CURRENT_COUNTS, 0x005: _CURRENT_COUNTS, 0x00B: _ONE_COUNTS, 0x00C: _ONE_COUNTS, 0x00D: _VOLT_COUNTS,
    0x00E: _CURRENT_COUNTS, 0x00F: _ONE_COUNTS, 0x020: _POSITION_COUNTS, 0x021: _SPEED_COUNTS, 0x022: _TORQUE_COUNTS,
    0x023: _PART_COUNTS, 0x024: _PART_COUNTS, 0x025: _TORQUE_COUNTS, 0x026: _POSITION_COUNTS,
    0x027: (1e-2, 1e-3, 1e-6), 0x028: _SPEED_COUNTS, 0x029: (0.05, 1e-3, 1e-5),
}  # fmt: skip


class SimulatedMoteus:
    """One moteus on a forceps; a `Node`. The load begins with the first answer that says position mode."""

    def __init__(
        self,
        rig: Rig,
        load: LoadProfile,
        seed: int = 0,
        truth_duration_s: float = 0.0,
        jaw_start_rad: float = PAPER_JAW_START_RAD,
        *,
        register_map: int = REGISTER_MAP,
    ) -> None:
        """UserError when the rig doesn't say enough."""
        settings = rig.motor_driver
        if settings is None or settings.profile != "moteus":
            raise UserError("motor_driver.profile: must be moteus here")
        self.node = settings.node_id
        self._forceps = forceps_of(rig, load, seed, jaw_start_rad)
        self._ratio, self._zero_rev = settings.encoder_rev_per_pulley_rev, settings.encoder_zero_rev
        self._period_ns = round(rig.require_drive().sample_time_s * 1e9)
        self._torque_per_A = rig.plant().torque_constant_N_m_per_A / abs(self._ratio)
        self.truth = TruthLog(math.ceil(truth_duration_s / rig.bench.host_period_s))
        self.counters = {"not_understood": 0}
        self.zero_ns: int | None = None
        self._register_map = register_map
        self._loops = 0
        self._outbox: list[Frame] = []
        self._theta_raw = self._forceps.read(0).theta_m
        self._speed_rev_per_s = self._current_A = 0.0
        self.has_position = True
        self.reboot(0)

    def reboot(self, now_ns: int) -> None:
        """Begin anew, as behind a loss of power: everything but the configuration is forgotten."""
        self.mode, self.fault = STOPPED, 0
        self.command = dict(_COMMAND)
        self.control_rev, self._control_rev_per_s = 0.0, 0.0
        self._written: dict[int, float] = {}  # by the frame under way, with the mode under 0
        self._pending: dict[int, float] = {}  # a command on its way to the loop
        self._left_s = math.nan  # of the watchdog's time
        self._booted_ns = self._since_ns = now_ns

    def trip(self) -> None:
        """Do nothing: a moteus recovers from bus-off by itself, and what it doesn't hear feeds no watchdog."""

    def fail(self, fault: int) -> None:
        """Latch a fault."""
        self.mode, self.fault = FAULT, fault

    # -- the bus ------------------------------------------------------------------------------------------------------

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Take a frame from the bus."""
        self.wake(now_ns - 1)
        arbitration_id = frame.arbitration_id
        if arbitration_id > 0xFFFF or arbitration_id & 0xFF not in (self.node, _BROADCAST):
            return
        answer = bytearray()
        self._written = {}
        try:
            self._process(frame.data, answer, now_ns)
        except (struct.error, IndexError):
            self.counters["not_understood"] += 1
        self._pending = self._written or self._pending
        source = arbitration_id >> 8
        if source & 0x80:
            self._answer((self.node << 8) | source & 0x7F, bytes(answer), frame.is_fd)

    def _answer(self, arbitration_id: int, data: bytes, is_fd: bool) -> None:
        if len(data) > _LENGTHS[-1]:
            self.counters["not_understood"] += 1
            return
        padded = data.ljust(next(length for length in _LENGTHS if length >= len(data)), b"\x50")
        self._outbox.append(Frame(arbitration_id, padded, is_fd or len(padded) > 8, arbitration_id >= 0x800))

    def _process(self, data: bytes, answer: bytearray, now_ns: int) -> None:
        """Obey subframes in their order; struct.error or IndexError where one is cut off."""
        at = 0
        while at < len(data):
            code, at = data[at], at + 1
            if code == 0x50:
                continue
            if code > 0x1F:
                self.counters["not_understood"] += 1
                return
            width, count = code >> 2 & 3, code & 3
            if not count:
                count, at = _number(data, at)
            first, at = _number(data, at)
            if code >= 0x10:
                if not self._read(code, width, count, first, answer, now_ns):
                    return
                continue
            for register in range(first, first + count):
                (value,) = struct.unpack_from(f"<{_FORMATS[width]}", data, at)
                at += struct.calcsize(f"<{_FORMATS[width]}")
                self._write(register, width, value, answer)

    def _write(self, register: int, width: int, value: float, answer: bytearray) -> None:
        if register == 0 and 0 <= value <= _LAST_MODE:
            self._written = {0: value, **_COMMAND}
        elif register in _COMMAND:
            if self._written:  # else no mode was written before it
                self._written[register] = _scaled(register, width, value)
        else:
            error = _READ_ONLY if register in _COUNTS and register else _UNKNOWN
            answer += b"\x30" + _packed(register) + bytes((error,))

    def _read(self, code: int, width: int, count: int, first: int, answer: bytearray, now_ns: int) -> bool:
        """Answer a read with a reply of the same form, or an error that ends the frame."""
        reply = bytes((code + 0x10,)) + (b"" if code & 3 else _packed(count)) + _packed(first)
        for register in range(first, first + count):
            value = self._value(register, width, now_ns)
            if value is None:
                answer += b"\x31" + _packed(register) + bytes((_UNKNOWN,))
                return False
            reply += value
        answer += reply
        return True

    def _value(self, register: int, width: int, now_ns: int) -> bytes | None:
        whole = {0x070: (now_ns - self._booted_ns) // 1_000_000 & 0x7FFFFFFF, 0x100: 7, 0x101: FIRMWARE}
        whole[0x102] = self._register_map
        if register in whole:
            return struct.pack("<i", whole[register]) if width == 2 else None
        if register not in _COUNTS:
            return None
        if register == 0x001:
            self._is_read(now_ns)
        value = {
            0x000: self.mode, 0x001: self.position_rev(), 0x002: self._speed_rev_per_s,
            0x003: self._current_A * self._torque_per_A, 0x004: self._current_A, 0x00D: 24.0, 0x00E: 30.0,
            0x00F: self.fault, **self.command,
        }.get(register, 0.0)  # fmt: skip
        if width == _FLOAT:
            return struct.pack("<f", value)
        limit = (1 << 8 * (1 << width) - 1) - 1
        counts = -limit - 1 if math.isnan(value) else round(value / _COUNTS[register][width])
        return struct.pack(f"<{_FORMATS[width]}", max(-limit - 1, min(limit, counts)))

    def _is_read(self, now_ns: int) -> None:
        """Note that the host can see the position now, and with it the mode."""
        if self.mode == POSITION and self.zero_ns is None:
            self.zero_ns = now_ns
            self._forceps.start_load(self.next_wake_ns())
        if self.truth.capacity:
            self.truth.append(now_ns, now_ns, self._forceps.truth(self.next_wake_ns()))

    # -- the loop -----------------------------------------------------------------------------------------------------

    def position_rev(self) -> float:
        """Return what it calls the angle of its output; NaN without a valid encoder."""
        return self._zero_rev + self._theta_raw / ANGLE_LSB_PER_REV * self._ratio if self.has_position else math.nan

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

    def _loop(self, at_ns: int) -> None:
        self._obey(at_ns)
        self._left_s -= self._period_ns * 1e-9
        if self.mode == POSITION and self._left_s < 0.0:
            self.mode = TIMEOUT
        reference = self._reference_raw() if self.mode == POSITION else None
        before = self._theta_raw
        self._theta_raw, current, _, _ = self._forceps.sample(at_ns, at_ns + self._period_ns, reference)
        self._speed_rev_per_s = (self._theta_raw - before) / ANGLE_LSB_PER_REV * self._ratio / (self._period_ns * 1e-9)
        self._current_A = math.copysign(1.0, self._ratio) * current * CURRENT_LSB_A
        if self.mode == POSITION:
            limits = abs(self._current_A) * self._torque_per_A >= self.command[0x025]
            self.fault = MAX_TORQUE_LIMITS if limits else 0

    def _obey(self, at_ns: int) -> None:
        """Take the command that has come, and go on towards its mode."""
        if self._pending:
            self.command, self._pending = self._pending, {}
            wanted, timeout_s = int(self.command.pop(0)), self.command[0x027]
            self._left_s = DEFAULT_TIMEOUT_S if timeout_s == 0.0 else timeout_s
            if wanted == STOPPED:
                self.mode, self.fault = STOPPED, 0
            elif wanted == POSITION and self.mode == STOPPED:
                self.mode, self._since_ns = ENABLING, at_ns
        if self.mode == ENABLING and at_ns - self._since_ns >= ENABLING_NS:
            self.mode = CALIBRATING
        if self.mode == CALIBRATING and at_ns - self._since_ns >= ENABLING_NS + CALIBRATING_NS:
            self.mode = POSITION
            self.control_rev, self._control_rev_per_s = self.position_rev(), 0.0

    def _reference_raw(self) -> int:
        self._move_control(self._period_ns * 1e-9)
        return round((self.control_rev - self._zero_rev) / self._ratio * ANGLE_LSB_PER_REV)

    def _move_control(self, period_s: float) -> None:
        """Lead what the loop follows to the commanded position: at once, or at the limits in force."""
        target, speed = self.command[0x020], self.command[0x021]
        if not math.isfinite(target):
            return  # it stays where it is
        target = max(-_LARGEST_REV, min(_LARGEST_REV, target))
        accel, velocity = self._limit(0x029, DEFAULT_ACCEL_LIMIT), self._limit(0x028, DEFAULT_VELOCITY_LIMIT)
        if math.isinf(accel) and math.isinf(velocity):
            self.control_rev = target
            self.command[0x020] = target + (0.0 if math.isnan(speed) else speed) * period_s
            return
        off = target - self.control_rev
        brakes = math.inf if math.isinf(accel) else math.sqrt(2.0 * accel * abs(off))
        wanted = math.copysign(min(velocity, brakes, abs(off) / period_s), off)
        step = accel * period_s
        self._control_rev_per_s += max(-step, min(step, wanted - self._control_rev_per_s))
        self.control_rev += self._control_rev_per_s * period_s

    def _limit(self, register: int, default: float) -> float:
        """Return a limit in force: NaN in a command is what is configured, a negative number none."""
        commanded = self.command[register]
        value = default if math.isnan(commanded) else commanded
        return value if value >= 0.0 else math.inf


def _number(data: bytes, at: int) -> tuple[int, int]:
    """Read seven bits a byte, lowest first; IndexError where it is cut off."""
    number = shift = 0
    while True:
        byte, at = data[at], at + 1
        number |= (byte & 0x7F) << shift
        shift += 7
        if not byte & 0x80 or shift > 28:
            return number, at


def _packed(number: int) -> bytes:
    out = bytearray()
    while number > 0x7F:
        out.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes((*out, number))


def _scaled(register: int, width: int, value: float) -> float:
    if width == _FLOAT:
        return value
    return math.nan if value == -(1 << 8 * (1 << width) - 1) else value * _COUNTS[register][width]
