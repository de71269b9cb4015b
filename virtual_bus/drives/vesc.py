"""A simulated VESC: its CAN protocol on a simulated forceps, as a node of the virtual bus.

It has the maker's states, defaults and traps: torque from the first position on, the shorter way round to it, a timeout
that any command feeds and that the next command undoes, faults that end by themselves, an angle that wraps, numbers
truncated towards zero, a mean current that whoever asks takes away, status messages whose current has no direction. Its
position loop is that of the rig's `drive:`; a real one's is `foc_run_pid_control_pos`.
"""

import math
import struct
from typing import Final

from firmware_protocol.frames import Frame
from firmware_protocol.scales import ANGLE_LSB_PER_REV, CURRENT_LSB_A
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.sections import MotorDriver
from virtual_bus.drive import PAPER_JAW_START_RAD, forceps_of
from virtual_bus.plant.load import LoadProfile
from virtual_bus.truth_log import TruthLog

TIMEOUT_LOOK_NS: Final = 10_000_000  # timeout.c looks this often
FAULT_STOP_NS: Final = 500_000_000  # m_fault_stop_time_ms
BOOT_NS: Final = 300_000_000
STATUS_NS: Final = 20_000_000  # 50 Hz, APPCONF_CAN_STATUS_RATE_1
MINIMUM_CURRENT_A: Final = 0.05  # cc_min_current
INDEX_SHARE: Final = 0.4  # of the greatest current, by which the encoder's index is looked for
UNDER_VOLTAGE: Final = 2
_GET_VALUES_SELECTIVE, _ALIVE = 50, 30
_STATUS_BIT: Final = 1 << 21
_SUPPLY_V, _RESISTANCE_Ohm = 24.0, 1.0


