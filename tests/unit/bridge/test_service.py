"""The loop against the real state machines of both ends, on a bus that does as it is told."""

import errno
import io
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest

from firmware_protocol import codec
from firmware_protocol.drive.machine import DriveConfig, DriveMachine
from firmware_protocol.frames import Frame, split_id
from firmware_protocol.host.machine import HostConfig, HostMachine
from firmware_protocol.messages import BenchSensor, DriveState, FaultReason, Function, Identity, Setpoint
from firmware_protocol.scales import ANGLE_LSB_RAD
from hil_forceps.bridge.axis import Axis
from hil_forceps.bridge.pipeline import Pipeline
from hil_forceps.bridge.ports import SendResult
from hil_forceps.bridge.results import ServiceConfig, ServiceResult, Stage, StopReason, Telemetry
from hil_forceps.bridge.service import Service
from hil_forceps.control.gate import Gate, GateVerdict
from hil_forceps.data.recording.reader import parse_recording
from hil_forceps.data.recording.writer import Outcome, Recorder
from hil_forceps.estimation.interface import Estimate, Estimator, Sample, State
from hil_forceps.rig.plant import PlantParameters
from hil_forceps.rig.sections import Limits

PLANT = PlantParameters(2.0e-3, 1.4e-3, 3.18e-8, 6.85e-8, 1.16e-4, 4.62e-7, 4.62e-9, 2.6e4, 1.35e-2)
LIMITS = Limits(position_min_rad=-1.0, position_max_rad=3.0, speed_max_rad_per_s=1e4, acceleration_max_rad_per_s2=1e9)
US, MS = 1_000, 1_000_000
NODE = 5
START_RAW = round(1.1 / ANGLE_LSB_RAD)
START_JAW_RAD = START_RAW * ANGLE_LSB_RAD * PLANT.motor_pulley_radius_m / PLANT.jaw_pulley_radius_m
WATCHDOG_MS = 20


