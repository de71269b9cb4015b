"""What a live page sees of a service is what is recorded; what its operator asks for is done, and done safely."""

import io
from collections.abc import Callable, Iterator
from contextlib import closing
from mmap import mmap

import numpy as np
import pytest

from firmware_protocol.codec import Decoder
from firmware_protocol.host.machine import HostConfig, HostMachine
from firmware_protocol.messages import Control, DriveState, FaultReason, HostHeartbeat
from hil_forceps.bridge.axis import Axis
from hil_forceps.bridge.live.sink import LiveSink
from hil_forceps.bridge.live.topics import BENCH_TOPIC, REFERENCE_TOPIC, SAMPLE_TOPIC, STAGES, TICK_TOPIC, TOPICS
from hil_forceps.bridge.pipeline import Pipeline
from hil_forceps.bridge.ports import SendResult
from hil_forceps.bridge.results import ServiceConfig, ServiceResult, Stage, StopReason
from hil_forceps.bridge.service import Service
from hil_forceps.control.gate import Gate
from hil_forceps.data.recording.reader import parse_recording
from hil_forceps.data.recording.writer import Recorder
from hil_forceps.live.channel import Operator, Reader, Writer, size_bytes
from tests.unit.bridge.world import LIMITS, MS, NODE, PLANT, START_JAW_RAD, World, estimator, safe


class Kept(io.BytesIO):
    kept = b""

    def close(self) -> None:
        self.kept = self.getvalue()
        super().close()


class Bench:
    """A service with a page's channel beside it."""

    def __init__(self, memory: mmap, *, control: bool = True, duration_ns: int = 300 * MS) -> None:
        self.world, self.file = World(), Kept()
        self.reader, self.operator = Reader(memory), Operator(memory)
        self.stop_ns = 1 << 62
        config = ServiceConfig(duration_ns=duration_ns)
        self.recorder = Recorder(self.file, {}, threaded=False)
        live = LiveSink(Writer(memory), [PLANT], control=control)
        gate = Gate(LIMITS)
        line = Pipeline(estimator(), lambda t_s: START_JAW_RAD - 0.2 * max(t_s, 0.0), PLANT, gate, True, 3e-3)
        self.axis = Axis(HostMachine(HostConfig(NODE)), line, config, self.recorder, observer=live.axes[0])
        self.service = Service(
            self.world, self.world, [self.axis], config, lambda: self.world.time_ns >= self.stop_ns, live=live
        )

    def run(self) -> ServiceResult:
        (result,) = self.service.run()
        self.recorder.close({})
        return result


@pytest.fixture
def bench() -> Iterator[Callable[..., Bench]]:
    with closing(mmap(-1, size_bytes(1 << 14))) as memory:
        yield lambda **options: Bench(memory, **options)


Make = Callable[..., Bench]


def rows_of(slots: np.ndarray[tuple[int], np.dtype[np.void]], topic: int) -> np.ndarray[tuple[int], np.dtype[np.void]]:
    dtype = TOPICS[topic].dtype
    data = [slot["data"].tobytes()[: dtype.itemsize] for slot in slots[slots["topic"] == topic]]
    return np.frombuffer(b"".join(data), dtype)


def test_the_page_sees_bit_by_bit_what_is_recorded(bench: Make) -> None:
    made = bench()
    assert made.run().reason is StopReason.COMPLETED
    taken = made.reader.take()
    assert taken.lost == 0
    recording = parse_recording(made.file.kept, "run")
    assert len(recording.samples) > 250
    for topic, recorded in (
        (SAMPLE_TOPIC, recording.samples),
        (REFERENCE_TOPIC, recording.references),
        (BENCH_TOPIC, recording.bench),
    ):
        assert rows_of(taken.slots, topic).tobytes() == recorded.tobytes()


def test_every_tick_has_a_row_with_what_the_recording_has_not(bench: Make) -> None:
    made = bench()
    made.run()
    ticks = rows_of(made.reader.take().slots, TICK_TOPIC)
    assert len(ticks) == made.service.counters["ticks"] + 1  # the end is told once more
    assert [STAGES[code] for code in dict.fromkeys(ticks["stage"].tolist())] == [
        Stage.CONNECTING, Stage.ENABLING, Stage.RUNNING, Stage.STOPPING, Stage.ENDED,
    ]  # fmt: skip
    running = ticks[ticks["stage"] == STAGES.index(Stage.RUNNING)]
    assert np.isfinite(running["theta_j_estimate_rad"]).all()
    assert np.abs(running["jaw_error_rad"][5:]).max() < 0.05
    assert np.isnan(ticks["jaw_error_rad"][ticks["stage"] != STAGES.index(Stage.RUNNING)]).all()
    # Sample, way to the host and phase: the same as the histogram's.
    assert set(running["age_ns"][5:].tolist()) <= {made.axis.age_ns}


