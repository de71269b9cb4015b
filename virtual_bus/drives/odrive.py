"""A simulated ODrive: CANSimple of firmware 0.5 or 0.6 on a simulated forceps, as a node of the virtual bus.

It has the maker's states, defaults and traps: cyclic messages only where they are set, positions as 32-bit floats in
turns, an input position that outlives the state in which it was given, a watchdog that any frame feeds, errors that
stay until they are cleared. Its position loop is that of the rig's `drive:`; a real one's is a cascade of its own.
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

HEARTBEAT_NS: Final = 100_000_000
IDLE, CLOSED_LOOP = 1, 8
WATCHDOG_EXPIRED: Final = {"0.5": 0x800, "0.6": 0x1000000}
ESTOP_REQUESTED: Final = {"0.5": 0x4000, "0.6": 0x2000000}
INVALID_STATE: Final = {"0.5": 0x1, "0.6": 0x10}  # 0.6: bad configuration
BUS_OFF: Final = {"0.5": 0x200, "0.6": 0x40}  # controller failed; missing input
_POSITION_CONTROL, _PASSTHROUGH = 3, 1
MAX_INPUT_REV: Final = 2.0**31  # beyond, an angle has no place in the simulation's integers


class SimulatedODrive:
    """One axis of an ODrive on a forceps; a `Node`.

    `iq`: whether Iq is among its cyclic messages, which it isn't by default. The load begins with the first encoder
    message behind the first heartbeat that says closed loop: what a host can see. `truth` is kept for
    `truth_duration_s`, once for each encoder message.
    """

    def __init__(
        self,
        rig: Rig,
        load: LoadProfile,
        seed: int = 0,
        truth_duration_s: float = 0.0,
        jaw_start_rad: float = PAPER_JAW_START_RAD,
        *,
        iq: bool = True,
    ) -> None:
        """UserError when the rig doesn't say enough, or asks for periods that the loop's isn't a divisor of."""
        settings = rig.motor_driver
        if settings is None or settings.profile != "odrive":
            raise UserError("motor_driver.profile: must be odrive here")
        self._forceps = forceps_of(rig, load, seed, jaw_start_rad)
        self._settings: MotorDriver = settings
        self._period_ns = round(rig.require_drive().sample_time_s * 1e9)
        self._encoder_every = self._in_loops(settings.feedback_period_s, "feedback_period_s")
        self._iq_every = self._in_loops(settings.current_period_s, "current_period_s") if iq else 0
        self._watchdog_ns = round(settings.watchdog_s * 1e9)
        self.truth = TruthLog(math.ceil(truth_duration_s / settings.feedback_period_s))
        self.counters = {"not_understood": 0}
        self.zero_ns: int | None = None
        self.error = 0
        self.state = IDLE
        self.input_pos_rev = 0.0
        self.modes = (0, 0)
        self.limits = (math.inf, math.inf)
        self._said_closed_loop = False
        self._fed_ns = 0
        self._loops = 0
        self._next_heartbeat_ns = HEARTBEAT_NS
        self._outbox: list[Frame] = []

    def trip(self) -> None:
        """Fail as one whose controller has left the bus."""
        self._fail(BUS_OFF[self._settings.firmware])

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Take a frame from the bus."""
        self.wake(now_ns - 1)
        if frame.is_extended or frame.arbitration_id >> 5 != self._settings.node_id:
            return
        self._fed_ns = now_ns
        command, data = frame.arbitration_id & 0x1F, frame.data
        if command == 0x07 and len(data) >= 4:
            self._request(struct.unpack_from("<I", data)[0])
        elif command == 0x0B and len(data) == 8:
            self.modes = struct.unpack("<II", data)
        elif command == 0x0C and len(data) == 8:
            self._see_input(struct.unpack_from("<f", data)[0])
        elif command == 0x0F and len(data) == 8:
            self.limits = struct.unpack("<ff", data)
        elif command == 0x18:
            self.error = 0
        elif command == 0x02:
            self._fail(ESTOP_REQUESTED[self._settings.firmware])
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

    def _in_loops(self, period_s: float, key: str) -> int:
        loops = round(period_s * 1e9 / self._period_ns)
        if loops < 1 or abs(loops * self._period_ns - period_s * 1e9) > 1.0:
            raise UserError(f"motor_driver.{key}: {period_s:g} s is no multiple of drive.sample_time_s; change one")
        return loops

    def _loop(self, at_ns: int) -> None:
        if self._watchdog_ns and self.state == CLOSED_LOOP and at_ns - self._fed_ns > self._watchdog_ns:
            self._fail(WATCHDOG_EXPIRED[self._settings.firmware])
        if at_ns >= self._next_heartbeat_ns:
            self._next_heartbeat_ns += HEARTBEAT_NS
            self._send(0x01, struct.pack("<IB3x", self.error, self.state))
            self._said_closed_loop = self.state == CLOSED_LOOP
        is_feedback = self._loops % self._encoder_every == 0
        if is_feedback:
            if self._said_closed_loop and self.zero_ns is None:
                self.zero_ns = at_ns
                self._forceps.start_load(at_ns)
            if self.truth.capacity:
                self.truth.append(at_ns, at_ns, self._forceps.truth(at_ns))
        reference = self._reference_raw() if self.state == CLOSED_LOOP else None
        theta_m, current, _, _ = self._forceps.sample(at_ns, at_ns + self._period_ns, reference)
        ratio = self._settings.encoder_rev_per_pulley_rev
        if is_feedback:
            position = self._settings.encoder_zero_rev + theta_m / ANGLE_LSB_PER_REV * ratio
            self._send(0x09, struct.pack("<ff", position, 0.0))
        if self._iq_every and self._loops % self._iq_every == 0:
            iq = math.copysign(1.0, ratio) * current * CURRENT_LSB_A
            self._send(0x14, struct.pack("<ff", iq, iq))

    def _reference_raw(self) -> int:
        turns = (self.input_pos_rev - self._settings.encoder_zero_rev) / self._settings.encoder_rev_per_pulley_rev
        return round(turns * ANGLE_LSB_PER_REV)

    def _see_input(self, position_rev: float) -> None:
        if abs(position_rev) < MAX_INPUT_REV:
            self.input_pos_rev = position_rev
        else:  # NaN, too
            self.counters["not_understood"] += 1

    def _request(self, state: int) -> None:
        if state == IDLE:
            self.state = IDLE
        elif state != CLOSED_LOOP or self.modes != (_POSITION_CONTROL, _PASSTHROUGH):
            self._fail(INVALID_STATE[self._settings.firmware])
        elif not self.error:
            self.state = CLOSED_LOOP

    def _fail(self, error: int) -> None:
        self.error |= error
        self.state = IDLE

    def _send(self, command: int, data: bytes) -> None:
        self._outbox.append(Frame(self._settings.node_id << 5 | command, data))
