"""A quick part of the campaign: a few hidden effects, and data in which none must be found; judged by count."""

import pytest

from tests.hidden_effects.cases import Spec
from tests.hidden_effects.tally import Record, in_set, named_right
from tests.hidden_effects.trial import run_case

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]


def ran(spec: Spec, *, gain: bool = False) -> Record:
    record = run_case(spec, gain=gain, whole=False)
    assert "error" not in record
    assert "skipped" not in record
    return record


def test_a_hidden_effect_is_found_and_explained() -> None:
    record = ran(Spec("cogging", "effect", ("cogging",), 50.0, 7, "mixed"), gain=True)
    assert named_right(record), (record["verdict"], record["named"])
    share, before, after, possible = record["explained"]["whitened"]
    assert min(share, possible) > 0.95
    assert after < before


@pytest.mark.long
def test_a_hidden_slack_is_found() -> None:
    record = ran(Spec("slack", "effect", ("wire_slack",), 50.0, 7, "mixed"))
    assert named_right(record) or in_set(record), (record["verdict"], record["named"])


def test_no_effect_and_a_shift_alone_are_no_cause() -> None:
    # Of the first, the load's corners, which smoothing bends, look like a drift of friction until it is smoothed less.
    records = [
        ran(Spec("corners", "none", (), 0.0, 10603, "mixed", "coloured")),
        ran(Spec("shift", "shift", (), 0.0, 7, "mixed", shifted=True)),
    ]
    assert [record["named"] for record in records] == [[], []]
    assert [record["verdict"] in {"consistent", "parameters"} for record in records] == [True, True]


def test_an_effect_that_no_entry_describes_is_not_called_by_another_s_name() -> None:
    record = ran(Spec("deleted", "deleted", ("wire_slack",), 50.0, 7, "mixed", deleted=True))
    assert record["verdict"] == "unnamed"
    assert record["named"] == []


def test_runs_that_say_nothing_are_undetermined() -> None:
    record = ran(Spec("rest", "uninformative", ("wire_slack",), 20.0, 7, "rest"))
    assert record["verdict"] == "undetermined"
    assert record["reasons"]