def test_the_last_status_says_how_it_ended(bench: Make) -> None:
    made = bench()
    result = made.run()
    status = made.reader.status()
    assert status is not None
    (axis,) = status["axes"]
    assert (axis["stage"], axis["reason"], axis["message"]) == ("ended", "completed", result.message)
    assert axis["drive"] == "disabled"
    assert axis["counters"]["pipeline"] == result.counters["pipeline"]
    assert status["counters"]["loop"]["ticks"] == result.counters["service"]["ticks"]


def test_an_emergency_stop_takes_torque_off_in_the_next_tick_and_waits(bench: Make) -> None:
    made = bench()
    made.world.at(100 * MS, made.operator.stop)
    made.world.at(102 * MS, lambda: seen.append(made.world.machine.state))
    made.stop_ns = 500 * MS
    seen: list[DriveState] = []
    result = made.run()
    assert seen == [DriveState.FAULT]
    assert made.world.machine.fault is FaultReason.ESTOP
    assert made.world.time_ns > 490 * MS  # it waited for an operator, beyond its own duration
    assert (result.reason, result.drive_disabled, result.ok) == (StopReason.EMERGENCY_STOP, True, False)
    assert result.message == "stopped by an operator; not cleared"
    assert max(time_ns for time_ns, _ in made.world.setpoints()) <= 101 * MS
    stages = [word for _, word in made.axis.stages]
    assert stages == ["connecting", "enabling", "running", "stopped", "ended"]
    assert made.axis.fault is not None
    assert made.axis.fault.reason == "emergency_stop"
    samples = parse_recording(made.file.kept, "run").samples
    assert samples["received_ns"][-1] > 490 * MS  # and the page saw all the time what the jaw did


def test_to_clear_it_frees_the_drive_but_gives_no_torque(bench: Make) -> None:
    made = bench()
    made.world.at(100 * MS, made.operator.stop)
    made.world.at(200 * MS, made.operator.clear)
    result = made.run()
    assert result.message == "stopped by an operator; cleared"
    assert 200 * MS < made.world.time_ns < 400 * MS
    assert made.world.machine.state is DriveState.DISABLED
    sent = [(time_ns, Decoder().decode(frame)) for time_ns, frame in made.world.sent]
    after = [message for time_ns, message in sent if time_ns > 101 * MS and isinstance(message, HostHeartbeat)]
    assert after
    assert not any(message.control & Control.ENABLE for message in after)
    assert safe(made.world)


def test_without_an_emergency_stop_there_is_nothing_to_clear(bench: Make) -> None:
    made = bench()
    made.world.at(100 * MS, made.operator.clear)
    assert made.run().reason is StopReason.COMPLETED


def test_a_page_without_control_stops_nothing(bench: Make) -> None:
    made = bench(control=False)
    made.world.at(100 * MS, made.operator.stop)
    made.world.at(150 * MS, made.operator.clear)
    assert made.run().reason is StopReason.COMPLETED


def test_an_emergency_stop_before_the_drive_is_enabled(bench: Make) -> None:
    made = bench()
    made.world.at(2 * MS, made.operator.stop)
    made.stop_ns = 100 * MS
    result = made.run()
    assert result.reason is StopReason.EMERGENCY_STOP
    assert made.world.setpoints() == []
    assert safe(made.world)


def test_a_stop_that_the_bus_does_not_take_is_sent_until_the_drive_has_it(bench: Make) -> None:
    made = bench()

    def choke() -> None:
        made.world.result = SendResult.QUEUE_FULL
        made.operator.stop()

    def free() -> None:
        assert made.world.machine.state is DriveState.OPERATIONAL
        made.world.result = SendResult.SENT

    made.world.at(100 * MS, choke)
    made.world.at(110 * MS, free)  # before the drive's own watchdog
    made.world.at(113 * MS, lambda: faults.append(made.world.machine.fault))
    made.stop_ns = 200 * MS
    faults: list[FaultReason] = []
    made.run()
    assert faults == [FaultReason.ESTOP]


def test_an_emergency_stop_while_the_run_is_ending_changes_no_reason(bench: Make) -> None:
    made = bench()
    made.stop_ns = 100 * MS
    made.world.at(102 * MS, made.operator.stop)
    result = made.run()
    assert result.reason is StopReason.STOP_REQUESTED
    assert safe(made.world)
