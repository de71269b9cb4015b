"""A simulated Dynamixel of the X series (XM430-W350): protocol 2.0 on a simulated forceps, as a node of a serial line.

It has the maker's states, defaults and traps: it says nothing unless it is asked; EEPROM that is locked under torque; a
return delay; a bus watchdog that any instruction packet feeds, that stops the servo and leaves its torque on, and makes
goals read only until it is cleared; hardware errors that take the torque off until it is rebooted, and alerts in every
status packet; RAM that a restart forgets, indirect addresses with it; positions within one turn after that.

Its position loop is that of the rig's `drive:`, as long as the goal current isn't 0; other goal currents don't limit,
profiles don't shape. Values are those of its last loop. CLEAR, FACTORY RESET, REG WRITE, ACTION and the bulk and fast
instructions are instruction errors here.
"""

import math
from collections import deque
from typing import Final

from firmware_protocol.frames import Frame
from firmware_protocol.scales import ANGLE_LSB_PER_REV, CURRENT_LSB_A
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.sections import MotorDriver
from virtual_bus.drive import PAPER_JAW_START_RAD, forceps_of
from virtual_bus.drives import dynamixel_table as table
from virtual_bus.plant.load import LoadProfile
from virtual_bus.truth_log import TruthLog

BROADCAST: Final = 0xFE
PING, READ, WRITE, REBOOT, STATUS, SYNC_READ, SYNC_WRITE = 0x01, 0x02, 0x03, 0x08, 0x55, 0x82, 0x83
ALERT: Final = 0x80
COUNTS_PER_REV: Final = 4096
CURRENT_UNIT_A: Final = 2.69e-3
CURRENT_BASED_POSITION: Final = 5
TORQUE_ON_BY_GOAL: Final = 0x08  # of Drive Mode (10)
OVERLOAD: Final = 0x20
_WATCHDOG_UNIT_NS: Final = 20_000_000
_DELAY_UNIT_NS: Final = 2_000
MODE, TORQUE, LEVEL, ERROR, GOAL, PRESENT_CURRENT, POSITION, TICK = 11, 64, 68, 70, 116, 126, 132, 120


