"""A service whose references come from outside, in virtual time: enabled when there are some, disabled when not."""

import io
import itertools
import math
from functools import partial

import numpy as np
import pytest

from firmware_protocol.host.machine import HostConfig, HostMachine
from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_RAD
from hil_forceps.bridge.axis import Axis
from hil_forceps.bridge.pipeline import Pipeline
from hil_forceps.bridge.replay import RecordedReference, replay
from hil_forceps.bridge.results import ServiceConfig, ServiceResult, StopReason
from hil_forceps.bridge.service import Service
from hil_forceps.bridge.teleoperation.datagrams import ReferenceDatagram
from hil_forceps.bridge.teleoperation.reference_input import ReferenceInput
from hil_forceps.control.gate import Gate
from hil_forceps.data.recording.reader import Recording, parse_recording
from hil_forceps.data.recording.writer import Recorder
from hil_forceps.rig.sections import Limits
from tests.unit.bridge.world import LIMITS, MS, NODE, PLANT, START_JAW_RAD, World, estimator, safe

SESSION = 5
TIMEOUT_NS = 15 * MS  # shorter than the drive's watchdog of 20 ms, which the held references feed


class Kept(io.BytesIO):
    kept = b""

    def close(self) -> None:
        self.kept = self.getvalue()
        super().close()


def pipeline(outside: ReferenceInput | RecordedReference, limits: Limits = LIMITS) -> Pipeline:
    return Pipeline(estimator(), outside, PLANT, Gate(limits), True, 3e-3)


class Bench:
    """A service, and a sender every 5 ms from `begin_ns` to `end_ns`."""

    def __init__(self, begin_ns: int, end_ns: int, limits: Limits = LIMITS) -> None:
        self.world, self.file = World(), Kept()
        self.outside = ReferenceInput(SESSION, TIMEOUT_NS)
        config = ServiceConfig(duration_ns=400 * MS, connect_timeout_ns=100 * MS)
        self.recorder = Recorder(self.file, {}, threaded=False)
        self.axis = Axis(
            HostMachine(HostConfig(NODE)), pipeline(self.outside, limits), config, self.recorder, outside=self.outside
        )
        self.stop_ns = 900 * MS
        self.service = Service(self.world, self.world, [self.axis], config, lambda: self.world.time_ns >= self.stop_ns)
        for number, time_ns in enumerate(range(begin_ns, end_ns, 5 * MS)):
            self.world.at(time_ns, partial(self.send, number, time_ns))

    def wanted_rad(self, time_ns: int) -> float:
        return START_JAW_RAD + 0.05 * math.sin(time_ns / 5e7)

    def send(self, number: int, time_ns: int) -> None:
        datagram = ReferenceDatagram(SESSION, 0, number, time_ns, self.wanted_rad(time_ns))
        self.outside.take(datagram, "joystick", self.world.time_ns)

    def run(self) -> ServiceResult:
        (result,) = self.service.run()
        self.recorder.close({})
        return result

    def recording(self) -> Recording:
        return parse_recording(self.file.kept, "run")


def test_the_jaw_follows_what_is_sent() -> None:
    bench = Bench(0, 2000 * MS)
    result = bench.run()
    assert (result.reason, result.ok) == (StopReason.COMPLETED, True)
    references = bench.recording().references
    followed = references[np.isfinite(references["theta_j_ref_rad"])]
    assert len(followed) > 380
    sent = {bench.wanted_rad(time_ns) for time_ns in range(0, 2000 * MS, 5 * MS)}
    assert set(followed["theta_j_ref_rad"].tolist()) <= sent
    assert len(set(followed["theta_j_ref_rad"].tolist())) > 70
    assert result.counters["outside"]["accepted"] > 80
    assert result.counters["outside"]["lost"] == 0


def test_the_drive_gets_no_torque_before_somebody_sends() -> None:
    bench = Bench(300 * MS, 2000 * MS)  # later than the time to connect
    states: list[DriveState] = []
    for time_ns in range(20 * MS, 300 * MS, 10 * MS):
        bench.world.at(time_ns, lambda: states.append(bench.world.machine.state))
    result = bench.run()
    assert set(states) == {DriveState.DISABLED}
    assert min(time_ns for time_ns, _ in bench.world.setpoints()) >= 300 * MS
    assert result.reason is StopReason.COMPLETED


