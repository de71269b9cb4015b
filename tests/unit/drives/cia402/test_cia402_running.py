"""The CiA 402 profile while it runs: the state machine, what feeds its watchdog, samples and their stamps."""

import math
import struct

import pytest

from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_RAD, CURRENT_LSB_A
from firmware_protocol.states import HostPhase
from hil_forceps.drives.cia402 import messages as wire
from hil_forceps.drives.cia402.machine import Cia402
from hil_forceps.drives.cia402.messages import State
from hil_forceps.drives.cia402.objects import HOST_NODE
from hil_forceps.drives.cia402.sync_cycle import ANSWER_NS
from tests.unit.drives.cia402.bench import CONFIG, MS, controls, current, position, ready, running, set_up, tick


def test_the_controlword_follows_the_statusword_and_the_target_is_the_measured_angle() -> None:
    drive, n = ready()
    drive.enable()
    said: list[int] = []
    targets = set()
    for k, state in enumerate(
        (State.SWITCH_ON_DISABLED, State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON)
    ):
        frames = tick(drive, n + k, state, raw=(1 << 22) + k)
        said += controls(frames)
        targets |= {struct.unpack_from("<Hi", frame.data)[1] for frame in frames if frame.arbitration_id == 0x205}
    assert said == [0x06, 0x06, 0x07, 0x0F]
    assert targets == {4096}


def test_the_target_is_where_the_motor_is_when_operation_is_asked_for() -> None:
    drive, n = ready()
    drive.enable()
    states = [State.SWITCH_ON_DISABLED] * 3 + [State.READY_TO_SWITCH_ON] + [State.SWITCHED_ON] * 3
    states += [State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.SWITCHED_ON]  # it fell back once
    targets = []
    for k, state in enumerate(states):  # the motor is turned meanwhile, by hand
        frames = tick(drive, n + k, state, raw=(k + 1) << 20)
        targets += [struct.unpack_from("<Hi", frame.data)[1] for frame in frames if frame.arbitration_id == 0x205]
    assert targets == [1024, 2048, 3072, 4096, 5120, 5120, 5120, 8192, 9216, 9216]


def test_sync_goes_out_behind_the_reference() -> None:
    drive, n = running()
    frames = tick(drive, n, State.OPERATION_ENABLED)
    assert frames[0].arbitration_id == 0x205
    assert frames[-1] == wire.sync()


def test_the_hosts_heartbeat_goes_out_with_references_and_only_with_them() -> None:
    drive, n = running()
    beats = sum(wire.heartbeat(HOST_NODE) in tick(drive, n + k, State.OPERATION_ENABLED) for k in range(100))
    assert 4 <= beats <= 6
    for k in range(100, 300):  # an estimator that stalls: samples come, no reference goes
        drive.receive(position(1, State.OPERATION_ENABLED), (n + k) * MS)
        drive.receive(current(100), (n + k) * MS)
        assert drive.poll((n + k) * MS) == [wire.sync()]


def test_a_sample_is_stamped_with_the_sync_that_asked_for_it() -> None:
    drive, n = running()
    drive.take_samples()
    drive.receive(position(4096, State.OPERATION_ENABLED), n * MS - 700_000)
    drive.receive(current(-250), n * MS - 600_000)
    (sample,) = drive.take_samples()
    assert sample.stamp_ns == (n - 1) * MS
    assert sample.received_ns == n * MS - 600_000
    assert sample.theta_m * ANGLE_LSB_RAD == pytest.approx(0.5 * math.pi)
    assert sample.current * CURRENT_LSB_A == pytest.approx(-0.25)
    assert sample.state == DriveState.OPERATIONAL


@pytest.mark.parametrize("delay_ms", [1, 3, 20, 45])
def test_on_a_slow_path_samples_are_fewer_and_their_stamps_are_true(delay_ms: int) -> None:
    drive, n = running()
    drive.receive(position(1, State.OPERATION_ENABLED), n * MS)
    drive.receive(current(100), n * MS)
    drive.take_samples()
    asked: list[int] = []
    for k in range(n, n + 200):
        for sync_ms in [each for each in asked if each + delay_ms == k]:  # the counts say which SYNC is answered
            drive.receive(position(sync_ms, State.OPERATION_ENABLED), k * MS)
            drive.receive(current(100), k * MS)
        if wire.sync() in drive.poll(k * MS):
            asked.append(k)
    samples = drive.take_samples()
    assert len(samples) == len(asked) - 1 >= 200 // delay_ms - 1
    scale = 2**24 / CONFIG.counts_per_pulley_rev
    assert [sample.stamp_ns for sample in samples] == [round(sample.theta_m / scale) * MS for sample in samples]


def test_one_sync_has_one_sample() -> None:
    drive, n = running()
    drive.take_samples()
    for _ in range(3):
        drive.receive(position(1, State.OPERATION_ENABLED), n * MS)
        drive.receive(current(100), n * MS)
    assert len(drive.take_samples()) == 1
    assert drive.counters["unpaired"] == 4


def test_frames_of_two_syncs_make_no_sample() -> None:
    drive, n = running()
    drive.take_samples()
    drive.receive(position(1, State.OPERATION_ENABLED), n * MS)
    later = n + ANSWER_NS // MS
    assert wire.sync() not in drive.poll((later - 2) * MS)
    assert wire.sync() in drive.poll(later * MS)  # the current is given up
    drive.receive(current(100), later * MS)
    assert drive.take_samples() == []
    assert (drive.counters["unpaired"], drive.counters["syncs_unanswered"]) == (1, 1)


@pytest.mark.parametrize("ratio", [16384.0, -16384.0, 500.0])
def test_gear_sign_and_zero_are_those_of_the_rig(ratio: float) -> None:
    drive = Cia402(CONFIG._replace(counts_per_pulley_rev=ratio, zero_counts=77.0))
    frame = drive._command(wire.Control.ENABLE_OPERATION, round(77.0 + 0.25 * ratio))
    drive._cycle.poll(0)
    drive.phase = HostPhase.RUNNING
    counts = struct.unpack_from("<Hi", frame.data)[1]
    drive.receive(position(counts, State.OPERATION_ENABLED), MS)
    drive.receive(current(200), MS)
    (sample,) = drive.take_samples()
    assert sample.theta_m * ANGLE_LSB_RAD == pytest.approx(0.5 * math.pi, abs=0.02)
    assert sample.current * CURRENT_LSB_A == pytest.approx(math.copysign(0.2, ratio))


def test_a_drive_with_torque_and_without_references_is_not_told_that_the_host_lives() -> None:
    drive, n = running()
    drive.disable()
    frames = [frame for k in range(n, n + 300) for frame in tick(drive, k, State.OPERATION_ENABLED)]
    assert [frame for frame in frames if frame.arbitration_id == 0x700 + HOST_NODE] == []


def test_the_heartbeat_is_faster_than_a_short_watchdog() -> None:
    drive, _, n = set_up(CONFIG._replace(host_timeout_ns=9 * MS))
    frames = [frame for k in range(n, n + 30) for frame in tick(drive, k, State.SWITCH_ON_DISABLED)]
    assert len([frame for frame in frames if frame.arbitration_id == 0x700 + HOST_NODE]) == 10


def test_a_current_that_no_recording_holds_is_counted() -> None:
    drive, n = running()
    drive.take_samples()
    drive.receive(position(1, State.OPERATION_ENABLED), n * MS)
    drive.receive(current(2**31 - 1), n * MS)
    assert drive.take_samples() == []
    assert drive.counters["out_of_range"] == 1
