"""A CANopen drive of the profile CiA 402 in cyclic synchronous position mode, as the host sees it.

    DISCONNECTED -> IDENTIFYING  NMT pre-operational; the device type is read; PDOs, periods and mode are written by
                                 SDO, one request at a time, none of which blocks; NMT start
    IDENTIFYING  -> READY        position, current and mode 8 come with SYNC
    IDENTIFYING  -> REFUSED      an answer doesn't come, is an abort, or says another device or mode
    READY        -> ENABLING     6040h goes 06, 07, 0F as the statusword follows; 607Ah is the measured angle
    ENABLING     -> RUNNING      the statusword says operation enabled
    RUNNING      -> READY        the statusword says otherwise, without a fault
    any          -> FAULT        the statusword says fault, once the set-up is written
    FAULT        -> IDENTIFYING  the statusword says otherwise: position, current and mode are looked at once more
    any          -> DISCONNECTED a boot-up message, or nothing for `SILENCE_NS`

A drive latches at SYNC, so a sample's stamp is when SYNC was sent: it goes out behind each tick's reference, and what
comes back is the next tick's sample. The drive's watchdog is the host's heartbeat. While the drive has torque, that
goes out in ticks with a reference and only in them.
"""

import math
import struct
from typing import Final, NamedTuple

from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState
from firmware_protocol.samples import RawBench, RawSample
from firmware_protocol.scales import ANGLE_LSB_PER_REV
from firmware_protocol.states import HostPhase
from hil_forceps.drives import sample_queue
from hil_forceps.drives.cia402 import messages as wire
from hil_forceps.drives.cia402.messages import Control, Entry, Nmt, State

SILENCE_NS: Final = 350_000_000
SDO_TIMEOUT_NS: Final = 200_000_000
SDO_TRIES: Final = 3
CONFIRM_NS: Final = 500_000_000  # after NMT start, for position, current and mode
HEARTBEAT_PERIOD_NS: Final = 20_000_000
HOST_NODE: Final = 127
MODE_CSP: Final = 8
DEVICE_PROFILE: Final = 402
_SEQUENCE_MASK: Final = 0xFF
_SYNCHRONOUS, _AT_ONCE = 1, 255
_TPDO1: Final = struct.Struct("<ihb")  # 6064h, 6041h, 6061h
_TPDO2: Final = struct.Struct("<i")  # the current, mA
_RPDO1: Final = struct.Struct("<Hi")  # 6040h, 607Ah
_INT32: Final = 1 << 31

COUNTERS: Final = (
    "setpoints_sent",
    "syncs_sent",
    "not_for_us",
    "bad_length",
    "unpaired",
    "emergencies",
    *sample_queue.COUNTERS,
)

P = HostPhase
TRANSITIONS: Final[dict[tuple[HostPhase, str], HostPhase]] = {
    (P.DISCONNECTED, "connect"): P.IDENTIFYING,
    (P.REFUSED, "connect"): P.IDENTIFYING,
    (P.IDENTIFYING, "complete"): P.READY,
    (P.IDENTIFYING, "refuse"): P.REFUSED,
    (P.IDENTIFYING, "fault"): P.FAULT,
    (P.READY, "enable"): P.ENABLING,
    (P.READY, "fault"): P.FAULT,
    (P.READY, "gone"): P.DISCONNECTED,
    (P.ENABLING, "enabled"): P.RUNNING,
    (P.ENABLING, "disable"): P.READY,
    (P.ENABLING, "fault"): P.FAULT,
    (P.ENABLING, "gone"): P.DISCONNECTED,
    (P.RUNNING, "left"): P.READY,
    (P.RUNNING, "disable"): P.READY,
    (P.RUNNING, "fault"): P.FAULT,
    (P.RUNNING, "gone"): P.DISCONNECTED,
    (P.FAULT, "cleared"): P.IDENTIFYING,
    (P.FAULT, "gone"): P.DISCONNECTED,
}


class Cia402Config(NamedTuple):
    """One drive and how its encoder sits on the motor pulley."""

    node: int
    counts_per_pulley_rev: float  # with the sign of the direction
    zero_counts: float  # what 6064h is at the angle 0 of the motor pulley
    period_ns: int  # of the host's loop, of SYNC, and of the interpolation (60C2h)
    host_timeout_ns: int  # of the host's heartbeat; 0: not watched
    current_object: tuple[int, int] = (0x30D1, 2)  # EPOS4: current actual value, mA, 32 bit


