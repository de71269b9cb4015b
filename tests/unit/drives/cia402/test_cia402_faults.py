"""The CiA 402 profile's faults, lost drives, and torque that is taken off; nothing from outside raises."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState
from firmware_protocol.states import HostPhase
from hil_forceps.drives.cia402 import messages as wire
from hil_forceps.drives.cia402.machine import SILENCE_NS, TRANSITIONS, Cia402
from hil_forceps.drives.cia402.messages import State
from tests.unit.drives.cia402.bench import CONFIG, MS, NODE, boot_up, controls, current, position, ready, running, tick


def test_a_fault_is_told_by_its_emergency_and_reset_by_one_edge() -> None:
    drive, n = running()
    drive.receive(Frame(0x085, struct.pack("<HB5x", 0x8130, 0x11)), n * MS)
    assert controls(tick(drive, n, State.FAULT)) == []
    assert drive.phase is HostPhase.FAULT
    assert drive.fault_words() == "error code 0x8130"
    drive.reset_fault()
    assert [controls(tick(drive, n + k, State.FAULT)) for k in range(1, 5)] == [[0x00], [0x80], [], []]
    tick(drive, n + 5, State.SWITCH_ON_DISABLED)
    assert drive.phase.name == "READY"


def test_disabling_takes_the_voltage_off_until_it_is_seen() -> None:
    drive, n = running()
    drive.disable()
    assert controls(tick(drive, n, State.OPERATION_ENABLED)) == [0x00]
    assert controls(tick(drive, n + 1, State.OPERATION_ENABLED)) == [0x00]
    assert controls(tick(drive, n + 2, State.SWITCH_ON_DISABLED)) == []
    assert drive.drive_state is DriveState.DISABLED


def test_a_boot_up_or_silence_is_a_lost_drive() -> None:
    drive, n = running()
    drive.receive(Frame(0x700 + NODE, b"\x00"), n * MS)
    assert drive.phase is HostPhase.DISCONNECTED
    assert drive.poll((n + 1) * MS) == []
    drive, n = running()
    drive.poll(n * MS + SILENCE_NS + 1)
    assert drive.phase is HostPhase.DISCONNECTED


@pytest.mark.parametrize(
    "change", [{"node": 0}, {"node": 127}, {"counts_per_pulley_rev": 0.0}, {"period_ns": 1_500_000}, {"period_ns": 0}]
)
def test_what_is_no_drive(change: dict[str, int]) -> None:
    with pytest.raises(ValueError, match="no CiA 402 drive"):
        Cia402(CONFIG._replace(**change))  # type: ignore[arg-type]


@pytest.mark.parametrize("call", ["enable", "reset_fault"])
def test_calls_at_the_wrong_time_raise(call: str) -> None:
    with pytest.raises(ValueError, match=r"can't be enabled|no fault"):
        getattr(Cia402(CONFIG), call)()


def test_every_phase_but_the_first_can_be_left() -> None:
    for phase in set(HostPhase) - {HostPhase.DISCONNECTED}:
        assert any(source is phase for source, _ in TRANSITIONS)


@given(st.lists(st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8), st.integers(0, 5 * MS)), max_size=40))
def test_whatever_comes_nothing_raises_and_no_torque_is_asked_for(frames: list[tuple[int, bytes, int]]) -> None:
    drive, n = ready()
    now_ns = n * MS
    for arbitration_id, data, step_ns in frames:
        now_ns += step_ns
        drive.receive(Frame(arbitration_id, data), now_ns)
        assert drive.setpoint(0) is None
        assert all(control in {0x00, 0x80} for control in controls(drive.poll(now_ns)))


def test_torque_is_taken_off_a_drive_that_was_silent() -> None:
    drive, n = running()
    drive.poll(n * MS + SILENCE_NS + MS)
    assert drive.phase is HostPhase.DISCONNECTED
    drive.disable()
    n += SILENCE_NS // MS + 2
    drive.receive(position(1, State.OPERATION_ENABLED), n * MS)
    assert controls(drive.poll(n * MS)) == [0x00]


def test_a_statusword_of_no_state_is_no_end_of_torque() -> None:
    drive, n = running()
    drive.receive(Frame(0x180 + NODE, struct.pack("<ihb", 1, 0x0003, 8)), n * MS)
    assert drive.drive_state is DriveState.ARMED
    assert drive.phase is HostPhase.READY
    assert drive.counters["unknown_status"] == 1
    drive.disable()
    assert controls(drive.poll(n * MS)) == [0x00]


def test_a_drive_that_leaves_its_mode_while_running_is_refused_and_its_torque_taken_off() -> None:
    drive, n = running()
    drive.receive(position(1, State.OPERATION_ENABLED, mode=1), n * MS)
    assert drive.phase is HostPhase.REFUSED
    assert "from mode 8 to mode 1" in drive.refusal
    assert drive.setpoint(0) is None
    drive.disable()
    drive.receive(current(0), n * MS)
    frames = drive.poll(n * MS)
    assert controls(frames) == [0x00]
    assert frames[-1] == wire.sync()  # or nothing would say that the torque is off
    drive.receive(position(1, State.SWITCH_ON_DISABLED, mode=1), (n + 1) * MS)
    assert drive.drive_state is DriveState.DISABLED


def test_a_drive_that_another_master_stops_is_refused() -> None:
    drive, n = running()
    drive.receive(Frame(0x700 + NODE, b"\x7f"), n * MS)  # perhaps made before NMT start
    assert drive.phase is HostPhase.RUNNING
    later = n + 501
    for k in range(n, later):
        tick(drive, k, State.OPERATION_ENABLED)
    drive.receive(Frame(0x700 + NODE, b"\x7f"), later * MS)
    assert drive.phase.name == "REFUSED"
    assert "left the NMT state operational" in drive.refusal
    assert drive.drive_state is None
    drive.disable()
    assert Frame(0x605, bytes.fromhex("2b40600000000000")) in drive.poll(later * MS)


def test_a_reset_that_was_not_needed_does_not_clear_the_next_fault() -> None:
    drive, n = running()
    drive.receive(position(1, State.FAULT), n * MS)
    drive.reset_fault()
    drive.receive(position(1, State.SWITCH_ON_DISABLED), n * MS)
    assert [controls(tick(drive, n + k, State.FAULT)) for k in range(1, 4)] == [[], [], []]


def test_connecting_twice_raises() -> None:
    drive, n = running()
    with pytest.raises(ValueError, match="connected already"):
        drive.connect(n * MS)


def test_frames_with_29_bits_are_somebody_elses() -> None:
    drive, n = running()
    drive.take_samples()
    before = dict(drive.counters)
    foreign = (position(5, State.FAULT), current(7), boot_up(), Frame(0x80 + NODE, bytes.fromhex("3081110000000000")))
    for frame in foreign:
        drive.receive(frame._replace(is_extended=True), n * MS)
    assert drive.phase is HostPhase.RUNNING
    assert drive.take_samples() == []
    assert drive.counters == {**before, "not_for_us": before["not_for_us"] + len(foreign)}