class World:
    """Drive, bus and clock in one: time passes when the host sleeps, the motor is wherever it is told to be."""

    def __init__(self, delay_ns: int = 350 * US) -> None:
        self.machine = DriveMachine(DriveConfig(NODE, 77, watchdog_timeout_us=WATCHDOG_MS * 1000))
        self.time_ns = 0
        self.attempts = 0
        self.delay_ns = delay_ns
        self.theta_raw = START_RAW
        self.result = SendResult.SENT  # of the next frames
        self.up = True
        self.mute = False  # the drive is unplugged, the bus is there
        self.late_ns: dict[int, int] = {}  # wake of a sleep until then is so much too late
        self.events: list[tuple[int, Callable[[], None]]] = []
        self.sent: list[tuple[int, Frame]] = []
        self.angles: dict[int, int] = {}  # measured angle by sample sequence, as last sent
        self.counters: dict[str, int] = {}
        self._arrivals: list[tuple[int, Frame]] = []
        self._sample = 0

    def now_ns(self) -> int:
        return self.time_ns

    def sleep_until_ns(self, time_ns: int) -> None:
        target_ns = time_ns + self.late_ns.pop(time_ns, 0)
        while (self._sample * MS) <= target_ns:
            self.time_ns = self._sample * MS
            self._run_drive()
            self._sample += 1
        self.time_ns = max(target_ns, self.time_ns)

    def at(self, time_ns: int, action: Callable[[], None]) -> None:
        self.events.append((time_ns, action))

    def _run_drive(self) -> None:
        for time_ns, action in [event for event in self.events if event[0] <= self.time_ns]:
            self.events.remove((time_ns, action))
            action()
        now_us = self.time_ns // 1000
        frames = self.machine.poll(now_us)
        if self.machine.reference_raw is not None:
            self.theta_raw = self.machine.reference_raw
        self.angles[self._sample % 256] = self.theta_raw
        frames += self.machine.sample(now_us, self.theta_raw, 100)
        frames.append(codec.encode(BenchSensor(NODE, 1000, 2000, self._sample % 256)))
        self._deliver(frames)

    def _deliver(self, frames: list[Frame]) -> None:
        if self.up and not self.mute:
            self._arrivals += [(self.time_ns + self.delay_ns, frame) for frame in frames]

    def send(self, frame: Frame) -> SendResult:
        self.attempts += 1
        if not self.up:
            return SendResult.BUS_DOWN
        if self.result is SendResult.SENT:
            self.sent.append((self.time_ns, frame))
            if not self.mute:
                self._deliver(self.machine.receive(frame, self.time_ns // 1000, self.theta_raw))
        return self.result

    def receive(self) -> list[tuple[int, Frame]]:
        here = [arrival for arrival in self._arrivals if arrival[0] <= self.time_ns]
        self._arrivals = self._arrivals[len(here) :]
        return here

    def is_up(self) -> bool:
        return self.up

    def close(self) -> None:
        self.up = False

    def setpoints(self) -> list[tuple[int, Setpoint]]:
        decoder = codec.Decoder()
        decoded = [(time_ns, decoder.decode(frame)) for time_ns, frame in self.sent]
        return [(time_ns, message) for time_ns, message in decoded if isinstance(message, Setpoint)]


class SpyGate(Gate):
    """Remember what passed."""

    def __init__(self, limits: Limits) -> None:
        super().__init__(limits)
        self.passed: set[int] = set()

    def step(self, requested_rad: float, now_ns: int) -> tuple[float | None, GateVerdict]:
        result = super().step(requested_rad, now_ns)
        if result[0] is not None:
            self.passed.add(round(result[0] / ANGLE_LSB_RAD))
        return result


class Rigged(NamedTuple):
    world: World
    gate: SpyGate
    service: Service
    seen: list[Telemetry]

    def run(self) -> ServiceResult:
        (result,) = self.service.run()
        return result


def estimator(nan_from_ns: int | None = None) -> Estimator:
    def known(state: np.ndarray[tuple[int], np.dtype[np.float64]]) -> Estimate:
        bad = nan_from_ns is not None and state[0] >= nan_from_ns
        return Estimate(float("nan"), float("nan")) if bad else Estimate(1e-3, 1e-6)

    return Estimator("fixed", lambda s: np.array([s.time_ns]), lambda _, s: np.array([s.time_ns]), known)


def rigged(
    world: World | None = None,
    config: ServiceConfig | None = None,
    recorder: Recorder | None = None,
    nan_from_ns: int | None = None,
    stop_at_ns: int | None = None,
    telemetry: Callable[[Telemetry], None] | None = None,
) -> Rigged:
    world = world or World()
    gate = SpyGate(LIMITS)
    line = Pipeline(
        estimator(nan_from_ns),
        lambda t_s: START_JAW_RAD - 0.2 * max(t_s, 0.0),
        PLANT,
        gate,
        True,
        3e-3,
        same_clock=True,
    )
    seen: list[Telemetry] = []
    config = config or ServiceConfig(duration_ns=500 * MS)
    service = Service(
        world,
        world,
        [Axis(HostMachine(HostConfig(NODE)), line, config, recorder)],
        config,
        stop_requested=lambda: stop_at_ns is not None and world.time_ns >= stop_at_ns,
        telemetry=telemetry or seen.append,
    )
    return Rigged(world, gate, service, seen)


def safe(world: World) -> bool:
    return world.machine.state in {DriveState.DISABLED, DriveState.FAULT} and world.machine.reference_raw is None


# -- invariants first -------------------------------------------------------------------------------------------------


def test_no_reference_leaves_that_the_gate_did_not_pass() -> None:
    bench = rigged()
    bench.run()
    setpoints = bench.world.setpoints()
    assert len(setpoints) > 400
    assert all(setpoint.theta_m_ref in bench.gate.passed for _, setpoint in setpoints)


def test_every_reference_comes_from_a_sample_of_its_own_and_a_fresh_one() -> None:
    bench = rigged()
    bench.run()
    before = -1
    for time_ns, setpoint in bench.world.setpoints():
        newest = (time_ns - bench.world.delay_ns) // MS
        assert setpoint.sample_sequence == newest % 256
        assert newest != before
        before = newest


def test_nothing_is_sent_to_follow_when_samples_are_stale() -> None:
    world = World()
    bench = rigged(world, ServiceConfig(duration_ns=500 * MS))
    world.at(250 * MS, lambda: setattr(world, "delay_ns", 5 * MS))
    result = bench.run()
    last_ns = bench.world.setpoints()[-1][0]
    assert last_ns <= 251 * MS
    assert result.counters["pipeline"]["stale"] > 10
    assert result.reason is StopReason.DRIVE_FAULT, "the drive's watchdog acts"
    assert "WATCHDOG" in result.message
    assert safe(world)


def test_a_reference_from_a_sample_that_aged_while_the_estimator_stalled_does_not_leave() -> None:
    world = World()
    bench = rigged(world)
    (axis,) = bench.service._axes
    step = axis.pipeline._step
    stalls = [200 * MS]

    def stalled(state: State, sample: Sample) -> State:
        if stalls and world.time_ns >= stalls[0]:
            world.sleep_until_ns(stalls.pop() + 12 * MS + 300 * US)
        return step(state, sample)

    axis.pipeline._step = stalled
    result = bench.run()
    assert result.counters["pipeline"]["stale"] == 1
    assert not [time_ns for time_ns, _ in world.setpoints() if 200 * MS < time_ns < 212 * MS + 600 * US]
    assert result.reason is StopReason.COMPLETED


def test_enabling_moves_nothing() -> None:
    bench = rigged()
    bench.run()
    _, first = bench.world.setpoints()[0]
    assert first.theta_m_ref == START_RAW
    assert bench.world.machine.counters["faults"] == 0


# -- how runs end -----------------------------------------------------------------------------------------------------


def test_a_run_to_its_end() -> None:
    bench = rigged()
    result = bench.run()
    assert (result.reason, result.drive_disabled, result.ok) == (StopReason.COMPLETED, True, True)
    assert bench.world.machine.state is DriveState.DISABLED
    service, pipeline = result.counters["service"], result.counters["pipeline"]
    assert service["references_sent"] == len(bench.world.setpoints())
    assert service["queue_full"] == service["overruns"] == pipeline["stale"] == pipeline["denied"] == 0
    assert result.timing["age"]["p50_us"] == 600.0
    assert result.timing["lateness"]["max_us"] == 0.0
    assert result.zero_ns is not None
    assert bench.world.theta_raw < START_RAW
    with pytest.raises(ValueError, match="once"):
        bench.run()


def test_a_stop_request_disables_the_drive_in_whatever_stage_it_comes() -> None:
    for stop_ns in (0, 15 * MS, 60 * MS, 300 * MS):
        bench = rigged(stop_at_ns=stop_ns)
        result = bench.run()
        assert result.reason is StopReason.STOP_REQUESTED
        assert result.ok
        assert bench.world.machine.state is DriveState.DISABLED


def test_a_full_queue_is_counted_and_its_frames_are_never_sent_later() -> None:
    world = World()
    bench = rigged(world)
    world.at(200 * MS, lambda: setattr(world, "result", SendResult.QUEUE_FULL))
    world.at(205 * MS, lambda: setattr(world, "result", SendResult.SENT))
    result = bench.run()
    assert result.reason is StopReason.COMPLETED
    service = result.counters["service"]
    assert service["queue_full"] in {5, 6}
    assert world.attempts == service["frames_sent"] + service["queue_full"], "nothing is tried twice"
    gap = [time_ns for time_ns, _ in world.setpoints() if 200 * MS <= time_ns < 205 * MS]
    assert gap == []
    assert len({time_ns for time_ns, _ in world.setpoints()}) == len(world.setpoints()), "one a tick, no burst"


def test_a_bus_that_goes_away_ends_the_run_and_the_watchdog_stops_the_motor() -> None:
    world = World()
    bench = rigged(world)
    world.at(200 * MS, world.close)
    result = bench.run()
    assert (result.reason, result.ok, result.drive_disabled) == (StopReason.BUS_DOWN, False, False)
    assert "watchdog" in result.message
    world.sleep_until_ns(world.time_ns + (WATCHDOG_MS + 2) * MS)
    assert safe(world)
    assert world.machine.fault is FaultReason.WATCHDOG


def test_a_fault_of_the_drive_ends_the_run_with_its_reason_in_words() -> None:
    world = World()
    bench = rigged(world)
    world.at(200 * MS, lambda: world.machine.trip(FaultReason.OVERCURRENT))
    result = bench.run()
    assert (result.reason, result.drive_disabled) == (StopReason.DRIVE_FAULT, True)
    assert "OVERCURRENT" in result.message


def test_an_estimate_that_is_not_finite_disables_the_drive_before_its_watchdog() -> None:
    bench = rigged(nan_from_ns=300 * MS)
    result = bench.run()
    assert (result.reason, result.drive_disabled) == (StopReason.REFERENCE_DENIED, True)
    assert bench.world.machine.state is DriveState.DISABLED
    assert max(time_ns for time_ns, _ in bench.world.setpoints()) < 301 * MS


def test_a_drive_that_vanishes_is_noticed() -> None:
    world = World()
    bench = rigged(world)
    world.at(200 * MS, lambda: setattr(world, "mute", True))
    result = bench.run()
    assert (result.reason, result.drive_disabled) == (StopReason.DRIVE_LOST, False)
    assert "did not confirm" in result.message


def test_a_drive_that_was_disabled_by_somebody_else_ends_the_run() -> None:
    world = World()
    bench = rigged(world)

    def restart() -> None:
        world.machine = DriveMachine(world.machine.config)

    world.at(200 * MS, restart)
    result = bench.run()
    assert result.reason in {StopReason.DRIVE_STOPPED, StopReason.DRIVE_LOST}
    assert safe(world)


def test_nobody_there() -> None:
    world = World()
    world.mute = True
    result = rigged(world).run()
    assert (result.reason, result.ok) == (StopReason.NO_DRIVE, False)
    assert "nothing came over the bus" in result.message
    assert world.setpoints() == []


def test_another_version_is_refused_at_connect() -> None:
    world = World()
    world.mute = True
    identity = codec.encode(Identity(NODE, 77, 9, 0))
    world.at(10 * MS, lambda: world._arrivals.append((world.time_ns, identity)))
    result = rigged(world).run()
    assert result.reason is StopReason.VERSION_REFUSED
    assert "9.0" in result.message
    assert {split_id(frame.arbitration_id)[0] for _, frame in world.sent} == {Function.DISCOVER}


def test_a_fault_from_before_ends_the_run_unless_it_may_be_cleared() -> None:
    world = World()
    world.machine.trip(FaultReason.SUPPLY)
    result = rigged(world).run()
    assert result.reason is StopReason.DRIVE_FAULT
    assert "from before: SUPPLY" in result.message
    world = World()
    world.machine.trip(FaultReason.SUPPLY)
    result = rigged(world, ServiceConfig(duration_ns=100 * MS, reset_fault=True)).run()
    assert result.reason is StopReason.COMPLETED


def test_a_drive_that_can_not_be_enabled() -> None:
    world = World()
    bench = rigged(world, ServiceConfig(duration_ns=100 * MS, enable_timeout_ns=300 * MS))
    world.at(20 * MS, lambda: setattr(world, "result", SendResult.QUEUE_FULL))
    result = bench.run()
    assert result.reason in {StopReason.ENABLE_FAILED, StopReason.NO_DRIVE}
    assert safe(world)


def test_a_motor_outside_the_limits_is_not_enabled_and_the_message_says_why() -> None:
    world = World()
    world.theta_raw = round(3.5 / ANGLE_LSB_RAD)
    result = rigged(world, ServiceConfig(duration_ns=100 * MS, enable_timeout_ns=300 * MS)).run()
    assert result.reason is StopReason.ENABLE_FAILED
    assert "within `limits:`" in result.message
    assert world.setpoints() == []
    assert safe(world)


class FullDisk(io.BytesIO):
    def write(self, data: object) -> int:
        if self.tell() > 100_000:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(data)  # type: ignore[arg-type]


@pytest.mark.parametrize("threaded", [False, True])
def test_a_full_disk_under_the_recording_stops_the_run_with_the_drive_disabled(threaded: bool) -> None:
    world = World()
    recorder = Recorder(FullDisk(), {"a": "b"}, threaded)
    result = rigged(world, ServiceConfig(duration_ns=60_000 * MS), recorder).run()
    assert (result.reason, result.drive_disabled) == (StopReason.RECORDING_FAILED, True)
    assert "No space left" in result.message
    assert world.machine.state is DriveState.DISABLED
    recorder.close({})


def test_a_mistake_in_the_program_sends_an_emergency_stop() -> None:
    def broken(telemetry: Telemetry) -> None:
        if telemetry.stage is Stage.RUNNING:
            raise RuntimeError("broken display")

    bench = rigged(telemetry=broken)
    with pytest.raises(RuntimeError, match="broken display"):
        bench.run()
    assert split_id(bench.world.sent[-1][1].arbitration_id)[0] == Function.ESTOP
    assert bench.world.machine.fault is FaultReason.ESTOP


# -- the schedule -----------------------------------------------------------------------------------------------------


def test_overruns_are_counted_and_the_schedule_stays_where_it_was() -> None:
    world = World()
    world.late_ns = {200 * MS + 600 * US: 3 * MS + 300 * US}
    bench = rigged(world)
    result = bench.run()
    service = result.counters["service"]
    assert (service["overruns"], service["skipped_periods"]) == (1, 3)
    assert result.timing["lateness"]["max_us"] == 3300.0
    late = [time_ns % MS for time_ns, _ in world.setpoints()].count(600 * US)
    assert late == len(world.setpoints()) - 1
    assert result.reason is StopReason.COMPLETED


def test_samples_of_skipped_periods_still_reach_the_estimator() -> None:
    world = World()
    world.late_ns = {200 * MS + 600 * US: 3 * MS + 300 * US}
    result = rigged(world).run()
    assert result.counters["pipeline"]["samples"] == result.counters["host"]["samples"]
    assert result.counters["host"]["lost_feedback"] == 0


def test_a_slow_loop_has_patience_with_its_drive() -> None:
    config = ServiceConfig(period_ns=15 * MS, phase_ns=MS, duration_ns=400 * MS, silence_timeout_ns=MS)
    assert rigged(config=config).run().reason is StopReason.COMPLETED


def test_telemetry_comes_seldom() -> None:
    bench = rigged(config=ServiceConfig(duration_ns=500 * MS, telemetry_period_ns=100 * MS))
    bench.run()
    assert len(bench.seen) in {6, 7}
    assert bench.seen[-1].stage in {Stage.RUNNING, Stage.STOPPING}
    assert bench.seen[-1].tau_w_N_m == 1e-3


def test_a_phase_beyond_the_period_is_a_mistake() -> None:
    with pytest.raises(ValueError, match="phase"):
        rigged(config=ServiceConfig(phase_ns=MS))


# -- the recording ----------------------------------------------------------------------------------------------------


class Kept(io.BytesIO):
    kept = b""

    def close(self) -> None:
        self.kept = self.getvalue()
        super().close()


def recorded(world: World, **settings: int) -> tuple[ServiceResult, bytes]:
    file = Kept()
    recorder = Recorder(file, {"algorithm": "fixed"}, threaded=False)
    result = rigged(world, recorder=recorder, **settings).run()  # type: ignore[arg-type]
    recorder.close({"reason": result.reason.value})
    return result, file.kept


def test_the_recording_holds_every_sample_and_every_tick() -> None:
    world = World()
    result, data = recorded(world)
    recording = parse_recording(data, "x")
    assert len(recording.samples) == result.counters["pipeline"]["samples"]
    assert len(recording.bench) == result.counters["host"]["bench_samples"]
    sent = recording.references[recording.references["outcome"] == Outcome.SENT]
    wire = [setpoint for _, setpoint in world.setpoints()]
    assert sent["reference_raw"].tolist() == [setpoint.theta_m_ref for setpoint in wire]
    assert sent["setpoint_sequence"].tolist() == [setpoint.sequence for setpoint in wire]
    assert sent["sample_sequence"].tolist() == [setpoint.sample_sequence for setpoint in wire]
    assert recording.references["trajectory_ns"].max() == 499 * MS, "nothing is computed once the run has ended"
    run = recording.to_run()
    assert {"theta_m_ref_rad", "theta_j_rad", "tau_w_N_m"} <= run.columns.keys()
    # this motor is at its reference by the next sample
    assert run.columns["theta_m_rad"] == pytest.approx(run.columns["theta_m_ref_rad"], abs=1e-6)


def test_the_same_run_gives_the_same_bytes() -> None:
    assert recorded(World())[1] == recorded(World())[1]
