"""The ODrive profile: identified, enabled, references that feed the watchdog, samples."""

import math
import struct

import pytest

from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_RAD, CURRENT_LSB_A
from firmware_protocol.states import HostPhase
from hil_forceps.drives.odrive.machine import FIRST_REFERENCES, ODrive
from tests.unit.drives.odrive.bench import (
    CLOSED_LOOP,
    CONFIG,
    IDLE,
    MS,
    NODE,
    commands,
    estimates,
    heartbeat,
    iq,
    ready,
    running,
    ticks,
)


def test_nothing_is_sent_before_the_drive_is_known() -> None:
    drive = ODrive(CONFIG)
    drive.connect(0)
    assert ticks(drive, 0, 50) == []
    drive.receive(heartbeat(IDLE), 50 * MS)
    assert ticks(drive, 51, 50) == []
    assert drive.phase is HostPhase.IDENTIFYING


def test_an_odrive_that_sends_no_current_is_refused_with_the_remedy() -> None:
    drive = ODrive(CONFIG)
    drive.connect(0)
    for n in range(1200):
        drive.receive(estimates(0.1), n * MS)
        if n % 100 == 0:
            drive.receive(heartbeat(IDLE), n * MS)
        drive.poll(n * MS)
    assert drive.phase is HostPhase.REFUSED
    assert "no Iq" in drive.refusal
    assert "iq_msg_rate_ms" in drive.refusal
    assert drive.counters["samples"] == 0


def position_of(frame: Frame) -> float:
    return float(struct.unpack_from("<f", frame.data)[0]) * 2**24


def test_the_measured_angle_goes_out_before_closed_loop_is_asked_for() -> None:
    drive = ready()
    drive.enable()
    sent = ticks(drive, 2, FIRST_REFERENCES + 1)
    # Mode and limits with each of the first references: one frame may be lost.
    assert commands(sent) == [0x0B, 0x0F, *[0x0C, 0x0B, 0x0F] * (FIRST_REFERENCES - 1), 0x0C, 0x07]
    references = [frame for frame in sent if frame.arbitration_id & 0x1F == 0x0C]
    assert [round(position_of(frame)) for frame in references] == [1001, 1002, 1003]
    # Then the angle at the request, so that a load can't push the jaw away while the heartbeat is waited for.
    held = ticks(drive, 10, 50)
    assert commands(held) == [0x0C] * 50
    assert {frame.data for frame in held} == {references[-1].data}


def test_closed_loop_is_asked_for_again_where_a_heartbeat_says_no_and_from_where_the_motor_is_then() -> None:
    drive = ready()
    drive.enable()
    assert commands(ticks(drive, 2, 4))[-1] == 0x07
    drive.receive(heartbeat(IDLE), 6 * MS)  # made before the request
    assert commands(ticks(drive, 7, 90)) == [0x0C] * 90
    drive.receive(heartbeat(IDLE), 106 * MS)
    sent = ticks(drive, 107, 2, raw=5000)
    assert commands(sent) == [0x0C, 0x07, 0x0C]
    assert [round(position_of(sent[place])) for place in (0, 2)] == [5000, 5000]
    drive.receive(heartbeat(CLOSED_LOOP), 206 * MS)
    assert drive.phase is HostPhase.RUNNING
    assert commands(ticks(drive, 207, 160)) == [0x0C] * 160


def test_closed_loop_is_not_asked_for_without_a_fresh_reference() -> None:
    drive = ready()
    drive.enable()
    assert commands(ticks(drive, 2, FIRST_REFERENCES)) == [0x0B, 0x0F, *[0x0C, 0x0B, 0x0F] * (FIRST_REFERENCES - 1)]
    for n in range(10, 300):  # the gate passes nothing any more
        assert drive.poll(n * MS) == []
        if n % 100 == 0:
            drive.receive(heartbeat(IDLE), n * MS)
    assert commands(ticks(drive, 300, 1)) == [0x0C, 0x07]


def test_an_axis_with_torque_by_anothers_word_is_asked_for_idle_before_its_settings_change() -> None:
    drive = ready()
    drive.receive(heartbeat(CLOSED_LOOP), 2 * MS)
    drive.enable()
    assert commands(ticks(drive, 3, 101)) == [0x07] * 3
    drive.receive(heartbeat(IDLE), 104 * MS)
    assert commands(ticks(drive, 105, 2)) == [0x0B, 0x0F, 0x0C, 0x0B, 0x0F]