class SimulatedVesc:
    """A VESC on a forceps; a `Node`.

    `has_status_bit`: its firmware is 5.03 or later. `has_index`: its encoder is absolute, or has found its index. The
    load begins with the first answer behind a reference that differs from the first: then the host leads. `truth` is
    kept for `truth_duration_s`, once for each answer.
    """

    def __init__(
        self,
        rig: Rig,
        load: LoadProfile,
        seed: int = 0,
        truth_duration_s: float = 0.0,
        jaw_start_rad: float = PAPER_JAW_START_RAD,
        *,
        has_status_bit: bool = True,
        has_index: bool = True,
    ) -> None:
        """UserError when the rig doesn't say enough."""
        settings = rig.motor_driver
        if settings is None or settings.profile != "vesc":
            raise UserError("motor_driver.profile: must be vesc here")
        law = rig.require_drive()
        self._forceps = forceps_of(rig, load, seed, jaw_start_rad)
        self._settings: MotorDriver = settings
        self._period_ns = round(law.sample_time_s * 1e9)
        self._index_lead_raw = round(
            INDEX_SHARE * law.current_limit_A / law.kp_A_per_rad / (2.0 * math.pi) * ANGLE_LSB_PER_REV
        )
        self.node = settings.node_id
        self.truth = TruthLog(math.ceil(truth_duration_s / rig.bench.host_period_s))
        self.counters = {"not_understood": 0, "not_simulated": 0, "ignored": 0}
        self.zero_ns: int | None = None
        self.timeout_ns = round(settings.watchdog_s * 1e9)
        self.has_timeout = True  # nobody has commanded it yet
        self.is_killed = False
        self.fault = 0
        self.target_deg: float | None = None  # None: no modulation
        self._has_status_bit = has_status_bit
        self._has_index = has_index
        self._first_target_deg: float | None = None
        self._leads = False
        self._fed_ns: int | None = None
        self._ignores_until_ns = 0
        self._silent_until_ns = 0
        self._next_look_ns = 0
        self._next_status_ns = STATUS_NS
        self._loops = 0
        self._theta_raw = self._forceps.read(0).theta_m
        self._current_A = 0.0
        self._was_driven = False
        self._current_sum, self._current_count = 0.0, 0
        self._outbox: list[Frame] = []

    def trip(self) -> None:
        """Fail as one whose controller has left the bus: no command comes any more."""
        self._fed_ns = None

    def fail(self, fault: int, now_ns: int) -> None:
        """Stop for a fault, and ignore commands for a while."""
        self.fault, self._ignores_until_ns = fault, now_ns + FAULT_STOP_NS
        self.target_deg = None

    def reboot(self, now_ns: int) -> None:
        """Begin anew, as behind a loss of power."""
        self.target_deg, self.fault, self._fed_ns, self.has_timeout = None, 0, None, True
        self._silent_until_ns = now_ns + BOOT_NS

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Take a frame from the bus."""
        self.wake(now_ns - 1)
        node, command, data = frame.arbitration_id & 0xFF, frame.arbitration_id >> 8, frame.data
        if not frame.is_extended or node not in (self.node, 255) or now_ns < self._silent_until_ns:
            return
        if command in range(5) or command in range(10, 14):
            self._command(command, data, now_ns)
        elif command == 8 and len(data) > 2 and data[1] == 0:
            self._packet(data[0], data[2:], now_ns)
        elif command == 17 and len(data) == 1:
            self._send(data[0], 18, bytes((self.node, 0)))
        else:
            self.counters["not_understood"] += 1

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
        if self._silent_until_ns and at_ns >= self._silent_until_ns:
            self._silent_until_ns = 0
            self._send(self.node, 57, b"60_MK6")
        if at_ns >= self._next_look_ns:
            self._next_look_ns += TIMEOUT_LOOK_NS
            self._look_at_timeout(at_ns)
        if self.fault and at_ns >= self._ignores_until_ns:
            self.fault = 0
        theta, current, _, _ = self._forceps.sample(at_ns, at_ns + self._period_ns, self._reference_raw())
        self._theta_raw = theta
        ratio = self._settings.encoder_rev_per_pulley_rev
        # What was held up to now; firmware that doesn't modulate says that it measures nothing.
        self._current_A = math.copysign(1.0, ratio) * current * CURRENT_LSB_A if self._was_driven else 0.0
        self._was_driven = self.target_deg is not None
        self._current_sum += self._current_A
        self._current_count += 1
        if at_ns >= self._next_status_ns:
            self._next_status_ns += STATUS_NS
            if not self._silent_until_ns:
                self._broadcast()

    def _look_at_timeout(self, at_ns: int) -> None:
        if self.timeout_ns == 0:
            self.has_timeout = False
            return
        self.has_timeout = self._fed_ns is None or at_ns - self._fed_ns > self.timeout_ns
        if self.has_timeout or self.is_killed:
            self.target_deg = None

    def _turns(self) -> float:
        """Return the angle that it tells, with all its turns."""
        settings = self._settings
        return settings.encoder_zero_rev + self._theta_raw / ANGLE_LSB_PER_REV * settings.encoder_rev_per_pulley_rev

    def _angle_deg(self) -> float:
        return _float32(_float32(self._turns() % 1.0 * 360.0) % 360.0)

    def _reference_raw(self) -> int | None:
        if self.target_deg is None:
            return None
        if not self._has_index:
            return self._theta_raw + self._index_lead_raw
        turns = self._turns()
        turns += (self.target_deg / 360.0 - turns + 0.5) % 1.0 - 0.5  # the shorter way
        settings = self._settings
        return round((turns - settings.encoder_zero_rev) / settings.encoder_rev_per_pulley_rev * ANGLE_LSB_PER_REV)

    def _command(self, command: int, data: bytes, now_ns: int) -> None:
        if len(data) < 4:
            self.counters["not_understood"] += 1
            return
        self._fed_ns = now_ns
        if now_ns < self._ignores_until_ns:
            self.counters["ignored"] += 1
            return
        (value,) = struct.unpack_from(">i", data)
        if command == 4:
            self.target_deg = _float32(_float32(value / 1e6) % 360.0)
            self._leads = self._leads or self._first_target_deg not in (None, self.target_deg)
            self._first_target_deg = self.target_deg if self._first_target_deg is None else self._first_target_deg
        elif command in (1, 2) and abs(value) < MINIMUM_CURRENT_A * 1e3:
            self.target_deg = None
        else:
            self.counters["not_simulated"] += 1

    def _packet(self, sender: int, packet: bytes, now_ns: int) -> None:
        if packet[0] == _ALIVE:
            self._fed_ns = now_ns
        elif packet[0] == _GET_VALUES_SELECTIVE and len(packet) == 5:
            if self.zero_ns is None and self._leads:
                self.zero_ns = now_ns
                self._forceps.start_load(self.next_wake_ns())
            if self.truth.capacity:
                self.truth.append(now_ns, now_ns, self._forceps.truth(self.next_wake_ns()))
            self._answer(sender, self._values(struct.unpack_from(">I", packet, 1)[0]))
        else:
            self.counters["not_understood"] += 1

    def _values(self, mask: int) -> bytes:
        answer = bytes((_GET_VALUES_SELECTIVE,)) + struct.pack(">I", mask)
        if mask & 1 << 5:
            mean_A = self._current_sum / self._current_count if self._current_count else 0.0
            self._current_sum, self._current_count = 0.0, 0
            answer += struct.pack(">i", math.trunc(mean_A * 100.0))
        if mask & 1 << 15:
            answer += bytes((self.fault,))
        if mask & 1 << 16:
            answer += struct.pack(">i", math.trunc(self._angle_deg() * 1e6))
        if mask & _STATUS_BIT and self._has_status_bit:
            answer += bytes((self.has_timeout | self.is_killed << 1,))
        return answer

    def _answer(self, host: int, answer: bytes) -> None:
        for offset in range(0, len(answer), 7):
            self._send(host, 5, bytes((offset,)) + answer[offset : offset + 7])
        self._send(host, 7, struct.pack(">BBHH", self.node, 1, len(answer), _crc(answer)))

    def _broadcast(self) -> None:
        # As firmware tells it: the sign says whether the motor drives or brakes, not which way its torque goes.
        duty = self._current_A * _RESISTANCE_Ohm / _SUPPLY_V
        current = math.trunc(abs(self._current_A) * 10.0)
        self._send(self.node, 9, struct.pack(">ihh", 0, current, math.trunc(duty * 1e3)))
        self._send(self.node, 14, bytes(8))
        self._send(self.node, 15, bytes(8))
        self._send(self.node, 16, struct.pack(">hhhh", 250, 250, 0, math.trunc(self._angle_deg() * 50.0)))

    def _send(self, node: int, command: int, data: bytes) -> None:
        self._outbox.append(Frame(command << 8 | node, data, is_extended=True))


def _float32(value: float) -> float:
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def _crc(data: bytes) -> int:
    """Return the CRC-16 with polynomial 1021h, from 0, bit by bit."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc
