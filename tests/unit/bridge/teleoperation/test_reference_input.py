"""Which references count: stale, reordered, duplicated, wrong ones are counted and change nothing. In virtual time."""

import math
import random

import pytest

from hil_forceps.bridge.teleoperation.datagrams import ReferenceDatagram, Verdict
from hil_forceps.bridge.teleoperation.reference_input import InputState, ReferenceInput

MS = 1_000_000
SESSION = 77
TIMEOUT_NS = 50 * MS
SKEW_NS = 3_600_000_000_000_123  # of the sender's clock


class Sender:
    """Sends a reference every 10 ms by a clock of its own, 2 ms under way."""

    def __init__(self, taken: ReferenceInput, name: str = "joystick") -> None:
        self.taken, self.name, self.sequence, self.now_ns = taken, name, 0, 0

    def make(self, theta_rad: float = 1.0, sequence: int | None = None) -> ReferenceDatagram:
        number = self.sequence if sequence is None else sequence
        return ReferenceDatagram(SESSION, 0, number % (1 << 32), self.now_ns + SKEW_NS, theta_rad)

    def send(self, theta_rad: float = 1.0, delay_ns: int = 2 * MS) -> Verdict:
        verdict = self.taken.take(self.make(theta_rad), self.name, self.now_ns + delay_ns)
        self.sequence += 1
        self.now_ns += 10 * MS
        return verdict


@pytest.fixture
def taken() -> ReferenceInput:
    return ReferenceInput(SESSION, TIMEOUT_NS)


@pytest.fixture
def sender(taken: ReferenceInput) -> Sender:
    made = Sender(taken)
    for _ in range(20):
        assert made.send() is Verdict.ACCEPTED
    return made


def unchanged(taken: ReferenceInput) -> tuple[float, int]:
    return taken.theta_j_ref_rad, taken.counters["accepted"]


def test_before_anybody_sends_there_is_no_reference(taken: ReferenceInput) -> None:
    assert math.isnan(taken(0.0))
    assert taken.is_lost(0)
    assert taken.state is InputState.WAITING


def test_the_newest_is_in_force_and_held_until_the_next(taken: ReferenceInput, sender: Sender) -> None:
    sender.send(1.25)
    last_ns = sender.now_ns - 10 * MS + 2 * MS
    for later_ns in (0, 10 * MS, TIMEOUT_NS):
        assert taken(0.0) == 1.25
        assert not taken.is_lost(last_ns + later_ns)
    assert taken.is_lost(last_ns + TIMEOUT_NS + 1)
    assert "51 ms old, the limit is 50 ms" in taken.words(last_ns + 51 * MS)
    taken.release(last_ns + 51 * MS)
    assert taken.counters["lost"] == 1


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_refused(taken: ReferenceInput, sender: Sender, value: float) -> None:
    before = unchanged(taken)
    assert sender.send(value) is Verdict.NOT_FINITE
    assert unchanged(taken) == before
    assert taken.counters["not_finite"] == 1


def test_a_duplicate_and_one_that_was_overtaken_are_refused(taken: ReferenceInput, sender: Sender) -> None:
    before = unchanged(taken)
    again, older = sender.make(9.0, sender.sequence - 1), sender.make(9.0, sender.sequence - 2)
    assert taken.take(again, sender.name, sender.now_ns) is Verdict.DUPLICATE
    assert taken.take(older, sender.name, sender.now_ns) is Verdict.REORDERED
    assert unchanged(taken) == before
    assert (taken.counters["duplicate"], taken.counters["reordered"]) == (1, 1)


def test_a_sequence_goes_on_past_its_end_and_gaps_are_counted(taken: ReferenceInput) -> None:
    made = Sender(taken)
    made.sequence = (1 << 32) - 2
    assert [made.send() for _ in range(4)] == [Verdict.ACCEPTED] * 4
    made.sequence += 3
    assert made.send() is Verdict.ACCEPTED
    assert taken.counters["missing"] == 3


