"""The Dynamixel profile while it runs: samples with their stamps and units, references, what feeds the watchdog."""

import pytest

from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_PER_REV, CURRENT_LSB_A
from firmware_protocol.states import HostPhase
from hil_forceps.drives.dynamixel.machine import (
    FEEDBACK_NS,
    SILENCE_NS,
    Dynamixel,
)
from tests.unit.drives.dynamixel.bench import (
    CONFIG,
    MS,
    READ,
    RIG,
    SYNC_WRITE,
    Bench,
    instructions,
    phase,
    ready,
    running,
)
from virtual_bus.drives.dynamixel import SimulatedDynamixel
from virtual_bus.drives.dynamixel_table import TRIPPED


def test_a_sample_is_one_answer_and_its_stamp_is_when_the_question_was_through() -> None:
    bench = ready()
    bench.servo.table.put(126, -7)
    bench.tick()
    sample = bench.samples[-1]
    asked_ns = bench.now_ns - MS
    assert sample.stamp_ns == asked_ns + 14 * 10 * 1_000_000_000 // 3_000_000
    assert sample.received_ns == bench.now_ns
    running_bench = running()
    sample = running_bench.samples[-1]
    assert sample.stamp_ns == running_bench.now_ns - MS + (19 + 14) * 10 * 1_000_000_000 // 3_000_000


@pytest.mark.parametrize("ratio", [1.0, -3.0])
def test_units_ratio_and_sign(ratio: float, monkeypatch: pytest.MonkeyPatch) -> None:
    drive = Dynamixel(CONFIG._replace(counts_per_pulley_rev=4096.0 * ratio))
    bench = Bench(rig=RIG)
    bench.drive = drive
    drive.connect(0)
    bench.until(HostPhase.READY)
    bench.tick()
    position = int.from_bytes(bench.servo.table.data[132:136], "little", signed=True)
    monkeypatch.setattr(SimulatedDynamixel, "_loop", lambda *_: None)  # values as they are put
    bench.servo.table.put(126, 100)
    bench.samples.clear()
    bench.tick(2)
    sample = bench.samples[-1]
    assert sample.theta_m == round((position - 1024) / 4096 / ratio * ANGLE_LSB_PER_REV)
    assert sample.current == round(100 * 2.69e-3 / CURRENT_LSB_A) * (1 if ratio > 0 else -1)
    drive.enable()
    bench.until(HostPhase.RUNNING)
    bench.tick(1, raw=ANGLE_LSB_PER_REV // 8)
    bench.tick(1, raw=ANGLE_LSB_PER_REV // 8)
    assert bench.get(116) == 1024 + round(512 * ratio)


def test_a_running_servo_is_asked_behind_references_and_not_otherwise() -> None:
    bench = running()
    first = len(bench.sent)
    bench.tick(200)
    pairs = bench.sent[first:]
    assert instructions(pairs) == [SYNC_WRITE, READ] * 200
    asked_again = bench.drive.counters["asked_again"]
    bench.tick(100)
    assert bench.drive.counters["asked_again"] == asked_again


def test_an_estimator_that_stalls_ends_in_silence_and_the_servo_stops() -> None:
    bench = running()
    bench.references = False
    first, since_ns = len(bench.sent), bench.now_ns
    bench.tick(49)
    assert set(instructions(bench.sent[first:])) == {READ}  # for half the watchdog's time, and not a tick longer
    bench.tick(2)
    silent = len(bench.sent)
    bench.tick(48)
    assert len(bench.sent) == silent
    assert bench.get(98) == 5
    bench.tick(60)
    assert bench.now_ns - since_ns <= 1.6 * 100 * MS
    assert bench.get(98) == TRIPPED
    assert len(bench.sent) == silent
    assert bench.get(64) == 1  # it stops, it does not let go
    bench.drive.disable()
    bench.tick(6)
    assert bench.get(64) == 0
    assert bench.drive.drive_state is DriveState.DISABLED


@pytest.mark.parametrize("direction", ["to_host", "to_servo"])
def test_a_lost_packet_costs_some_ticks_and_not_the_run(direction: str) -> None:
    bench = running()
    lost = [1]

    def lose(frame: Frame) -> list[Frame]:
        if lost[0] and frame.data[0] in {READ, 0x55}:
            lost[0] -= 1
            return []
        return [frame]

    setattr(bench, direction, lose)
    count = len(bench.samples)
    bench.tick(30)
    assert bench.drive.phase is HostPhase.RUNNING
    assert bench.drive.counters["unanswered"] == 1
    assert bench.drive.counters["late_answers"] == 0
    assert len(bench.samples) - count >= 30 - FEEDBACK_NS // MS - 1
    assert bench.get(98) == 5


def test_a_line_that_is_cut_ends_in_silence_before_the_watchdog_and_stays_silent() -> None:
    bench = running()
    bench.to_servo = lambda _: []
    first = len(bench.sent)
    bench.tick(60)
    asked = len(bench.sent) - first
    assert 1 <= asked - 2 <= 50 // 5  # what was sent in the first tick, then one in 5 ms
    bench.to_servo = lambda frame: [frame]
    bench.tick(200)
    assert len(bench.sent) - first == asked
    assert bench.get(98) == TRIPPED
    assert phase(bench) is HostPhase.RUNNING  # the service has ended the run by then
    bench.tick(SILENCE_NS // MS)
    assert phase(bench) is HostPhase.DISCONNECTED


def test_a_goal_that_the_servo_can_not_count_is_not_sent() -> None:
    bench = running()
    assert bench.drive._line.waiting_for is not None
    bench.references = False
    bench.tick(60)
    assert bench.drive.setpoint(ANGLE_LSB_PER_REV * 300) is None
    assert bench.drive.counters["out_of_range"] == 1


def test_while_the_servo_may_answer_no_reference_is_sent() -> None:
    bench = running()
    assert bench.drive._line.waiting_for is not None
    assert bench.drive.setpoint(0) is None
