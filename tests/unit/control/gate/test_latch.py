"""The table of states: written out once more, and its rules."""

import itertools

import pytest

from hil_forceps.control.gate.latch import TRANSITIONS, GateEvent, GateState

S, E = GateState, GateEvent
LEADS_ELSEWHERE = {
    (S.CLOSED, E.OPENED): S.OPEN,
    (S.OPEN, E.REFUSED): S.CLOSED,
    (S.OPEN, E.GAP): S.CLOSED,
    (S.OPEN, E.EXCEEDED): S.FROZEN,
    (S.OPEN, E.IMPLAUSIBLE): S.FAILING,
    (S.FROZEN, E.GAP): S.LATCHED,
    (S.FROZEN, E.RECOVERED): S.OPEN,
    (S.FROZEN, E.IMPLAUSIBLE): S.FAILING,
    (S.FROZEN, E.HELD_TOO_LONG): S.LATCHED,
    (S.FAILING, E.GAP): S.LATCHED,
    (S.FAILING, E.HELD_TOO_LONG): S.LATCHED,
    (S.LATCHED, E.CLEARED): S.CLOSED,
}


@pytest.mark.parametrize(("state", "event"), list(itertools.product(GateState, GateEvent)))
def test_every_state_meets_every_event(state: GateState, event: GateEvent) -> None:
    assert TRANSITIONS[state][event] is LEADS_ELSEWHERE.get((state, event), state)


def test_open_is_reached_by_opening_and_by_recovering_alone() -> None:
    ways = {(state, event) for state in S for event in E if state is not S.OPEN and TRANSITIONS[state][event] is S.OPEN}
    assert ways == {(S.CLOSED, E.OPENED), (S.FROZEN, E.RECOVERED)}


def test_a_latch_is_left_by_clearing_alone() -> None:
    assert {event for event in E if TRANSITIONS[S.LATCHED][event] is not S.LATCHED} == {E.CLEARED}
    assert TRANSITIONS[S.LATCHED][E.CLEARED] is S.CLOSED