class SimulatedDynamixel:
    """One servo on a forceps; a `Node`.

    `goal_follows`: whether switching torque on makes the present position the goal; the maker doesn't say. The load
    begins with the first answer that says torque while there is a goal current, what a host can see, and anew with each
    first one after another. `truth` is kept for `truth_duration_s`, once a loop.
    """

    def __init__(
        self,
        rig: Rig,
        load: LoadProfile,
        seed: int = 0,
        truth_duration_s: float = 0.0,
        jaw_start_rad: float = PAPER_JAW_START_RAD,
        *,
        goal_follows: bool = True,
    ) -> None:
        """UserError when the rig doesn't say enough."""
        settings = rig.motor_driver
        if settings is None or settings.profile != "dynamixel":
            raise UserError("motor_driver.profile: must be dynamixel here")
        self._forceps = forceps_of(rig, load, seed, jaw_start_rad)
        self._settings: MotorDriver = settings
        self._period_ns = round(rig.require_drive().sample_time_s * 1e9)
        self._goal_follows = goal_follows
        self.truth = TruthLog(math.ceil(truth_duration_s * 1e9 / self._period_ns))
        self.counters = {"not_understood": 0, "answers": 0, "reboots": 0, "watchdog_trips": 0}
        self.zero_ns: int | None = None
        self.table = table.ControlTable()
        self.table.put(7, settings.node_id)
        self._is_shut_down = False
        self._had_torque = False  # in the last answer with feedback
        self._heard_ns = 0
        self._loops = 0
        self._own_counts = 0
        self._turns_off = 0  # counts by which the present position differs from them
        self._answers: deque[tuple[int, Frame]] = deque()
        self._outbox: list[Frame] = []
        self._loop(0)
        self._count_from_one_turn()
        self._loops = 1

    def trip(self) -> None:
        """Do nothing: a servo whose line is cut doesn't notice but by its bus watchdog."""

    def fail(self, error: int) -> None:
        """Have hardware errors; those in Shutdown (63) take the torque off."""
        self.table.put(ERROR, self.table.get(ERROR) | error)
        if error & self.table.get(63):
            self._is_shut_down = True
            self.table.put(TORQUE, 0)

    def restart(self) -> None:
        """Begin anew, as after a loss of power."""
        self.table.restart()
        self._is_shut_down = False
        self._answers.clear()
        self.counters["reboots"] += 1
        self._count_from_one_turn()

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Take a packet from the line; one without data had a wrong CRC."""
        self.wake(now_ns - 1)
        servo_id, data = frame[0], frame[1]
        if data[:1] == bytes((STATUS,)):
            return
        if data:
            self._heard_ns = now_ns
        own = self.table.get(7)
        if servo_id not in {own, BROADCAST}:
            return
        answer = self._take(data, servo_id == BROADCAST)
        if answer is None:
            return
        error, values = answer
        if self.table.get(ERROR):
            error |= ALERT
        status = bytes((STATUS, error)) + values
        self._answers.append((now_ns + self.table.get(9) * _DELAY_UNIT_NS, Frame(own, status, len(status) > 8)))
        self.counters["answers"] += 1
        self._look_for_zero(data, now_ns)
        if data[:1] == bytes((REBOOT,)):
            answers = list(self._answers)
            self.restart()
            self._answers.extend(answers)

    def next_wake_ns(self) -> int:
        """Return when the next loop or answer is due."""
        loop_ns = self._loops * self._period_ns
        return min(loop_ns, self._answers[0][0]) if self._answers else loop_ns

    def wake(self, now_ns: int) -> None:
        """Do all that is due, each at its own time."""
        while self._loops * self._period_ns <= now_ns:
            self._loop(self._loops * self._period_ns)
            self._loops += 1
        while self._answers and self._answers[0][0] <= now_ns:
            self._outbox.append(self._answers.popleft()[1])

    def take_outbox(self) -> list[Frame]:
        """Hand over the packets to send."""
        frames, self._outbox = self._outbox, []
        return frames

    def _take(self, data: bytes, is_broadcast: bool) -> tuple[int, bytes] | None:
        """Do what an instruction says; return error and parameters of the answer, None where there is none."""
        level = self.table.get(LEVEL)
        instruction, parameters = (data[0], data[1:]) if data else (None, b"")
        if instruction == PING:
            return 0, bytes(self.table.data[0:2]) + bytes(self.table.data[6:7])
        if instruction == SYNC_READ and is_broadcast:
            return self._sync_read(parameters) if level >= 1 else None
        if instruction == SYNC_WRITE and is_broadcast:
            self._sync_write(parameters)
            return None
        if instruction == READ and len(parameters) == 4:
            values, error = self.table.read(_word(parameters), _word(parameters[2:]))
            return (error, values) if level >= 1 and not is_broadcast else None
        if instruction == WRITE and len(parameters) > 2:
            error = self._write(_word(parameters), parameters[2:])
        elif instruction == REBOOT:
            error = 0
        else:
            self.counters["not_understood"] += 1
            error = table.INSTRUCTION if data else table.CRC
        return (error, b"") if level == 2 and not is_broadcast else None

    def _sync_read(self, parameters: bytes) -> tuple[int, bytes] | None:
        if len(parameters) < 5 or self.table.get(7) not in parameters[4:]:
            return None
        values, error = self.table.read(_word(parameters), _word(parameters[2:]))
        return error, values

    def _sync_write(self, parameters: bytes) -> None:
        address, size = _word(parameters), _word(parameters[2:])
        for at in range(4, len(parameters), 1 + size):
            if parameters[at] == self.table.get(7):
                self._write(address, parameters[at + 1 : at + 1 + size])

    def _write(self, address: int, data: bytes) -> int:
        had_torque, goal = self.table.get(TORQUE), self.table.get(GOAL)
        written, error = self.table.write(address, data)
        if MODE in written:
            self.table.put(table.GOAL_CURRENT, self.table.get(table.CURRENT_LIMIT))
            self.table.put(108, 0)
            self.table.put(112, 0)
        if GOAL in written and self.table.get(10) & TORQUE_ON_BY_GOAL and not self._is_shut_down:
            self.table.put(TORQUE, 1)
        elif TORQUE in written and self.table.get(TORQUE) and not had_torque:
            if self._is_shut_down:
                self.table.put(TORQUE, 0)
                return table.RESULT_FAIL
            self.table.put(GOAL, self._present() if self._goal_follows else goal)
        return error

    def _look_for_zero(self, asked: bytes, now_ns: int) -> None:
        """Begin the load where a host has read feedback under torque."""
        if asked[:1] not in {bytes((READ,)), bytes((SYNC_READ,))} or _word(asked[3:]) < 10:
            return
        has_torque = bool(self.table.get(TORQUE) and self.table.get(table.GOAL_CURRENT))
        if has_torque and not self._had_torque:
            self.zero_ns = now_ns
            self._forceps.start_load(now_ns)
        self._had_torque = has_torque

    def _loop(self, at_ns: int) -> None:
        self._watch(at_ns)
        if self.truth.capacity:
            self.truth.append(at_ns, at_ns, self._forceps.truth(at_ns))
        reference = self._reference_raw() if self._is_driven() else None
        theta_m, current, _, _ = self._forceps.sample(at_ns, at_ns + self._period_ns, reference)
        ratio, zero = self._settings.encoder_rev_per_pulley_rev, self._settings.encoder_zero_rev
        self._own_counts = math.floor((zero + theta_m / ANGLE_LSB_PER_REV * ratio) * COUNTS_PER_REV + 0.5)
        self.table.put(POSITION, self._own_counts + self._turns_off + self.table.get(20))
        units = round(math.copysign(1.0, ratio) * current * CURRENT_LSB_A / CURRENT_UNIT_A)
        self.table.put(PRESENT_CURRENT, units)
        self.table.put(TICK, at_ns // 1_000_000 % 32_768)

    def _watch(self, at_ns: int) -> None:
        watchdog = self.table.data[table.BUS_WATCHDOG]
        is_on = watchdog not in {0, table.TRIPPED} and self.table.get(TORQUE)
        if is_on and at_ns - self._heard_ns > watchdog * _WATCHDOG_UNIT_NS:
            self.table.put(table.BUS_WATCHDOG, table.TRIPPED)
            self.table.put(GOAL, self._present())
            self.counters["watchdog_trips"] += 1

    def _is_driven(self) -> bool:
        is_position = self.table.get(MODE) == CURRENT_BASED_POSITION
        return bool(is_position and self.table.get(TORQUE) and self.table.get(table.GOAL_CURRENT))

    def _present(self) -> int:
        return int.from_bytes(self.table.data[POSITION : POSITION + 4], "little", signed=True)

    def _reference_raw(self) -> int:
        counts = self.table.get(GOAL) - self._turns_off - self.table.get(20)
        turns = counts / COUNTS_PER_REV - self._settings.encoder_zero_rev
        return round(turns / self._settings.encoder_rev_per_pulley_rev * ANGLE_LSB_PER_REV)

    def _count_from_one_turn(self) -> None:
        own = self._own_counts
        self._turns_off = own % COUNTS_PER_REV - own
        self.table.put(POSITION, own + self._turns_off + self.table.get(20))


def _word(data: bytes) -> int:
    return int.from_bytes(data[:2], "little")