class Cia402:
    """One CiA 402 drive; a `DriveMachine`."""

    def __init__(self, config: Cia402Config) -> None:
        """ValueError for a node, a ratio or a period that can't be."""
        whole_ms = config.period_ns % 1_000_000 == 0 and 1 <= config.period_ns // 1_000_000 <= 255
        if not 1 <= config.node < HOST_NODE or config.counts_per_pulley_rev == 0.0 or not whole_ms:
            raise ValueError(f"no CiA 402 drive: {config}")
        self.config = config
        self.phase = HostPhase.DISCONNECTED
        self.refusal = ""
        self.drive_state: DriveState | None = None
        self.setpoint_sequence = 0
        self.counters = dict.fromkeys(COUNTERS, 0)
        self._state: State | None = None
        self._mode: int | None = None
        self._emergency: int | None = None
        self._setup: list[Entry] = []
        self._sdo_sent_ns: int | None = None
        self._sdo_tries = 0
        self._identified = False
        self._started_ns: int | None = None
        self._heard_ns = 0
        self._sync_ns: int | None = None
        self._heartbeat_ns: int | None = None
        self._heartbeat_period_ns = HEARTBEAT_PERIOD_NS
        if config.host_timeout_ns:
            self._heartbeat_period_ns = min(HEARTBEAT_PERIOD_NS, config.host_timeout_ns // 3)
        self._position: tuple[int, int] | None = None  # counts, and when SYNC asked for them
        self._counts: int | None = None  # newest
        self._current_seen = False
        self._held_raw: int | None = None
        self._wants_off = False
        self._reset_step = 0
        self._references_before = 0  # sent when the last tick was over
        self._outbox: list[Frame] = []
        self._samples = sample_queue.SampleQueue(self.counters)

    def connect(self, now_ns: int) -> None:
        """Set the drive up, from the beginning."""
        self._fire("connect")
        if self.phase is HostPhase.IDENTIFYING:
            self.refusal = ""
            self._set_up(now_ns)

    def _set_up(self, now_ns: int) -> None:
        self._setup = self._entries()
        self._sdo_sent_ns, self._sdo_tries, self._identified = None, 0, False
        self._started_ns = None
        self._heard_ns = now_ns
        self._outbox = [wire.nmt(Nmt.PRE_OPERATIONAL, self.config.node)]

    def enable(self) -> None:
        """Ask for operation; ValueError unless READY."""
        if self.phase is not HostPhase.READY:
            raise ValueError(f"a drive that is {self.phase.name} can't be enabled")
        self._held_raw, self._wants_off = None, False
        self._fire("enable")

    def disable(self) -> None:
        """Ask for no torque, until the statusword says so."""
        self._wants_off = True
        self._fire("disable")

    def reset_fault(self) -> None:
        """Reset the fault by one rising edge; ValueError unless in FAULT."""
        if self.phase is not HostPhase.FAULT:
            raise ValueError("there is no fault to reset")
        self._reset_step = 2

    def estop_frame(self) -> Frame:
        """Return a controlword that takes the voltage off."""
        return self._command(Control.DISABLE_VOLTAGE, self._counts or 0)

    def fault_words(self) -> str:
        """Return the last emergency's error code."""
        return "no emergency was heard" if self._emergency is None else f"error code 0x{self._emergency:04x}"

    def take_samples(self) -> list[RawSample]:
        """Hand over the samples since the last call, oldest first."""
        return self._samples.take()

    def take_bench(self) -> list[RawBench]:
        """Return nothing: such a drive has no bench sensors."""
        return []

    def setpoint(self, theta_m_ref_raw: int) -> Frame | None:
        """Return controlword and target; while enabling, the angle at which that began, as the drive follows."""
        state = self._state
        if state is None or state not in wire.TOWARDS_ENABLED:
            return None
        control = wire.TOWARDS_ENABLED[state]
        if self.phase is HostPhase.ENABLING:
            if self._held_raw is None:
                self._held_raw = theta_m_ref_raw
            theta_m_ref_raw = self._held_raw
        elif self.phase is not HostPhase.RUNNING:
            return None
        config = self.config
        counts = config.zero_counts + theta_m_ref_raw / ANGLE_LSB_PER_REV * config.counts_per_pulley_rev
        self.setpoint_sequence = self.setpoint_sequence + 1 & _SEQUENCE_MASK
        self.counters["setpoints_sent"] += 1
        return self._command(control, round(counts))

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Take one frame from the bus."""
        node, data = self.config.node, frame.data
        function = frame.arbitration_id - node
        if frame.is_extended:  # the predefined connection set has ids of 11 bits only
            self.counters["not_for_us"] += 1
        elif function == wire.TPDO_IDS[0]:
            self._see_position(data, now_ns)
        elif function == wire.TPDO_IDS[1]:
            self._see_current(data, now_ns)
        elif function == wire.SDO_ANSWER_ID:
            self._see_answer(wire.parse_sdo(data), now_ns)
        elif function == wire.HEARTBEAT_ID:
            self._heard_ns = now_ns
            if data == bytes((wire.NmtState.BOOT_UP,)):
                if self.phase is HostPhase.IDENTIFYING:  # what was written to it is lost
                    self._set_up(now_ns)
                self._fire("gone")
        elif function == wire.EMCY_ID:
            self._see_emergency(wire.parse_emergency(data))
        else:
            self.counters["not_for_us"] += 1

    def poll(self, now_ns: int) -> list[Frame]:
        """Return what is due: a request, a controlword that takes torque off, SYNC, the heartbeat."""
        if self.phase in {HostPhase.DISCONNECTED, HostPhase.REFUSED}:
            return self._off()
        frames: list[Frame] = []
        if self.phase is HostPhase.IDENTIFYING:
            frames += self._identify(now_ns)
        elif now_ns - self._heard_ns > SILENCE_NS:
            self._fire("gone")
            return self._off()
        frames += self._off()
        if self._started_ns is not None:
            has_sent = self.counters["setpoints_sent"] != self._references_before
            self._references_before = self.counters["setpoints_sent"]
            is_due = self._heartbeat_ns is None or now_ns - self._heartbeat_ns >= self._heartbeat_period_ns
            if is_due and (has_sent or not self._needs_references()):
                self._heartbeat_ns = now_ns
                frames.append(wire.heartbeat(HOST_NODE))
            self._sync_ns = now_ns
            self.counters["syncs_sent"] += 1
            frames.append(wire.sync())
        return frames

    def _needs_references(self) -> bool:
        """Whether the drive may take this host for alive only in a tick that has sent a reference."""
        is_enabling = self.phase in {HostPhase.ENABLING, HostPhase.RUNNING}
        has_torque = self._state is not None and self._state not in wire.TORQUE_FREE
        return is_enabling or has_torque

    def _off(self) -> list[Frame]:
        if self._reset_step and self._state in {State.FAULT, State.FAULT_REACTION}:
            self._reset_step -= 1
            control = Control.DISABLE_VOLTAGE if self._reset_step else Control.FAULT_RESET
            return [self._command(control, self._counts or 0)]
        if self._wants_off and self._state is not None and self._state not in wire.TORQUE_FREE:
            return [self._command(Control.DISABLE_VOLTAGE, self._counts or 0)]
        return []

    def _entries(self) -> list[Entry]:
        config, node = self.config, self.config.node
        index, subindex = config.current_object
        consumer = (HOST_NODE << 16 | config.host_timeout_ns // 1_000_000) if config.host_timeout_ns else 0
        position = (wire.mapped(0x6064, 0, 32), wire.mapped(0x6041, 0, 16), wire.mapped(0x6061, 0, 8))
        return [
            Entry(0x1017, 0, 2, 100),
            Entry(0x1016, 1, 4, consumer),
            *wire.pdo_mapping(0x1800, 0x1A00, wire.TPDO_IDS[0] + node, _SYNCHRONOUS, position),
            *wire.pdo_mapping(
                0x1801, 0x1A01, wire.TPDO_IDS[1] + node, _SYNCHRONOUS, (wire.mapped(index, subindex, 32),)
            ),
            *wire.pdo_mapping(
                0x1400,
                0x1600,
                wire.RPDO1_ID + node,
                _AT_ONCE,
                (wire.mapped(0x6040, 0, 16), wire.mapped(0x607A, 0, 32)),
            ),
            Entry(0x60C2, 1, 1, config.period_ns // 1_000_000),
            Entry(0x60C2, 2, 1, -3),
            Entry(0x6060, 0, 1, MODE_CSP),
        ]

    def _identify(self, now_ns: int) -> list[Frame]:
        if self._outbox:
            frames, self._outbox = self._outbox, []
            return frames
        if self._started_ns is not None:
            self._confirm(now_ns)
        elif self._sdo_sent_ns is None or now_ns - self._sdo_sent_ns >= SDO_TIMEOUT_NS:
            return self._next_request(now_ns)
        return []

    def _next_request(self, now_ns: int) -> list[Frame]:
        node = self.config.node
        if self._identified and not self._setup:
            self._started_ns = self._heard_ns = now_ns
            return [wire.nmt(Nmt.START, node)]
        self._sdo_sent_ns = now_ns
        if not self._identified:  # as long as nobody is there; the service's own time-out ends that
            return [wire.sdo_read(node, 0x1000, 0)]
        self._sdo_tries += 1
        if self._sdo_tries > SDO_TRIES:
            where = f"{self._setup[0].object_index:04X}h:{self._setup[0].subindex:02X}"
            self._refuse(f"node {node} does not answer requests for {where}")
            return []
        return [wire.sdo_write(node, self._setup[0])]

    def _see_answer(self, answer: wire.SdoAnswer | None, now_ns: int) -> None:
        if answer is None or self.phase is not HostPhase.IDENTIFYING or self._sdo_sent_ns is None:
            self.counters["bad_length" if answer is None else "not_for_us"] += 1
            return
        self._heard_ns = now_ns
        wanted = (self._setup[0].object_index, self._setup[0].subindex) if self._identified else (0x1000, 0)
        if (answer.object_index, answer.subindex) != wanted:
            self.counters["not_for_us"] += 1
            return
        if answer.abort is not None:
            where = f"{answer.object_index:04X}h:{answer.subindex:02X}"
            self._refuse(f"node {self.config.node} refuses {where} ({wire.abort_words(answer.abort)})")
        elif not self._identified:
            if (answer.value or 0) & 0xFFFF != DEVICE_PROFILE:
                profile = (answer.value or 0) & 0xFFFF
                self._refuse(f"node {self.config.node} is no CiA 402 drive: its device type is of profile {profile}")
            self._identified = True
        else:
            self._setup.pop(0)
        self._sdo_sent_ns, self._sdo_tries = None, 0

    def _confirm(self, now_ns: int) -> None:
        assert self._started_ns is not None
        if self._counts is not None and self._current_seen and self._mode == MODE_CSP:
            self._fire("complete")
        elif now_ns - self._started_ns > CONFIRM_NS:
            node = self.config.node
            if self._counts is None or not self._current_seen:
                missing = "position" if self._counts is None else "current"
                self._refuse(f"node {node} sends no {missing} with SYNC, although it took the PDO mapping")
            else:
                self._refuse(
                    f"node {node} stays in mode {self._mode} (6061h), where {MODE_CSP}, cyclic synchronous position, "
                    "was asked for"
                )

    def _refuse(self, words: str) -> None:
        self.refusal = words
        self._fire("refuse")

    def _see_position(self, data: bytes, now_ns: int) -> None:
        if len(data) != _TPDO1.size:
            self.counters["bad_length"] += 1
            return
        counts, statusword, mode = _TPDO1.unpack(data)
        self._heard_ns = now_ns
        self._counts, self._mode = counts, mode
        self._see_state(wire.state_of(statusword & 0xFFFF))
        if self._position is not None:
            self.counters["unpaired"] += 1
        self._position = None if self._sync_ns is None else (counts, self._sync_ns)

    def _see_state(self, state: State) -> None:
        self._state = state
        if state in {State.FAULT, State.FAULT_REACTION}:
            # While it reacts to a fault it still has torque, for braking.
            self.drive_state = DriveState.FAULT if state is State.FAULT else DriveState.ARMED
            if self._started_ns is not None:  # set up; before that the set-up goes on
                self._fire("fault")
        elif state is State.OPERATION_ENABLED:
            self.drive_state = DriveState.OPERATIONAL
            self._fire("enabled")
        else:
            self.drive_state = DriveState.DISABLED if state in wire.TORQUE_FREE else DriveState.ARMED
            if self.phase is HostPhase.FAULT:  # position, current and mode are looked at once more
                self._started_ns = self._heard_ns
            self._fire("cleared")
            self._fire("left")

    def _see_current(self, data: bytes, now_ns: int) -> None:
        if len(data) != _TPDO2.size:
            self.counters["bad_length"] += 1
            return
        self._current_seen = True
        if self._position is None:
            self.counters["unpaired"] += 1
            return
        (counts, stamp_ns), self._position = self._position, None
        if self.phase is HostPhase.IDENTIFYING:
            return
        config = self.config
        self._samples.append(
            stamp_ns=stamp_ns,
            received_ns=now_ns,
            pulley_rev=(counts - config.zero_counts) / config.counts_per_pulley_rev,
            current_A=_TPDO2.unpack(data)[0] * 1e-3 * math.copysign(1.0, config.counts_per_pulley_rev),
            state=self.drive_state,
            setpoint_sequence=self.setpoint_sequence,
        )

    def _see_emergency(self, code: int | None) -> None:
        if code is None:
            self.counters["bad_length"] += 1
        elif code:
            self._emergency = code
            self.counters["emergencies"] += 1

    def _command(self, control: Control, counts: int) -> Frame:
        wrapped = (counts + _INT32) % (2 * _INT32) - _INT32
        return Frame(wire.RPDO1_ID + self.config.node, _RPDO1.pack(control, wrapped))

    def _fire(self, event: str) -> None:
        self.phase = TRANSITIONS.get((self.phase, event), self.phase)
