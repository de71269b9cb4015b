"""What is left counts where both looks find it over the same variable."""

import pytest

from hil_forceps.diagnosis.leftover import Leftover, seen_twice

FIRST = Leftover(40.0, 20.0, 90.0, (("motor", "time", 40.0), ("jaw", "omega", 18.0), ("wire", "theta", 4.0)))


def look(threshold: float, **gains: float) -> Leftover:
    families = sorted(
        [("motor", "time", gains["time"]), ("jaw", "omega", gains["omega"]), ("wire", "theta", gains["theta"])],
        key=lambda family: -family[2],
    )
    return Leftover(families[0][2], threshold, 50.0, tuple(families))


def test_what_only_one_look_finds_is_not_left_over() -> None:
    both = seen_twice(FIRST, look(10.0, time=2.0, omega=30.0, theta=1.0))
    assert both.families == (("jaw", "omega", 18.0), ("motor", "time", 4.0), ("wire", "theta", 2.0))
    assert (both.gain, both.threshold, both.total_gain, both.twice) == (18.0, 20.0, 50.0, True)
    assert not both.stands_out


def test_what_both_find_stands_out_from_a_lower_level() -> None:
    both = seen_twice(FIRST, look(10.0, time=15.0, omega=1.0, theta=1.0))
    assert both.gain == pytest.approx(30.0)
    assert both.stands_out
    assert FIRST.asks_for_another_look
    assert not FIRST.stands_out  # once, more is asked
