"""The Dynamixel profile before there is torque: who is asked what, what is written, who is refused."""

import pytest

from firmware_protocol.frames import Frame
from firmware_protocol.states import HostPhase
from hil_forceps.drives.dynamixel.machine import (
    MAX_TRIES,
)
from tests.unit.drives.dynamixel.bench import (
    MS,
    NODE,
    PING,
    READ,
    SYNC_WRITE,
    WRITE,
    Bench,
    instructions,
    phase,
    running,
    written,
)
from virtual_bus.drives.dynamixel_table import TRIPPED


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
        ((0, 1060), "servo 5 has the unknown model number 1060; known models: XM430-W350 (1020)"),
        ((6, 37), "servo 5 has the firmware 37, which has no bus watchdog; update it to 38"),
        ((20, 100), "servo 5 has Homing Offset (20) 100, but 0 is required"),
        ((38, 100), "servo 5 has Current Limit (38) 100, but at least 372 is required: motor_driver.current_limit_A"),
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
    assert "no longer answers requests for Torque Enable (64)" in bench.drive.refusal
    assert bench.drive.counters["unanswered"] == MAX_TRIES


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
    assert "does not answer with them" in bench.drive.refusal
