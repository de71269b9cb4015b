"""A CANopen drive of the profile CiA 402 in cyclic synchronous position mode, as the host sees it.

    DISCONNECTED -> IDENTIFYING  NMT pre-operational; the device type is read; PDOs, periods and mode are written by
                                 SDO, one request at a time, none of which blocks; NMT start
    IDENTIFYING  -> READY        position, current and mode 8 come with SYNC
    IDENTIFYING  -> REFUSED      an answer doesn't come, is an abort, or says another device or mode
    READY        -> ENABLING     6040h goes 06, 07, 0F as the statusword follows; 607Ah is the measured angle
    ENABLING     -> RUNNING      the statusword says operation enabled
    RUNNING      -> READY        the statusword says otherwise, without a fault
    set up       -> REFUSED      it leaves mode 8 or the NMT state operational, by another master's word
    any          -> FAULT        the statusword says fault, once the set-up is written
    FAULT        -> IDENTIFYING  the statusword says otherwise: position, current and mode are looked at once more
    any          -> DISCONNECTED a boot-up message, or nothing for `SILENCE_NS`

A drive latches at SYNC, so a sample's stamp is when SYNC was sent (`sync_cycle`): it goes out behind each tick's
reference, and what comes back is the next tick's sample. Drives on one bus share it. The target is the measured
angle until operation is asked for, and from then on the angle at that request until the drive follows. The drive's
watchdog is the host's heartbeat. While the drive has torque, that goes out in ticks with a reference and only in them;
several drives watch a host's node each, or the references of one would feed the watchdogs of all.
"""

import math
from typing import Final

from firmware_protocol.frames import Frame
from firmware_protocol.host.samples import RawBench, RawSample
from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_PER_REV
from firmware_protocol.states import HostPhase
from hil_forceps.drives import sample_queue
from hil_forceps.drives.cia402 import messages as wire
from hil_forceps.drives.cia402 import sync_cycle
from hil_forceps.drives.cia402.messages import Control, Entry, Nmt, NmtState, State
from hil_forceps.drives.cia402.objects import HOST_NODE, MODE_CSP, RPDO1, TPDO1, TPDO2, Cia402Config, entries
from hil_forceps.drives.cia402.setup import SetUp
from hil_forceps.drives.port import NO_TORQUE, SEQUENCE_MASK
from hil_forceps.drives.transitions import COMMON, P

SILENCE_NS: Final = 350_000_000
CONFIRM_NS: Final = 500_000_000  # after NMT start, for position, current and mode
HEARTBEAT_PERIOD_NS: Final = 20_000_000
_INT32: Final = 1 << 31

COUNTERS: Final = (
    "setpoints_sent",
    "not_for_us",
    "bad_length",
    "unknown_status",
    "emergencies",
    *sync_cycle.COUNTERS,
    *sample_queue.COUNTERS,
)

# Besides what every drive has.
TRANSITIONS: Final = COMMON | {
    (P.READY, "refuse"): P.REFUSED,
    (P.ENABLING, "enabled"): P.RUNNING,
    (P.ENABLING, "refuse"): P.REFUSED,
    (P.RUNNING, "left"): P.READY,
    (P.RUNNING, "refuse"): P.REFUSED,
    (P.FAULT, "cleared"): P.IDENTIFYING,
}


