"""A simulated CiA 402 drive with EPOS4's objects: CANopen on a simulated forceps, as a node of the virtual bus.

It has an object dictionary that SDO reads and writes, PDOs that are mapped through it, NMT states, the state machine of
CiA 402, SYNC, emergencies, and a host's heartbeat that it watches where 1016h says so. It interpolates between targets
over the time of 60C2h: where targets come at another pace, it moves in jerks, as a real one does. Its position loop is
that of the rig's `drive:`.
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

PRE_OPERATIONAL, OPERATIONAL, STOPPED = 0x7F, 0x05, 0x04
NOT_READY, SWITCH_ON_DISABLED, READY, SWITCHED_ON, ENABLED, FAULT = 0x00, 0x40, 0x21, 0x23, 0x27, 0x08
CSP: Final = 8
RATED_CURRENT_mA: Final = 500
REVISION: Final = 0x0170_0000
HEARTBEAT_LOST, CAN_OVERRUN = 0x8130, 0x8110
_NO_OBJECT, _READ_ONLY, _NO_MAPPING = 0x06020000, 0x06010002, 0x06040041
_TOO_LONG, _WRONG_LENGTH = 0x06040042, 0x06070010
_MAPPABLE: Final = {
    0x60400010, 0x607A0020, 0x60410010, 0x60610008, 0x60640020, 0x30D10220, 0x30D10120, 0x60770010, 0x60780010,
}  # fmt: skip
_MAPPINGS: Final = {0x1600, 0x1A00, 0x1A01}
_READABLE: Final = {0x1000, 0x1018, 0x6041, 0x603F, 0x6061, 0x6064, 0x30D1, 0x6075, 0x6077, 0x6078}
_SIZES: Final = {1: 0x2F, 2: 0x2B, 4: 0x23}
_ANSWERS: Final = {1: 0x4F, 2: 0x4B, 4: 0x43}


class SimulatedCia402:
    """One drive on a forceps; a `Node`. The load begins with the first SYNC that finds it enabled."""

    def __init__(
        self,
        rig: Rig,
        load: LoadProfile,
        seed: int = 0,
        truth_duration_s: float = 0.0,
        jaw_start_rad: float = PAPER_JAW_START_RAD,
    ) -> None:
        """UserError when the rig doesn't say enough."""
        settings, counts = rig.motor_driver, rig.encoder.counts_per_rev
        if settings is None or settings.profile != "cia402" or counts is None:
            raise UserError("motor_driver.profile: must be cia402 here, and encoder.counts_per_rev a number")
        self.node = settings.node_id
        self._forceps = forceps_of(rig, load, seed, jaw_start_rad)
        self._period_ns = round(rig.require_drive().sample_time_s * 1e9)
        self._counts_per_rev = counts * settings.encoder_rev_per_pulley_rev
        self._zero_counts = counts * settings.encoder_zero_rev
        self.truth = TruthLog(math.ceil(truth_duration_s / rig.bench.host_period_s))
        self.counters = {"not_understood": 0}
        self.zero_ns: int | None = None
        self.nmt = PRE_OPERATIONAL
        self.status = SWITCH_ON_DISABLED
        self.control = 0
        self._loops = 0
        self._theta_raw = self._forceps.read(0).theta_m
        self._current_raw = 0
        self._from, self._to, self._since_ns = 0.0, 0.0, 0  # of the interpolation, counts
        self._next_heartbeat_ns = 0
        self._host_ns: int | None = None
        self._outbox: list[Frame] = []
        self._sizes: dict[tuple[int, int], int] = {}
        self.objects: dict[tuple[int, int], int] = {}
        for index, subindex, size, value in (
            (0x1000, 0, 4, 0x00020192), (0x1017, 0, 2, 0), (0x1016, 1, 4, 0), (0x6007, 0, 2, 1),
            (0x6040, 0, 2, 0), (0x6041, 0, 2, 0), (0x6060, 0, 1, 1), (0x6061, 0, 1, 1), (0x6064, 0, 4, 0),
            (0x607A, 0, 4, 0), (0x60C2, 1, 1, 1), (0x60C2, 2, 1, 0xFD), (0x30D1, 1, 4, 0), (0x30D1, 2, 4, 0),
            (0x6075, 0, 4, RATED_CURRENT_mA), (0x6077, 0, 2, 0), (0x6078, 0, 2, 0), (0x603F, 0, 2, 0),
            (0x608F, 1, 4, counts), (0x608F, 2, 4, 1), (0x1018, 3, 4, REVISION),
            (0x3001, 2, 4, round(1e3 * rig.require_drive().current_limit_A)),
        ):  # fmt: skip
            self._define(index, subindex, size, value)
        for place in range(2):
            self._define_pdo(0x1800 + place, 0x1A00 + place, 0x180 + 0x100 * place)
        self._define_pdo(0x1400, 0x1600, 0x200)
        self._send(0x700 + self.node, b"\x00")  # boot-up

    def trip(self) -> None:
        """Fail as one whose controller has left the bus."""
        self._fail(CAN_OVERRUN)

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Take a frame from the bus."""
        self.wake(now_ns - 1)
        arbitration_id, data = frame.arbitration_id, frame.data
        if frame.is_extended:
            return
        if arbitration_id == 0x000 and len(data) == 2 and data[1] in (0, self.node):
            self._network(data[0], now_ns)
        elif arbitration_id == 0x080 and self.nmt == OPERATIONAL:
            self._sync(now_ns)
        elif arbitration_id == 0x600 + self.node and len(data) == 8:
            self._send(0x580 + self.node, self._sdo(data, now_ns))
        elif arbitration_id == self.objects[0x1400, 1] and self.nmt == OPERATIONAL:
            self._take_pdo(0x1600, data, now_ns)
        elif arbitration_id == 0x700 + (self.objects[0x1016, 1] >> 16 & 0x7F):
            self._host_ns = now_ns
        elif arbitration_id & 0x7F == self.node:
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
        timeout_ns = (self.objects[0x1016, 1] & 0xFFFF) * 1_000_000
        if timeout_ns and self._host_ns is not None and at_ns - self._host_ns > timeout_ns:
            self._host_ns = None
            self._fail(HEARTBEAT_LOST)
        period_ns = self.objects[0x1017, 0] * 1_000_000
        if period_ns and at_ns >= self._next_heartbeat_ns:
            self._next_heartbeat_ns = at_ns + period_ns
            self._send(0x700 + self.node, bytes((self.nmt,)))
        reference = self._target_raw(at_ns) if self.status == ENABLED else None
        self._theta_raw, self._current_raw, _, _ = self._forceps.sample(at_ns, at_ns + self._period_ns, reference)

    def _target_raw(self, at_ns: int) -> int:
        span_ns = self.objects[0x60C2, 1] * 10.0 ** (self.objects[0x60C2, 2] - 256) * 1e9
        share = min(1.0, (at_ns - self._since_ns) / span_ns)
        counts = self._from + share * (self._to - self._from)
        return round((counts - self._zero_counts) / self._counts_per_rev * ANGLE_LSB_PER_REV)

    def _counts(self) -> int:
        return round(self._zero_counts + self._theta_raw / ANGLE_LSB_PER_REV * self._counts_per_rev)

    def _sync(self, now_ns: int) -> None:
        if self.status == ENABLED and self.zero_ns is None:
            self.zero_ns = now_ns
            self._forceps.start_load(self.next_wake_ns())
        if self.truth.capacity:
            self.truth.append(now_ns, now_ns, self._forceps.truth(self.next_wake_ns()))
        self._refresh()
        for place in range(2):
            cob_id = self.objects[0x1800 + place, 1]
            if not cob_id >> 31 and self.objects[0x1800 + place, 2] == 1:
                self._send(cob_id, self._packed(0x1A00 + place))

    def _refresh(self) -> None:
        """Bring the objects up to date that say what is."""
        milliamperes = round(math.copysign(1.0, self._counts_per_rev) * self._current_raw * CURRENT_LSB_A * 1e3)
        self.objects[0x6064, 0] = self._counts()
        self.objects[0x6041, 0] = self.status
        self.objects[0x6061, 0] = self.objects[0x6060, 0]
        self.objects[0x30D1, 1] = self.objects[0x30D1, 2] = milliamperes
        self.objects[0x6077, 0] = self.objects[0x6078, 0] = round(1e3 * milliamperes / self.objects[0x6075, 0])

    def _packed(self, mapping: int) -> bytes:
        data = b""
        for place in range(1, self.objects[mapping, 0] + 1):
            entry = self.objects[mapping, place]
            size = (entry & 0xFF) // 8
            value = self.objects[entry >> 16, entry >> 8 & 0xFF]
            data += (value & ((1 << 8 * size) - 1)).to_bytes(size, "little")
        return data

    def _take_pdo(self, mapping: int, data: bytes, now_ns: int) -> None:
        entries = [self.objects[mapping, place] for place in range(1, self.objects[mapping, 0] + 1)]
        if sum(entry & 0xFF for entry in entries) != 8 * len(data):
            self.counters["not_understood"] += 1
            return
        at = 0
        for entry in entries:
            size = (entry & 0xFF) // 8
            self.objects[entry >> 16, entry >> 8 & 0xFF] = int.from_bytes(data[at : at + size], "little")
            at += size
        self._follow(now_ns)
        self._obey(self.objects[0x6040, 0])

    def _follow(self, now_ns: int) -> None:
        target = self.objects[0x607A, 0]
        self._from = self._to if self.status == ENABLED else float(self._counts())
        self._to = float(target - (1 << 32) if target >> 31 else target)
        self._since_ns = now_ns

    def _obey(self, control: int) -> None:
        rising = control & ~self.control
        self.control = control
        if self.status == FAULT:
            if rising & 0x80:
                self.status = SWITCH_ON_DISABLED
        elif not control & 0x02:
            self.status = SWITCH_ON_DISABLED
        elif not control & 0x04:
            self.status = SWITCH_ON_DISABLED  # quick stop, at once
        elif control & 0x0F == 0x06:
            self.status = READY
        elif control & 0x0F == 0x07 and self.status in {READY, ENABLED}:
            self.status = SWITCHED_ON
        elif control & 0x0F == 0x0F and self.status in {SWITCHED_ON, ENABLED} and self.objects[0x6060, 0] == CSP:
            self.status = ENABLED

    def _network(self, command: int, now_ns: int) -> None:
        if command in {0x81, 0x82}:
            self.reboot(now_ns)
        else:
            self.nmt = {0x01: OPERATIONAL, 0x02: STOPPED, 0x80: PRE_OPERATIONAL}.get(command, self.nmt)
        if self.nmt != OPERATIONAL and self.status == ENABLED:
            self.status = SWITCH_ON_DISABLED

    def reboot(self, now_ns: int) -> None:
        """Begin anew, as behind a loss of power: everything that isn't stored is forgotten."""
        self.nmt, self.status, self.control = PRE_OPERATIONAL, SWITCH_ON_DISABLED, 0
        self.objects[0x6060, 0] = 1
        self.objects[0x1016, 1] = self.objects[0x1017, 0] = 0
        self._host_ns = None
        self._since_ns = now_ns
        self._send(0x700 + self.node, b"\x00")

    def _sdo(self, data: bytes, now_ns: int) -> bytes:
        self._refresh()
        command, index, subindex = struct.unpack_from("<BHB", data)
        place = index, subindex
        if place not in self.objects:
            return self._abort(index, subindex, _NO_OBJECT)
        size = self._sizes[place]
        if command == 0x40:
            value = self.objects[place] & ((1 << 8 * size) - 1)
            return struct.pack("<BHB", _ANSWERS[size], index, subindex) + value.to_bytes(4, "little")
        value = int.from_bytes(data[4 : 4 + size], "little")
        abort = _WRONG_LENGTH if command != _SIZES[size] else self._objection(index, subindex, value)
        if abort:
            return self._abort(index, subindex, abort)
        self.objects[place] = value
        if index == 0x6040:
            self._obey(value)
        if index == 0x607A:
            self._follow(now_ns)
        return struct.pack("<BHB4x", 0x60, index, subindex)

    def _objection(self, index: int, subindex: int, value: int) -> int:
        """Return the abort code of a value that can't be written, 0 where it can."""
        if index in _READABLE:
            return _READ_ONLY
        if index not in _MAPPINGS:
            return 0
        if subindex:
            return 0 if value in _MAPPABLE else _NO_MAPPING
        bits = sum(self.objects[index, place] & 0xFF for place in range(1, min(value, 8) + 1))
        return 0 if value <= 8 and bits <= 64 else _TOO_LONG

    @staticmethod
    def _abort(index: int, subindex: int, code: int) -> bytes:
        return struct.pack("<BHBI", 0x80, index, subindex, code)

    def _fail(self, code: int) -> None:
        self.status = FAULT
        self.objects[0x603F, 0] = code
        self._send(0x080 + self.node, struct.pack("<HB5x", code, 0x11))

    def _define(self, index: int, subindex: int, size: int, value: int) -> None:
        self.objects[index, subindex], self._sizes[index, subindex] = value, size

    def _define_pdo(self, communication: int, mapping: int, cob_id: int) -> None:
        self._define(communication, 1, 4, cob_id + self.node)
        self._define(communication, 2, 1, 255)
        self._define(mapping, 0, 1, 0)
        for place in range(1, 9):
            self._define(mapping, place, 4, 0)

    def _send(self, arbitration_id: int, data: bytes) -> None:
        self._outbox.append(Frame(arbitration_id, data))