def test_nothing_but_references_feeds_the_watchdog_of_a_running_drive() -> None:
    drive = running()
    for n in range(10, 300):
        drive.receive(estimates(0.1), n * MS)
        drive.receive(iq(0.1), n * MS)
        if n % 100 == 0:
            drive.receive(heartbeat(CLOSED_LOOP), n * MS)
        assert drive.poll(n * MS) == []


def test_a_sample_has_the_current_of_its_own_tick() -> None:
    drive = running()
    drive.receive(estimates(0.25), 10 * MS)
    assert drive.take_samples() == []
    drive.receive(iq(0.5), 10 * MS + 100_000)
    (sample,) = drive.take_samples()
    assert sample.theta_m * ANGLE_LSB_RAD == pytest.approx(0.5 * math.pi)
    assert sample.current * CURRENT_LSB_A == pytest.approx(0.5)
    assert sample.stamp_ns == sample.received_ns == 10 * MS
    assert sample.state == DriveState.OPERATIONAL


def test_a_lost_current_is_bridged_once_and_then_missed() -> None:
    drive = running()
    drive.receive(iq(0.5), 9 * MS)
    for n in range(10, 20):
        drive.receive(estimates(0.25 + n * 1e-6), n * MS)
    samples = drive.take_samples()
    assert [sample.stamp_ns // MS for sample in samples] == [10, 11]
    assert drive.counters["without_current"] == 7


@pytest.mark.parametrize("ratio", [1.0, -1.0, 7.5, -0.5])
def test_gear_sign_and_zero_are_those_of_the_rig(ratio: float) -> None:
    drive = ready(CONFIG._replace(rev_per_pulley_rev=ratio, zero_rev=0.3))
    drive.enable()
    frame = next(frame for frame in ticks(drive, 2, 2, raw=1 << 22) if frame.arbitration_id & 0x1F == 0x0C)
    position = struct.unpack_from("<f", frame.data)[0]
    assert position == pytest.approx(0.3 + 0.25 * ratio, abs=1e-6)
    drive.receive(estimates(position), 20 * MS)
    drive.receive(iq(0.2), 20 * MS)
    sample = drive.take_samples()[-1]
    assert sample.theta_m == pytest.approx(1 << 22, abs=20)
    assert sample.current * CURRENT_LSB_A == pytest.approx(math.copysign(0.2, ratio), abs=1e-4)


def test_zero_for_an_invalid_estimate_is_no_angle() -> None:
    drive = running()
    drive.receive(estimates(0.0, 0.0), 10 * MS)
    drive.receive(iq(0.1), 10 * MS)
    assert drive.take_samples() == []
    assert drive.counters["no_estimate"] == 1


def test_an_angle_that_no_recording_holds_is_counted() -> None:
    drive = running()
    drive.receive(estimates(3e38), 10 * MS)
    drive.receive(iq(0.1), 10 * MS)
    assert drive.take_samples() == []
    assert drive.counters["out_of_range"] == 1


def test_a_current_from_much_later_belongs_to_no_sample() -> None:
    drive = running()
    drive.receive(estimates(0.25), 10 * MS)
    drive.receive(iq(0.5), 410 * MS)
    assert drive.take_samples() == []


def test_an_error_in_closed_loop_is_no_end_of_torque() -> None:
    drive = running()
    drive.receive(heartbeat(CLOSED_LOOP, error=0x100), 20 * MS)
    assert drive.phase is HostPhase.FAULT
    assert drive.drive_state is DriveState.ARMED
    drive.disable()
    assert commands(drive.poll(21 * MS)) == [0x07]


def test_closed_loop_by_somebody_elses_word_is_no_start() -> None:
    drive = ready()
    drive.enable()
    ticks(drive, 2, 1)
    drive.receive(heartbeat(CLOSED_LOOP), 3 * MS)
    assert drive.phase is HostPhase.ENABLING
    (frame,) = ticks(drive, 4, 1)
    assert frame == Frame(NODE << 5 | 0x07, struct.pack("<I4x", IDLE))