class Cia402:
    """One CiA 402 drive; a `DriveMachine`."""

    def __init__(self, config: Cia402Config, shared: sync_cycle.SharedSync | None = None) -> None:
        """`shared`: of the bus, where there are several. ValueError for a node, a ratio or a period that can't be."""
        whole_ms = config.period_ns % 1_000_000 == 0 and 1 <= config.period_ns // 1_000_000 <= 255
        if not 1 <= config.node < HOST_NODE or config.counts_per_pulley_rev == 0.0 or not whole_ms:
            raise ValueError(f"no CiA 402 drive: {config}")
        self.config = config
        self.phase = HostPhase.DISCONNECTED
        self.refusal = ""
        self.drive_state: DriveState | None = None
        self.setpoint_sequence = 0
        self.counters = dict.fromkeys(COUNTERS, 0)
        self._state: State | None = None  # None: not heard, or not understood
        self._mode: int | None = None
        self._emergency: int | None = None
        self._set_up: SetUp | None = None
        self._started_ns: int | None = None
        self._heard_ns = 0
        self._heartbeat_ns: int | None = None
        self._heartbeat_period_ns = HEARTBEAT_PERIOD_NS
        if config.host_timeout_ns:
            self._heartbeat_period_ns = min(HEARTBEAT_PERIOD_NS, config.host_timeout_ns // 3)
        self._cycle = sync_cycle.SyncCycle(self.counters, shared or sync_cycle.SharedSync())
        self._counts: int | None = None  # newest
        self._current_seen = False
        self._held_raw: int | None = None  # the target with which operation was asked for
        self._wants_off = False
        self._is_operational = True  # by its heartbeats; NMT start was sent
        self._reset_step = 0
        self._references_before = 0  # sent when the last tick was over
        self._outbox: list[Frame] = []
        self._samples = sample_queue.SampleQueue(self.counters)

    def connect(self, now_ns: int) -> None:
        """Set the drive up, from the beginning; ValueError while connected."""
        if self.phase not in {HostPhase.DISCONNECTED, HostPhase.REFUSED}:
            raise ValueError(f"a drive that is {self.phase.name} is connected already")
        self._fire("connect")
        self.refusal = ""
        self._begin_set_up(now_ns)

    def _begin_set_up(self, now_ns: int) -> None:
        self._set_up = SetUp(self.config.node, entries(self.config))
        self._started_ns = None
        self._heard_ns = now_ns
        self._outbox = [wire.nmt(Nmt.PRE_OPERATIONAL, self.config.node)]

    def enable(self) -> None:
        """Ask for operation; ValueError unless READY."""
        if self.phase is not HostPhase.READY:
            raise ValueError(f"a drive that is {self.phase.name} can't be enabled")
        self._held_raw, self._wants_off, self._reset_step = None, False, 0
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
        return "no emergency message was received" if self._emergency is None else f"error code 0x{self._emergency:04x}"

    def take_samples(self) -> list[RawSample]:
        """Hand over the samples since the last call, oldest first."""
        return self._samples.take()

    def take_bench(self) -> list[RawBench]:
        """Return nothing: such a drive has no bench sensors."""
        return []

    def setpoint(self, theta_m_ref_raw: int) -> Frame | None:
        """Return controlword and target; from the request of operation until it is there, the angle at that request."""
        state = self._state
        if state is None or state not in wire.TOWARDS_ENABLED:
            return None
        control = wire.TOWARDS_ENABLED[state]
        if self.phase is HostPhase.ENABLING:
            if control is not Control.ENABLE_OPERATION:
                self._held_raw = None
            elif self._held_raw is None:
                self._held_raw = theta_m_ref_raw
            else:
                theta_m_ref_raw = self._held_raw
        elif self.phase is not HostPhase.RUNNING:
            return None
        config = self.config
        counts = config.zero_counts + theta_m_ref_raw / ANGLE_LSB_PER_REV * config.counts_per_pulley_rev
        self.setpoint_sequence = self.setpoint_sequence + 1 & SEQUENCE_MASK
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
            self._see_heartbeat(data, now_ns)
        elif function == wire.EMCY_ID:
            self._see_emergency(wire.parse_emergency(data))
        else:
            self.counters["not_for_us"] += 1

    def poll(self, now_ns: int) -> list[Frame]:
        """Return what is due: a request, a controlword that takes torque off, SYNC, the heartbeat."""
        frames = self._identify(now_ns) if self.phase is HostPhase.IDENTIFYING else []
        if self.phase is not HostPhase.IDENTIFYING and now_ns - self._heard_ns > SILENCE_NS:
            self._state = self.drive_state = None  # an old word
            self._fire("gone")
        frames += self._off()
        is_over = self.phase in {HostPhase.DISCONNECTED, HostPhase.REFUSED} and not self._wants_off
        if self._started_ns is None or is_over:
            self._cycle.rest()
            return frames
        has_sent = self.counters["setpoints_sent"] != self._references_before
        self._references_before = self.counters["setpoints_sent"]
        is_due = self._heartbeat_ns is None or now_ns - self._heartbeat_ns >= self._heartbeat_period_ns
        if is_due and (has_sent or not self._needs_references()):
            self._heartbeat_ns = now_ns
            frames.append(wire.heartbeat(self.config.host_node))
        if self._cycle.poll(now_ns):
            frames.append(wire.sync())
        return frames

    def _needs_references(self) -> bool:
        """Whether the drive may take this host for alive only in a tick that has sent a reference."""
        return self.phase in {HostPhase.ENABLING, HostPhase.RUNNING} or self.drive_state not in NO_TORQUE

    def _off(self) -> list[Frame]:
        if self._reset_step and self._state in {State.FAULT, State.FAULT_REACTION}:
            self._reset_step -= 1
            control = Control.DISABLE_VOLTAGE if self._reset_step else Control.FAULT_RESET
            return [self._command(control, self._counts or 0)]
        if not self._wants_off or self._started_ns is None or self.drive_state in NO_TORQUE:
            return []
        if not self._is_operational:  # it takes no PDOs
            return [wire.sdo_write(self.config.node, Entry(0x6040, 0, 2, Control.DISABLE_VOLTAGE))]
        return [self._command(Control.DISABLE_VOLTAGE, self._counts or 0)]

    def _identify(self, now_ns: int) -> list[Frame]:
        if self._outbox:
            frames, self._outbox = self._outbox, []
            return frames
        if self._started_ns is not None:
            self._confirm(now_ns)
            return []
        assert self._set_up is not None
        if self._set_up.is_done:
            self._started_ns = self._heard_ns = now_ns
            return [wire.nmt(Nmt.START, self.config.node)]
        frames = self._set_up.poll(now_ns)
        if self._set_up.refusal:
            self._refuse(self._set_up.refusal)
        return frames

    def _see_answer(self, answer: wire.SdoAnswer | None, now_ns: int) -> None:
        is_asked = self.phase is HostPhase.IDENTIFYING and self._set_up is not None
        if answer is None or not is_asked or self._set_up is None or not self._set_up.receive(answer):
            self.counters["bad_length" if answer is None else "not_for_us"] += 1
            return
        self._heard_ns = now_ns
        if self._set_up.refusal:
            self._refuse(self._set_up.refusal)

    def _see_heartbeat(self, data: bytes, now_ns: int) -> None:
        if len(data) != 1:
            self.counters["bad_length"] += 1
            return
        self._heard_ns = now_ns
        if data[0] == NmtState.BOOT_UP:
            if self.phase is HostPhase.IDENTIFYING:  # what was written to it is lost
                self._begin_set_up(now_ns)
            self._state = self.drive_state = None
            self._fire("gone")
            return
        self._is_operational = data[0] == NmtState.OPERATIONAL
        is_behind_start = self._started_ns is not None and now_ns - self._started_ns > CONFIRM_NS
        if is_behind_start and not self._is_operational:
            self._state = self.drive_state = None  # its PDOs have ended
            self._refuse(
                f"node {self.config.node} left the NMT state operational on another master's command (heartbeat "
                f"0x{data[0]:02x}); only one master may be on the bus"
            )

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
                    f"node {node} stays in mode {self._mode} (6061h), although mode {MODE_CSP}, cyclic synchronous "
                    "position, "
                    "was requested"
                )

    def _refuse(self, words: str) -> None:
        self._fire("refuse")
        if self.phase is HostPhase.REFUSED and not self.refusal:
            self.refusal = words

    def _see_position(self, data: bytes, now_ns: int) -> None:
        if len(data) != TPDO1.size:
            self.counters["bad_length"] += 1
            return
        counts, statusword, mode = TPDO1.unpack(data)
        self._heard_ns = now_ns
        self._counts, self._mode = counts, mode
        self._see_state(wire.state_of(statusword & 0xFFFF))
        if mode != MODE_CSP and self.phase in {HostPhase.READY, HostPhase.ENABLING, HostPhase.RUNNING}:
            self._refuse(
                f"node {self.config.node} changed from mode {MODE_CSP} to mode {mode} (6061h) on another master's "
                "command; only one "
                "master may write 6060h"
            )
        self._cycle.see_position(counts)
        if self._cycle.answers.is_too_high:
            self._refuse(
                f"node {self.config.node} answers SYNC more than once: two drives have this id, or "
                "another master sends SYNC; give each drive its own id (2000h), and use one master only"
            )

    def _see_state(self, state: State | None) -> None:
        self._state = state
        if state in {State.FAULT, State.FAULT_REACTION}:
            # While it reacts to a fault it still has torque, for braking.
            self.drive_state = DriveState.FAULT if state is State.FAULT else DriveState.ARMED
            if self._started_ns is not None:  # set up; before that the set-up goes on
                self._fire("fault")
            return
        self._reset_step = 0
        if state is State.OPERATION_ENABLED:
            self.drive_state = DriveState.OPERATIONAL
            if self._held_raw is not None:  # else by another's word
                self._fire("enabled")
            return
        self.counters["unknown_status"] += state is None
        self.drive_state = DriveState.DISABLED if state in wire.TORQUE_FREE else DriveState.ARMED
        if self.phase is HostPhase.FAULT:  # position, current and mode are looked at once more
            self._started_ns = self._heard_ns
        self._fire("cleared")
        self._fire("left")

    def _see_current(self, data: bytes, now_ns: int) -> None:
        config = self.config
        layout = TPDO2[config.current_bits]
        if len(data) != layout.size:
            self.counters["bad_length"] += 1
            return
        self._current_seen = True
        latched = self._cycle.see_current()
        if latched is None or self.phase is HostPhase.IDENTIFYING:
            return
        self._samples.append(
            stamp_ns=latched.stamp_ns,
            received_ns=now_ns,
            pulley_rev=(latched.counts - config.zero_counts) / config.counts_per_pulley_rev,
            current_A=layout.unpack(data)[0] * config.current_lsb_A * math.copysign(1.0, config.counts_per_pulley_rev),
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
        return Frame(wire.RPDO1_ID + self.config.node, RPDO1.pack(control, wrapped))

    def _fire(self, event: str) -> None:
        self.phase = TRANSITIONS.get((self.phase, event), self.phase)
