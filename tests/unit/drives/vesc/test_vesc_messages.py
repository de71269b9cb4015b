"""A VESC's frames against the maker's tables and against bytes that one sent; answers, turns, the trial."""

import binascii
import json
import struct
from pathlib import Path
from typing import Any

import cantools
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.frames import Frame
from hil_forceps.drives.vesc import messages as wire
from hil_forceps.drives.vesc.answers import Answer, Answers
from hil_forceps.drives.vesc.faults import fault_words
from hil_forceps.drives.vesc.messages import Command
from hil_forceps.drives.vesc.requests import Requests
from hil_forceps.drives.vesc.timeout_trial import SLACK_NS, Stage, TimeoutTrial
from hil_forceps.drives.vesc.turns import Turns, TurnsConfig

HERE = Path(__file__).parent
GOLDEN = json.loads((HERE / "golden.json").read_text())
DBC: Any = cantools.database.load_file(HERE / "vesc.dbc")
NODE, MS = 5, 1_000_000


def frame_of(text: str) -> Frame:
    arbitration_id, data = text.split("#")
    return Frame(int(arbitration_id, 16), bytes.fromhex(data), is_extended=True)


@pytest.mark.parametrize("golden", GOLDEN["frames"], ids=lambda golden: golden["name"])
def test_golden_frames(golden: dict[str, Any]) -> None:
    frame = frame_of(f"{golden['arbitration_id']}#{golden['data']}")
    assert wire.node_and_command(frame) == (golden["node"], Command[golden["command"]])
    assert wire.parse_plain(Command[golden["command"]], frame.data) == pytest.approx(golden["values"])


def test_an_answer_that_a_vesc_sent_comes_out_whole() -> None:
    exchange = GOLDEN["exchange"]
    answers = Answers({"torn_answers": 0})
    for text in exchange["answer"]:
        answers.fill(frame_of(text).data, 7)
    answer = answers.process(frame_of(exchange["end"]).data)
    assert answer is not None
    assert (answer.node, len(answer.payload), answer.arrived_ns) == (exchange["node"], exchange["length"], 7)
    # By the order of the mask's bits (comm/commands.c): the fields that the profile reads, and two to see the order by.
    (fet,) = struct.unpack_from(">h", answer.payload, 1)
    (volts,) = struct.unpack_from(">h", answer.payload, 27)
    fault, position, node = struct.unpack_from(">BiB", answer.payload, 53)
    assert fet / 10 == exchange["fet_degC"]
    assert volts / 10 == exchange["input_V"]
    assert (fault, position / 1e6, node) == (exchange["fault"], exchange["position_deg"], exchange["node"])


def test_the_request_is_that_of_the_capture_with_a_mask() -> None:
    request, golden = wire.request(4, tag=0xA5), frame_of(GOLDEN["exchange"]["request"])
    assert (request.arbitration_id, request.data[1]) == (golden.arbitration_id, golden.data[1])
    assert request.data[0] == wire.HOST_ID  # the capture's is 3
    assert request.data[2:] == bytes.fromhex("32 A5218020")


@pytest.mark.parametrize("position_rev", [0.0, 0.25, 0.999999, -0.25, 3.5, 1.0 - 1e-12])
def test_what_is_sent_says_what_is_meant(position_rev: float) -> None:
    frame = wire.set_position(NODE, position_rev)
    message = DBC.get_message_by_frame_id(frame.arbitration_id, force_extended_id=True)
    assert (message.name, message.is_extended_frame, frame.is_extended) == ("SET_POS", True, True)
    angle = message.decode(frame.data)["position_deg"]
    assert 0.0 <= angle < 360.0
    assert (angle - position_rev * 360.0 + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-6)


def test_the_release_is_a_current_of_nothing() -> None:
    frame = wire.release(NODE)
    message = DBC.get_message_by_frame_id(frame.arbitration_id, force_extended_id=True)
    assert (message.name, message.decode(frame.data)) == ("SET_CURRENT", {"current_A": 0.0})


@pytest.mark.parametrize("message", DBC.messages, ids=lambda message: message.name)
@given(data=st.binary(min_size=8, max_size=8))
def test_frames_with_one_layout_are_read_as_the_makers_tables_say(message: Any, data: bytes) -> None:
    data = data[: message.length]
    found = wire.node_and_command(Frame(message.frame_id, data, is_extended=True))
    assert found == (NODE, Command[message.name])
    assert wire.parse_plain(Command[message.name], data) == pytest.approx(message.decode(data))
    assert wire.parse_plain(Command[message.name], data[:-1]) is None


def payload(current: int, fault: int, position: int, status: int, tag: int = 0) -> bytes:
    return struct.pack(">BIiBiB", 50, 0x218020 | tag << 24, current, fault, position, status)


def test_numbers_are_read_as_the_middle_of_what_is_truncated_to_them() -> None:
    values = [wire.parse_values(payload(n, 7, 90_000_000, 1)) for n in (-2, -1, 0, 1, 21)]
    assert [value.current_A for value in values if value] == pytest.approx([-0.025, -0.015, 0.0, 0.015, 0.215])
    assert wire.parse_values(payload(0, 7, 90_000_000, 3, tag=200)) == wire.Values(0.0, 7, 0.25, True, True, 200)


