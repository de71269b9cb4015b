"""The Dynamixel profile: who says what when, what feeds the watchdog, what ends it; nothing from outside raises.

The servo is the simulated one, without a line between: an answer is there at the next tick.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.frames import Frame
from firmware_protocol.host.samples import RawSample
from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_PER_REV, CURRENT_LSB_A
from firmware_protocol.states import HostPhase
from hil_forceps.drives.dynamixel import packets as wire
from hil_forceps.drives.dynamixel.enabling import FIRST_REFERENCES
from hil_forceps.drives.dynamixel.machine import (
    FEEDBACK_NS,
    SILENCE_NS,
    TRANSITIONS,
    TRIES,
    Dynamixel,
    DynamixelConfig,
)
from hil_forceps.rig import Rig, load_rig
from virtual_bus.drives.dynamixel import OVERLOAD, SimulatedDynamixel
from virtual_bus.drives.dynamixel_table import TRIPPED
from virtual_bus.plant.load import paper_load

RIG = load_rig(Path(__file__).parents[4] / "configs" / "drives" / "dynamixel.yaml")
NODE, MS = 5, 1_000_000
CONFIG = DynamixelConfig(NODE, 4096.0, 1024.0, 1.0, 5, MS, 3_000_000)
INPUT_VOLTAGE = 0x01
SYNC_WRITE, READ, WRITE, PING = 0x83, 0x02, 0x03, 0x01


class Bench:
    """A machine and a servo in ticks of 1 ms, as the service has them: answers, the reference, what is due."""

    def __init__(self, config: DynamixelConfig = CONFIG, rig: Rig = RIG, **servo: Any) -> None:
        self.drive = Dynamixel(config)
        self.servo = SimulatedDynamixel(rig, paper_load(0), **servo)
        self.now_ns = MS
        self.sent: list[Frame] = []
        self.samples: list[RawSample] = []
        self.to_host: Callable[[Frame], list[Frame]] = lambda frame: [frame]
        self.to_servo: Callable[[Frame], list[Frame]] = lambda frame: [frame]
        self.references = True  # whether the service has any
        self.drive.connect(0)

    def tick(self, count: int = 1, raw: int | None = None) -> None:
        for _ in range(count):
            self.now_ns += MS
            self.servo.wake(self.now_ns)
            for frame in self.servo.take_outbox():
                for each in self.to_host(frame):
                    self.drive.receive(each, self.now_ns)
            fresh = self.drive.take_samples()
            self.samples += fresh
            frames: list[Frame] = []
            if fresh and self.references:
                reference = self.drive.setpoint(fresh[-1].theta_m if raw is None else raw)
                frames += [] if reference is None else [reference]
            frames += self.drive.poll(self.now_ns)
            self.sent += frames
            for frame in frames:
                for each in self.to_servo(frame):
                    self.servo.receive(each, self.now_ns + 1)

    def until(self, phase: HostPhase, most: int = 300) -> None:
        for _ in range(most):
            if self.drive.phase is phase:
                return
            self.tick()
        raise AssertionError(f"{self.drive.phase.name}, not {phase.name}: {self.drive.refusal}")

    def get(self, address: int) -> int:
        return self.servo.table.get(address)


def ready(**more: Any) -> Bench:
    bench = Bench(**more)
    bench.until(HostPhase.READY)
    return bench


def running(**more: Any) -> Bench:
    bench = ready(**more)
    bench.drive.enable()
    bench.until(HostPhase.RUNNING)
    bench.tick(3)
    return bench


def phase(bench: Bench) -> HostPhase:
    return bench.drive.phase


def state(bench: Bench) -> DriveState | None:
    return bench.drive.drive_state


def instructions(frames: list[Frame]) -> list[int]:
    return [frame.data[0] for frame in frames]


def written(frames: list[Frame], address: int) -> list[int]:
    """Values that WRITEs gave an entry."""
    found = [frame.data for frame in frames if frame.data[0] == WRITE and frame.data[1] | frame.data[2] << 8 == address]
    return [int.from_bytes(data[3:], "little") for data in found]


def test_a_servo_is_pinged_until_it_answers_and_asked_nothing_else() -> None:
    bench = Bench()
    bench.to_servo = lambda _: []
    bench.tick(500)
    assert set(instructions(bench.sent)) == {PING}
    assert len(bench.sent) == 10  # one in 50 ms
    assert bench.drive.phase is HostPhase.IDENTIFYING
    bench.to_servo = lambda frame: [frame]
    bench.until(HostPhase.READY)


def test_the_set_up_is_made_without_torque_and_writes_what_is_kept_only_where_it_differs() -> None:
    rig_servo = Bench()
    rig_servo.servo.table.put(64, 1)  # left on by somebody
    rig_servo.servo.table.put(98, TRIPPED)
    rig_servo.until(HostPhase.READY)
    sent = rig_servo.sent
    order = [frame.data[1] | frame.data[2] << 8 for frame in sent if frame.data[0] == WRITE]
    assert order[0] == 64
    assert written(sent, 64) == [0]
    assert written(sent, 98) == [0, 5]  # a tripped watchdog is cleared first
    kept = {9: 0, 10: 0, 11: 5, 60: 0, 20: 0}
    assert {address: rig_servo.get(address) for address in kept} == kept
    assert [address for address in order if address < 64] == [9, 11]  # what was not so already
    assert (rig_servo.get(102), rig_servo.get(98), rig_servo.get(64)) == (0, 5, 0)
    again = Bench()
    again.servo.table = rig_servo.servo.table
    again.until(HostPhase.READY)
    assert written(again.sent, 9) == written(again.sent, 11) == []


@pytest.mark.parametrize("level", [0, 1])
def test_a_servo_that_answers_little_is_told_to_answer_all(level: int) -> None:
    bench = Bench()
    bench.servo.table.put(68, level)
    bench.until(HostPhase.READY)
    assert bench.get(68) == 2
    assert bench.drive.counters["unanswered"] == 0


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ((0, 1060), "servo 5 has the model number 1060; those that are known here: XM430-W350 (1020)"),
        ((6, 37), "servo 5 has the firmware 37, which has no bus watchdog; update it to 38"),
        ((20, 100), "servo 5 has Homing Offset (20) 100, where 0 is wanted"),
        ((38, 100), "servo 5 has Current Limit (38) 100, where at least 372 is wanted: motor_driver.current_limit_A"),
    ],
)
def test_a_servo_that_can_not_be_used_is_refused_in_one_line(entry: tuple[int, int], said: str) -> None:
    bench = Bench()
    bench.servo.table.put(*entry)
    bench.until(HostPhase.REFUSED)
    assert bench.drive.refusal.startswith(said)
    assert "\n" not in bench.drive.refusal
    assert bench.get(64) == 0
    sent = len(bench.sent)
    bench.tick(100)
    assert len(bench.sent) == sent


def test_an_older_firmware_is_not_asked_for_what_it_does_not_have() -> None:
    bench = Bench()
    bench.servo.table.put(6, 40)
    bench.until(HostPhase.READY)
    assert not [frame for frame in bench.sent if frame.data[:3] == bytes((READ, 60, 0))]


def test_a_servo_that_stops_answering_in_the_set_up_is_refused() -> None:
    bench = Bench()
    bench.to_servo = lambda frame: [frame] if frame.data[0] in {PING, SYNC_WRITE} else []
    bench.until(HostPhase.REFUSED, 400)
    assert "does not answer requests for Torque Enable (64)" in bench.drive.refusal
    assert bench.drive.counters["unanswered"] == TRIES


def test_an_adapter_that_holds_answers_back_is_refused_with_the_remedy() -> None:
    bench = Bench()
    held: list[tuple[int, Frame]] = []

    def late(frame: Frame) -> list[Frame]:
        held.append((bench.now_ns + 16 * MS, frame))
        return []

    bench.to_host = late
    for _ in range(1000):
        bench.tick()
        while held and held[0][0] <= bench.now_ns:
            bench.drive.receive(held.pop(0)[1], bench.now_ns)
        if bench.drive.phase is HostPhase.REFUSED:
            break
    assert "answers after 17 ms" in bench.drive.refusal
    assert "latency_timer" in bench.drive.refusal


def test_no_current_before_the_goal_is_the_measured_angle_under_torque() -> None:
    bench = ready()
    before = len(bench.sent)
    bench.drive.enable()
    seen: list[tuple[int, int]] = []  # torque, goal current at each goal position that arrives

    def watch(frame: Frame) -> list[Frame]:
        if frame.data[0] == SYNC_WRITE:
            seen.append((bench.get(64), bench.get(102)))
        return [frame]

    bench.to_servo = watch
    bench.until(HostPhase.RUNNING)
    assert seen == [(0, 0)] * FIRST_REFERENCES + [(1, 0)] * FIRST_REFERENCES
    goals = {frame.data[-4:] for frame in bench.sent[before:] if frame.data[0] == SYNC_WRITE}
    assert len(goals) == 1  # the angle when it began
    assert written(bench.sent[before:], 64) == [1]
    assert written(bench.sent[before:], 102) == [0, 372]  # 1 A in units of 2.69 mA
    bench.tick(3)
    assert bench.drive.drive_state is DriveState.OPERATIONAL
    assert bench.samples[-1].state == DriveState.OPERATIONAL


@pytest.mark.parametrize("goal_follows", [True, False])
def test_enabling_moves_nothing_whatever_the_servo_makes_of_its_goal(goal_follows: bool) -> None:
    bench = ready(goal_follows=goal_follows)
    bench.servo.table.put(116, 3000)  # of before
    start = bench.samples[-1].theta_m
    bench.drive.enable()
    bench.until(HostPhase.RUNNING)
    bench.tick(50, raw=start)
    assert max(abs(sample.theta_m - start) for sample in bench.samples) <= ANGLE_LSB_PER_REV // 4096


def test_torque_is_asked_for_again_where_the_servo_does_not_have_it() -> None:
    bench = ready()
    bench.drive.enable()
    lost = [2]

    def forget(frame: Frame) -> list[Frame]:
        if frame.data == bytes((0x55, 0)) and bench.get(64) and lost[0]:
            lost[0] -= 1
            bench.servo.table.put(64, 0)
        return [frame]

    bench.to_host = forget
    bench.until(HostPhase.RUNNING)
    assert written(bench.sent, 64) == [0, 1, 1, 1]


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


def test_a_hardware_error_is_told_in_words_with_the_sample_that_has_it() -> None:
    bench = running()
    bench.servo.fail(OVERLOAD)
    bench.tick(2)
    assert bench.drive.phase is HostPhase.FAULT
    assert bench.drive.fault_words() == "hardware error 0x20 (overload)"
    assert bench.drive.drive_state is DriveState.FAULT  # shut down
    assert bench.drive.counters["alerts"] >= 1
    assert bench.drive.setpoint(0) is None


def test_an_error_that_leaves_the_torque_on_is_no_reason_to_go_on_asking() -> None:
    bench = running()
    bench.servo.fail(INPUT_VOLTAGE)  # not in Shutdown (63) by default
    bench.tick(2)
    assert (bench.drive.phase, bench.drive.drive_state) == (HostPhase.FAULT, DriveState.ARMED)
    first = len(bench.sent)
    bench.tick(50)
    assert len(bench.sent) == first
    bench.drive.disable()
    bench.tick(6)
    assert bench.drive.drive_state is DriveState.FAULT
    assert bench.get(64) == 0


def test_a_fault_of_before_is_reset_by_a_reboot_and_the_servo_set_up_anew() -> None:
    bench = Bench()
    bench.servo.fail(OVERLOAD)
    bench.until(HostPhase.FAULT)
    with pytest.raises(ValueError, match="can't be enabled"):
        bench.drive.enable()
    bench.drive.reset_fault()
    bench.until(HostPhase.IDENTIFYING)
    bench.until(HostPhase.READY, 700)
    assert bench.servo.counters["reboots"] == 1
    assert (bench.get(70), bench.get(98), bench.get(68)) == (0, 5, 2)
    bench.drive.enable()
    bench.until(HostPhase.RUNNING)


def test_a_servo_that_restarts_while_running_is_noticed_although_it_answers_as_before() -> None:
    bench = running()
    bench.servo.restart()
    bench.tick(8)  # what it was asked before is lost
    assert bench.drive.phase is HostPhase.DISCONNECTED
    assert bench.drive.counters["restarts"] == 1
    bench.drive.disable()
    bench.tick(6)
    assert bench.drive.drive_state is DriveState.DISABLED


def test_a_servo_that_restarts_while_it_is_set_up_is_set_up_anew() -> None:
    bench = Bench()
    bench.tick(18)
    assert bench.drive.phase is HostPhase.IDENTIFYING
    bench.servo.restart()
    bench.until(HostPhase.READY)
    assert bench.drive.counters["restarts"] == 1
    assert bench.get(98) == 5


def test_whoever_connects_again_waits_for_nothing_of_before() -> None:
    bench = running()
    bench.servo.restart()
    bench.tick(8)
    assert phase(bench) is HostPhase.DISCONNECTED
    answer = Frame(NODE, bytes((0x55, 0, 2, 0, 0, 5)) + bytes(6), True)
    bench.drive.disable()
    bench.tick(6)
    bench.drive.connect(bench.now_ns)
    bench.drive.receive(answer, bench.now_ns)
    assert phase(bench) is HostPhase.IDENTIFYING
    bench.until(HostPhase.READY)
    assert bench.get(98) == 5


def test_a_servo_without_indirect_addresses_is_refused() -> None:
    bench = Bench()
    bench.to_servo = lambda frame: [] if frame.data[:3] == bytes((WRITE, 168, 0)) else [frame]
    bench.to_host = lambda frame: [frame]

    def answered(frame: Frame) -> list[Frame]:
        if frame.data[:3] == bytes((WRITE, 168, 0)):
            bench.drive.receive(Frame(NODE, b"\x55\x00"), bench.now_ns)
            return []
        return [frame]

    bench.to_servo = answered
    bench.until(HostPhase.REFUSED)
    assert "does not answer by them" in bench.drive.refusal


def test_torque_that_somebody_took_away_ends_the_run() -> None:
    bench = running()
    bench.servo.table.put(64, 0)
    bench.tick(2)
    assert bench.drive.phase is HostPhase.READY
    assert bench.drive.drive_state is DriveState.DISABLED


def test_a_watchdog_that_somebody_switched_off_is_a_fault() -> None:
    bench = running()
    bench.servo.table.put(98, 0)
    bench.tick(2)
    assert bench.drive.phase is HostPhase.FAULT
    assert bench.drive.fault_words() == "Bus Watchdog (98) is 0, not 5: somebody else wrote it"


def test_no_torque_is_asked_for_until_it_is_read() -> None:
    bench = running()
    held = [3]

    def stubborn(frame: Frame) -> list[Frame]:
        if frame.data[:3] == bytes((WRITE, 64, 0)) and held[0]:
            held[0] -= 1
            bench.drive.receive(Frame(NODE, b"\x55\x00"), bench.now_ns)  # taken, it says
            return []
        return [frame]

    bench.to_servo = stubborn
    bench.drive.disable()
    assert state(bench) is None
    bench.tick(2)
    assert state(bench) not in {DriveState.DISABLED, DriveState.FAULT}
    bench.tick(20)
    assert state(bench) is DriveState.DISABLED
    assert held == [0]
    assert bench.get(64) == 0


def test_disabling_while_torque_is_asked_for_ends_without() -> None:
    for ticks in range(1, 14):
        bench = ready()
        bench.drive.enable()
        bench.tick(ticks)
        first = len(bench.sent)
        bench.drive.disable()
        bench.tick(10)
        assert (bench.get(64), bench.drive.drive_state) == (0, DriveState.DISABLED), ticks
        assert [frame for frame in bench.sent[first:] if frame.data[:3] == bytes((READ, 64, 0))], ticks


def test_echoes_of_a_two_wire_adapter_are_known() -> None:
    bench = Bench()
    send = bench.to_servo

    def echoing(frame: Frame) -> list[Frame]:
        bench.drive.receive(frame, bench.now_ns)
        return send(frame)

    bench.to_servo = echoing
    bench.until(HostPhase.READY)
    bench.drive.enable()
    bench.until(HostPhase.RUNNING)
    bench.tick(20)
    assert bench.drive.counters["echoes"] == len(bench.sent)
    assert bench.drive.counters["other_hosts"] == 0


def test_what_is_not_from_the_servo_or_no_answer_is_counted_and_dropped() -> None:
    bench = running()
    counters = bench.drive.counters
    for frame, name in (
        (Frame(6, bytes((0x55, 0)) + bytes(10), True), "not_for_us"),
        (Frame(NODE, bytes((0x55, 0)) + bytes(3)), "bad_length"),
        (Frame(NODE, bytes((0x55,))), "bad_length"),
        (wire.ping(9), "other_hosts"),
        (Frame(NODE, b""), "other_hosts"),
    ):
        before = counters[name]
        bench.drive.receive(frame, bench.now_ns + MS // 2)
        assert counters[name] == before + 1
    assert bench.drive.phase is HostPhase.RUNNING


def test_an_answer_that_comes_sooner_than_the_line_allows_is_to_a_question_of_before() -> None:
    bench = running()
    first = Frame(NODE, bytes((0x55, 0, 2, 1, 0, 5)) + bytes(6), True)
    bench.drive.receive(first, bench.now_ns + 1000)
    assert bench.drive.counters["late_answers"] == 1
    assert bench.drive.take_samples() == []


def test_an_answer_that_nobody_waits_for() -> None:
    bench = running()
    bench.references = False
    bench.tick(60)
    bench.drive.receive(Frame(NODE, bytes((0x55, 0, 2, 1, 0, 5)) + bytes(6), True), bench.now_ns)
    assert bench.drive.counters["unexpected"] == 1


def test_the_servo_refuses_torque() -> None:
    bench = ready()
    bench.drive.enable()
    bench.to_servo = lambda frame: [frame]
    bench.servo._is_shut_down = True
    bench.until(HostPhase.REFUSED)
    assert bench.drive.refusal == "servo 5 refuses Torque Enable (64) = 1: result fail"


def test_the_emergency_stop_is_an_order_that_is_not_answered() -> None:
    bench = running()
    bench.servo.wake(bench.now_ns + MS)
    bench.servo.take_outbox()
    bench.servo.receive(bench.drive.estop_frame(), bench.now_ns + MS)
    assert bench.get(64) == 0
    assert bench.servo._answers == bench.servo._answers.__class__()


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


def test_calls_at_the_wrong_time_raise() -> None:
    drive = Dynamixel(CONFIG)
    with pytest.raises(ValueError, match="can't be enabled"):
        drive.enable()
    with pytest.raises(ValueError, match="no fault"):
        drive.reset_fault()
    drive.disable()
    for change in ({"node": 253}, {"counts_per_pulley_rev": 0.0}, {"watchdog": 128}):
        with pytest.raises(ValueError, match="no servo"):
            Dynamixel(CONFIG._replace(**change))


def test_every_phase_is_left_somehow() -> None:
    assert {phase for phase, _ in TRANSITIONS} == set(HostPhase) & {phase for phase, _ in TRANSITIONS}
    for phase in (HostPhase.READY, HostPhase.ENABLING, HostPhase.RUNNING, HostPhase.FAULT):
        assert TRANSITIONS[phase, "gone"] is HostPhase.DISCONNECTED
    for phase in (HostPhase.IDENTIFYING, HostPhase.READY, HostPhase.ENABLING, HostPhase.RUNNING):
        assert TRANSITIONS[phase, "fault"] is HostPhase.FAULT


STATUS_LIKE = st.builds(
    lambda servo_id, error, data: Frame(servo_id, bytes((0x55, error)) + data),
    st.sampled_from([NODE, 1, 254]),
    st.integers(0, 255),
    st.binary(max_size=12),
)
ANY = STATUS_LIKE | st.builds(Frame, st.integers(0, 0x7FF), st.binary(max_size=64))


@settings(max_examples=60, deadline=None)
@given(st.lists(ANY, max_size=40), st.sampled_from(["new", "ready", "running"]), st.booleans())
def test_whatever_comes_nothing_raises_and_what_is_sent_is_bounded(
    frames: list[Frame], start: str, turns_off: bool
) -> None:
    bench = {"new": Bench, "ready": ready, "running": running}[start]()
    if turns_off:
        bench.drive.disable()
    for n, frame in enumerate(frames):
        bench.drive.receive(frame, bench.now_ns + n * MS // 4)
        before = len(bench.sent)
        bench.tick()
        assert len(bench.sent) - before <= 2
        bench.drive.fault_words()
