"""The loop against the real state machines of both ends: what leaves, when, and what is counted and recorded."""

import io

import pytest

from firmware_protocol.messages import DriveState
from hil_forceps.bridge.ports import SendResult
from hil_forceps.bridge.results import ServiceConfig, ServiceResult, Stage, StopReason
from hil_forceps.data.recording.reader import parse_recording
from hil_forceps.data.recording.writer import Outcome, Recorder
from hil_forceps.estimation.interface import Sample, State
from tests.unit.bridge.world import MS, START_RAW, US, World, rigged, safe

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