@pytest.mark.parametrize("position", [-1, 360_000_001, 2**31 - 1])
def test_an_angle_beyond_a_turn_is_none(position: int) -> None:
    assert wire.parse_values(payload(0, 0, position, 0)) is None


@given(st.binary(max_size=64))
def test_no_bytes_raise(data: bytes) -> None:
    assert wire.parse_values(data) is None or len(data) == 15
    assert not wire.lacks_status(data) or len(data) == 14
    for command in Command:
        wire.parse_plain(command, data)


def test_an_answer_without_the_status_is_known_for_what_it_is() -> None:
    assert wire.lacks_status(payload(0, 0, 0, 0)[:-1])
    assert wire.parse_values(payload(0, 0, 0, 0)[:-1]) is None


@pytest.mark.parametrize(
    "frame",
    [Frame(0x905, b""), Frame(0x1_0905, b"", is_extended=True), Frame(0x905, b"", is_fd=True, is_extended=True)],
)
def test_ids_that_can_not_be_a_vescs(frame: Frame) -> None:
    assert wire.node_and_command(frame) is None


def test_faults_in_words() -> None:
    assert fault_words(4) == "fault 4 (absolute over current)"
    assert fault_words(33) == "fault 33 (absolute overspeed)"
    assert fault_words(200) == "fault 200"


def fragments(data: bytes, node: int = NODE) -> list[tuple[bool, bytes]]:
    parts = [(False, bytes((at,)) + data[at : at + 7]) for at in range(0, len(data), 7)]
    return [*parts, (True, struct.pack(">BBHH", node, 1, len(data), binascii.crc_hqx(data, 0)))]


def fed(answers: Answers, parts: list[tuple[bool, bytes]]) -> list[Answer]:
    found: list[Answer] = []
    for at, (is_end, data) in enumerate(parts):
        if is_end:
            answer = answers.process(data)
            found += [] if answer is None else [answer]
        else:
            answers.fill(data, at)
    return found


@given(st.binary(min_size=1, max_size=255))
def test_an_answer_of_any_length_comes_out_whole(data: bytes) -> None:
    assert fed(Answers({"torn_answers": 0}), fragments(data)) == [(NODE, data, 0)]


@given(st.binary(min_size=8, max_size=60), st.data())
def test_a_lost_or_changed_fragment_costs_that_answer_alone(data: bytes, choice: st.DataObject) -> None:
    counters = {"torn_answers": 0}
    answers = Answers(counters)
    parts = fragments(data)
    at = choice.draw(st.integers(0, len(parts) - 2))
    if choice.draw(st.booleans()):
        broken = [*parts[:at], *parts[at + 1 :]]
    else:
        first = bytes((parts[at][1][0], parts[at][1][1] ^ 1 << choice.draw(st.integers(0, 7))))
        broken = [*parts[:at], (False, first + parts[at][1][2:]), *parts[at + 1 :]]
    assert [answer.payload for answer in fed(answers, broken)] == [b""]
    assert counters["torn_answers"] > 0
    assert [answer.payload for answer in fed(answers, parts)] == [data]


@pytest.mark.parametrize("offset", [0, 1, 6, 8, 14])
def test_a_fragment_that_does_not_go_on_where_the_last_one_ended_tears_it(offset: int) -> None:
    counters = {"torn_answers": 0}
    answers = Answers(counters)
    answers.fill(bytes(8), 0)
    answers.fill(bytes((offset, 1)), 0)
    assert counters["torn_answers"] == 1


@given(st.lists(st.tuples(st.booleans(), st.binary(max_size=9)), max_size=60))
def test_any_fragments_are_counted_and_bounded(parts: list[tuple[bool, bytes]]) -> None:
    answers = Answers({"torn_answers": 0})
    fed(answers, parts)
    assert len(answers._payload) <= 255


def requests() -> tuple[Requests, dict[str, int]]:
    counters = dict.fromkeys(("requests_sent", "unanswered", "unasked"), 0)
    return Requests(counters), counters


@given(st.lists(st.booleans(), min_size=1, max_size=600), st.integers(1, 20))
def test_answers_find_their_requests_whatever_is_lost_and_however_long_the_path_is(lost: list[bool], late: int) -> None:
    asked, counters = requests()
    path: list[tuple[int, int] | None] = [None] * late
    for now, is_lost in enumerate(lost):
        path.append(None if is_lost else (asked.ask(now), now))
        if is_lost:
            asked.ask(now)
        arrives = path.pop(0)
        if arrives is not None:
            tag, sent = arrives
            assert asked.answer(tag) == sent
    assert counters["requests_sent"] == len(lost)
    assert counters["unanswered"] <= lost.count(True)
    assert counters["unasked"] == 0


