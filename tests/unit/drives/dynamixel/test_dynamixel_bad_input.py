"""What comes from outside never raises in the Dynamixel profile: it is counted and dropped. Wrong calls raise."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.frames import Frame
from firmware_protocol.states import HostPhase
from hil_forceps.drives.dynamixel import packets as wire
from hil_forceps.drives.dynamixel.machine import (
    TRANSITIONS,
    Dynamixel,
)
from tests.unit.drives.dynamixel.bench import CONFIG, MS, NODE, Bench, ready, running


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