def test_a_reference_that_stays_away_is_held_and_then_the_drive_is_disabled() -> None:
    bench = Bench(0, 200 * MS)  # the last at 195 ms
    result = bench.run()
    assert result.reason is StopReason.REFERENCE_LOST
    assert (result.drive_disabled, result.ok) == (True, False)
    assert result.message.startswith("no external reference: the newest is 1")
    last_ns = max(time_ns for time_ns, _ in bench.world.setpoints())
    assert 195 * MS + TIMEOUT_NS - MS <= last_ns <= 195 * MS + TIMEOUT_NS + 2 * MS
    held = bench.recording().references
    held = held[(held["tick_ns"] > 196 * MS) & np.isfinite(held["theta_j_ref_rad"])]
    assert len(held) >= 10
    assert set(held["theta_j_ref_rad"].tolist()) == {bench.wanted_rad(195 * MS)}
    assert bench.axis.fault is not None
    assert bench.axis.fault.reason == "reference_lost"
    assert result.counters["outside"]["lost"] == 1
    assert bench.world.machine.fault == 0  # the host was quicker than the drive's watchdog
    assert safe(bench.world)


def test_references_that_come_back_do_not_give_torque_again() -> None:
    bench = Bench(0, 200 * MS)
    for number in range(100, 300):
        time_ns = number * 5 * MS
        bench.world.at(time_ns, partial(bench.send, number, time_ns))
    assert bench.run().reason is StopReason.REFERENCE_LOST
    assert max(time_ns for time_ns, _ in bench.world.setpoints()) < 220 * MS


def test_a_run_that_nobody_sends_to_ends_on_request_without_torque() -> None:
    bench = Bench(0, 0)
    bench.stop_ns = 500 * MS
    result = bench.run()
    assert result.reason is StopReason.STOP_REQUESTED
    assert bench.world.setpoints() == []
    assert bench.world.time_ns >= 500 * MS


def test_a_jump_goes_through_the_gate() -> None:
    limits = Limits(
        position_min_rad=-1.0, position_max_rad=3.0, speed_max_rad_per_s=2.0, acceleration_max_rad_per_s2=1e4
    )
    bench = Bench(0, 100 * MS, limits)

    def jump(number: int) -> None:
        datagram = ReferenceDatagram(SESSION, 0, number, number * 5 * MS, START_JAW_RAD + 0.5)
        bench.outside.take(datagram, "joystick", bench.world.time_ns)

    for number in range(20, 120):
        bench.world.at(number * 5 * MS, partial(jump, number))
    result = bench.run()
    assert result.reason is StopReason.COMPLETED
    setpoints = [(time_ns, setpoint.theta_m_ref * ANGLE_LSB_RAD) for time_ns, setpoint in bench.world.setpoints()]
    moved = [
        abs(later - earlier) / ((after_ns - before_ns) * 1e-9)
        for (before_ns, earlier), (after_ns, later) in itertools.pairwise(setpoints)
    ]
    assert max(moved) <= 2.0 + 2 * ANGLE_LSB_RAD / 1e-3
    way_rad = 0.5 * PLANT.jaw_pulley_radius_m / PLANT.motor_pulley_radius_m
    limited = result.counters["gate"]["limited_speed"] + result.counters["gate"]["limited_position"]
    assert limited >= 0.9 * way_rad / (2.0 * 1e-3)  # as many periods as the way takes at the limit, but for the ends
    assert setpoints[-1][1] - setpoints[0][1] == pytest.approx(way_rad, abs=1e-3)


@pytest.mark.parametrize("end_ns", [2000 * MS, 200 * MS])
def test_a_replay_takes_the_references_from_the_recording(end_ns: int) -> None:
    bench = Bench(0, end_ns)
    bench.run()
    recording, outside = bench.recording(), RecordedReference()
    assert replay(recording, pipeline(outside), outside).first_difference is None
    assert replay(recording, pipeline(RecordedReference())).first_difference is not None