def test_an_answer_that_comes_twice_is_unasked_the_second_time() -> None:
    asked, counters = requests()
    tags = [asked.ask(now) for now in range(3)]
    assert [asked.answer(tags[1]), asked.answer(tags[1]), asked.answer(tags[0])] == [1, None, None]
    assert counters == {"requests_sent": 3, "unanswered": 1, "unasked": 2}


@pytest.mark.parametrize("lost", [0, 1000])
def test_more_answers_than_requests_are_told_also_behind_many_that_were_lost(lost: int) -> None:
    asked, _ = requests()
    for now in range(lost):
        asked.ask(now)
    for now in range(200):
        asked.ask(now)
        asked.end()
        assert not asked.are_answered_too_often
    for now in range(80):
        asked.ask(now)
        asked.end()
        asked.end()
    assert asked.are_answered_too_often


def test_requests_that_nobody_answers_are_bounded() -> None:
    asked, counters = requests()
    for now in range(10_000):
        asked.ask(now)
    assert counters["unanswered"] == 10_000 - len(asked._pending)
    assert len(asked._pending) == 64


CONFIG = TurnsConfig(low_rev=-0.2, high_rev=0.6, speed_rev_per_s=10.0, period_ns=2 * MS, count_rev=1e-4)


@pytest.mark.parametrize(
    ("within_rev", "starts"), [(0.1, [0.1]), (0.9, [-0.1]), (0.59, [0.59]), (0.65, [0.65]), (0.75, [-0.25])]
)
def test_the_turn_at_the_start_is_that_which_the_limits_allow(within_rev: float, starts: list[float]) -> None:
    assert Turns(CONFIG).starts(within_rev) == pytest.approx(starts)


def test_limits_of_more_than_a_turn_leave_it_open() -> None:
    assert len(Turns(CONFIG._replace(high_rev=5.0)).starts(0.1)) == 2


@given(st.lists(st.floats(-0.019, 0.019), min_size=1, max_size=300), st.floats(0.0, 0.999))
def test_turns_are_counted_both_ways(steps: list[float], start: float) -> None:
    turns, angle = Turns(CONFIG), start
    turns.start(start, 0)
    for at, step in enumerate(steps, 1):
        angle += step  # up to 10 turns a second
        assert turns.follow(angle % 1.0, at * 2 * MS) == pytest.approx(angle, abs=1e-9)


def test_what_the_motor_can_not_have_done_is_none_and_a_gap_loses_the_turns() -> None:
    turns = Turns(CONFIG)
    turns.start(0.1, 0)
    reach = 10.0 * 6e-3 + 2e-4  # at 10 turns a second over the time and two periods more, and two counts
    assert turns.follow(0.1 + reach + 1e-6, 2 * MS) is None
    assert turns.angle_rev == 0.1
    assert turns.follow(0.1 + reach - 1e-6, 2 * MS) is not None
    assert not turns.is_lost(40 * MS)
    assert turns.is_lost(52 * MS)
    assert turns.follow(0.1, 52 * MS) is None


def trial_of(
    timeout_ms: int, fed_by_others_until_ms: int = -1000, limit_ms: int = 3000
) -> tuple[Stage, int, list[int]]:
    """Let a VESC's timeout be tried for 100 ms; return the stage at the end, when that was, and the orders."""
    trial, orders, fed_ms = TimeoutTrial(100 * MS), [], fed_by_others_until_ms
    for now in range(0, limit_ms, 2):
        if trial.is_due(now * MS):
            orders.append(now)
            fed_ms = now + 1
        if now < fed_by_others_until_ms:
            fed_ms = now
        looked = now // 10 * 10
        trial.see(timeout_ms > 0 and looked - fed_ms > timeout_ms, now * MS)
        if trial.stage is Stage.PASSED or trial.is_late(now * MS):
            return trial.stage, now, orders
    return trial.stage, limit_ms, orders


def test_a_timeout_as_it_was_said_is_passed_by_one_order() -> None:
    stage, at_ms, orders = trial_of(100)
    assert (stage, len(orders)) == (Stage.PASSED, 1)
    assert 100 < at_ms <= 100 + SLACK_NS // MS


@pytest.mark.parametrize("timeout_ms", [0, 200, 1000])
def test_a_timeout_that_is_off_or_longer_is_late(timeout_ms: int) -> None:
    stage, _, orders = trial_of(timeout_ms)
    assert stage is (Stage.EXPIRING if timeout_ms == 0 else Stage.WAITING)
    assert len(orders) == (timeout_ms > 0)


def test_a_drive_that_others_command_is_sent_nothing() -> None:
    stage, _, orders = trial_of(100, fed_by_others_until_ms=3000)
    assert (stage, orders) == (Stage.EXPIRING, [])
    stage, _, orders = trial_of(100, fed_by_others_until_ms=30)
    assert (stage, len(orders)) == (Stage.PASSED, 1)


def test_a_drive_that_takes_no_command_is_late() -> None:
    trial = TimeoutTrial(100 * MS)
    due = 0
    for now in range(0, 600, 2):
        due += trial.is_due(now * MS)
        trial.see(True, now * MS)
    assert due == 12
    assert trial.stage is Stage.FEEDING
    assert trial.is_late(600 * MS)