def test_one_that_was_too_long_under_way_is_refused(taken: ReferenceInput, sender: Sender) -> None:
    before = unchanged(taken)
    assert sender.send(9.0, 2 * MS + TIMEOUT_NS + 1) is Verdict.STALE
    assert unchanged(taken) == before
    assert sender.send(1.5, 2 * MS + TIMEOUT_NS) is Verdict.ACCEPTED


def test_a_late_one_is_as_old_as_its_stamp_says(taken: ReferenceInput, sender: Sender) -> None:
    """Else references that come 45 ms late each would be held for 95 ms."""
    sent_ns = sender.now_ns
    assert sender.send(1.5, 2 * MS + 45 * MS) is Verdict.ACCEPTED
    assert not taken.is_lost(sent_ns + 2 * MS + TIMEOUT_NS)
    assert taken.is_lost(sent_ns + 2 * MS + TIMEOUT_NS + 1)


def test_a_clock_that_steps_back_loses_the_references(taken: ReferenceInput, sender: Sender) -> None:
    stepped = sender.make()._replace(stamp_ns=sender.now_ns)
    assert taken.take(stepped, sender.name, sender.now_ns) is Verdict.STALE


def test_another_session_is_refused(taken: ReferenceInput, sender: Sender) -> None:
    for session in (0, SESSION + 1):
        other = sender.make()._replace(session=session)
        assert taken.take(other, sender.name, sender.now_ns) is Verdict.WRONG_SESSION
    assert taken.counters["wrong_session"] == 2


def test_a_second_sender_gets_nothing_while_the_first_sends(taken: ReferenceInput, sender: Sender) -> None:
    second = Sender(taken, "planner")
    second.now_ns = sender.now_ns
    assert second.send(9.0) is Verdict.OTHER_SENDER
    assert taken(0.0) == 1.0


def test_without_torque_a_silent_sender_makes_room_for_another(taken: ReferenceInput, sender: Sender) -> None:
    taken.release(sender.now_ns)
    assert not math.isnan(taken(0.0))
    taken.release(sender.now_ns + TIMEOUT_NS)
    assert math.isnan(taken(0.0))
    second = Sender(taken, "planner")
    second.now_ns = sender.now_ns + 2 * TIMEOUT_NS
    assert second.send(0.7) is Verdict.ACCEPTED
    assert taken(0.0) == 0.7


def test_wrong_calls_raise() -> None:
    for session, timeout_ns in ((0, 1), (1 << 64, 1), (1, 0)):
        with pytest.raises(ValueError, match="must be positive"):
            ReferenceInput(session, timeout_ns)


@pytest.mark.parametrize("seed", range(20))
def test_whatever_a_network_does_the_reference_is_one_that_was_sent_lately(seed: int) -> None:
    """Delay, loss, reordering, doubling: never an older reference behind a newer, none older than the timeout."""
    chance = random.Random(seed)
    taken = ReferenceInput(SESSION, TIMEOUT_NS)
    arrivals = []
    for sequence in range(400):
        sent_ns = sequence * 10 * MS
        for _ in range(chance.choice((0, 1, 1, 1, 2))):
            jam_ns = 70 * MS if sequence % 100 >= 80 else 0
            delay_ns = 2 * MS + jam_ns + chance.choice((0, 0, 1 * MS, 15 * MS, 120 * MS))
            datagram = ReferenceDatagram(SESSION, 0, sequence, sent_ns - SKEW_NS, float(sequence))
            arrivals.append((sent_ns + delay_ns, datagram))
    before = -1.0
    counted = 0
    for now_ns, datagram in sorted(arrivals, key=lambda each: each[0]):
        taken.take(datagram, "joystick", now_ns)
        counted += 1
        if taken.is_lost(now_ns):
            continue
        assert taken(0.0) >= before
        before = taken(0.0)
        assert now_ns - before * 10 * MS <= TIMEOUT_NS + 2 * MS + 1 * MS  # and the quickest took 2 to 3 ms
    refused = sum(taken.counters[verdict.name.lower()] for verdict in Verdict if verdict)
    assert taken.counters["accepted"] + refused == counted
    assert min(taken.counters[name] for name in ("duplicate", "reordered", "stale", "missing")) > 0
