"""The VESC profile before there is torque: who is asked what, its timeout tried, who is refused."""

import pytest

from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState
from firmware_protocol.states import HostPhase
from tests.unit.drives.vesc.bench import CONFIG, NODE, SET_CURRENT, TURNS, Bench, answer, command


def test_nothing_but_requests_goes_out_before_it_answers() -> None:
    bench = Bench()
    bench.drive.connect(0)
    bench.says = list
    assert bench.tick(400) == []
    assert bench.drive.phase is HostPhase.IDENTIFYING
    assert bench.drive.drive_state is None


def test_its_timeout_is_tried_with_one_release_and_then_it_is_ready() -> None:
    bench = Bench()
    bench.drive.connect(0)
    sent = bench.tick(100)
    assert [(command(frame), frame.data) for frame in sent] == [(SET_CURRENT, bytes(4))]
    assert bench.drive.phase is HostPhase.READY
    assert bench.drive.drive_state is DriveState.DISABLED


@pytest.mark.parametrize("timeout_ms", [0, 1000])
def test_a_timeout_that_is_off_or_longer_than_said_is_refused(timeout_ms: int) -> None:
    bench = Bench()
    bench.timeout_ms = timeout_ms
    bench.drive.connect(0)
    bench.tick(300)
    assert bench.drive.phase is HostPhase.REFUSED
    assert "Timeout to 100 ms" in bench.drive.refusal
    assert "motor_driver.watchdog_s" in bench.drive.refusal
    assert len(bench.sent) == (timeout_ms > 0)  # one that others may command, or that has no timeout, is told nothing


def test_current_that_nobody_asked_for_is_refused() -> None:
    bench = Bench()
    bench.says = lambda: answer(status=bench.has_timeout(), current=3)  # a timeout brake current
    bench.drive.connect(0)
    bench.tick(505)
    assert bench.drive.phase is HostPhase.REFUSED
    assert "Timeout Brake Current" in bench.drive.refusal
    assert bench.drive.drive_state is DriveState.ARMED


def test_one_that_takes_no_command_is_refused() -> None:
    bench = Bench()
    bench.says = lambda: answer(status=1)
    bench.drive.connect(0)
    bench.tick(400)
    assert bench.drive.phase is HostPhase.REFUSED
    assert "accepts no command" in bench.drive.refusal


def test_firmware_that_does_not_tell_its_timeout_is_refused() -> None:
    bench = Bench()
    bench.says = lambda: answer(cut=1)
    bench.drive.connect(0)
    bench.tick(3)
    assert bench.drive.phase is HostPhase.REFUSED
    assert "5.03" in bench.drive.refusal


def test_one_that_broadcasts_but_does_not_answer_is_refused() -> None:
    bench = Bench()
    bench.says = lambda: [Frame(9 << 8 | NODE, bytes(8), is_extended=True)]
    bench.drive.connect(0)
    bench.tick(600)
    assert bench.drive.phase is HostPhase.REFUSED
    assert "does not answer" in bench.drive.refusal
    assert bench.drive.counters["broadcasts"] > 0


def test_one_that_answers_otherwise_is_refused() -> None:
    bench = Bench()
    bench.says = lambda: answer(cut=2)
    bench.drive.connect(0)
    bench.tick(505)
    assert bench.drive.phase is HostPhase.REFUSED
    assert "other values than requested" in bench.drive.refusal


def test_a_boot_while_it_is_identified_begins_the_trial_anew() -> None:
    bench = Bench()
    bench.drive.connect(0)
    bench.tick(20)
    assert len(bench.sent) == 1
    bench.hear(Frame(57 << 8 | NODE, b"60_MK6", is_extended=True))
    bench.tick(30)
    assert bench.drive.phase is HostPhase.IDENTIFYING
    bench.tick(120)
    assert bench.drive.phase.name == "READY"
    assert len(bench.sent) == 2


def test_two_with_one_id_are_refused_whether_their_answers_are_whole_or_torn() -> None:
    whole, torn = Bench(), Bench()
    whole.says = lambda: [*answer(status=1), *answer(status=1, position_deg=40.0)]
    torn.says = lambda: [
        frame for pair in zip(answer(status=1), answer(status=1, position_deg=40.0), strict=True) for frame in pair
    ]
    for bench in (whole, torn):
        bench.drive.connect(0)
        bench.tick(15)
        assert bench.drive.phase is HostPhase.REFUSED
        assert "two VESCs have this id" in bench.drive.refusal
        assert {command(frame) for frame in bench.sent} <= {SET_CURRENT}


def test_a_start_that_may_be_in_several_turns_is_refused() -> None:
    bench = Bench(CONFIG._replace(turns=TURNS._replace(high_rev=3.0)))
    bench.drive.connect(0)
    bench.tick(10)
    assert bench.drive.phase is HostPhase.REFUSED
    assert "`limits:`" in bench.drive.refusal
