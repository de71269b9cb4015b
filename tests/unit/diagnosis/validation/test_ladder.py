"""The gain of a step of the ladder."""

from itertools import pairwise

import pytest

from hil_forceps.diagnosis.driven.ladder import step_gains


def test_gain_of_a_step_is_its_share_of_what_the_noise_leaves() -> None:
    first, before, after = {"a": 5.0, "b": 2.0}, {"a": 4.0, "b": 2.0}, {"a": 3.0, "b": 2.5}
    found = step_gains(first, before, after, {"a": 3.0, "b": 0.0})
    assert found["a"] == pytest.approx((16.0 - 9.0) / (25.0 - 9.0))
    assert found["b"] == pytest.approx((4.0 - 6.25) / 4.0)  # it made this channel worse


def test_all_steps_together_explain_what_is_left_above_the_floor() -> None:
    rungs = [{"a": 5.0}, {"a": 4.0}, {"a": 3.5}, {"a": 3.0}]
    gains = [step_gains(rungs[0], x, y, {"a": 3.0})["a"] for x, y in pairwise(rungs)]
    assert sum(gains) == pytest.approx(1.0)


def test_where_noise_is_all_there_is_nothing_is_gained() -> None:
    assert step_gains({"a": 1.0}, {"a": 1.0}, {"a": 0.9}, {"a": 2.0}) == {"a": 0.0}
