"""Hidden effects are sized by what the filter's innovations show of them in a case's own runs."""

from dataclasses import replace

import pytest

from tests.hidden_effects.drawn_cases import Drawn, draw, even_parts, hidden, make
from tests.hidden_effects.own_sizes import TOLERANCE, own_size, sized

CASE = replace(
    draw("effect", 15300, usual=True), motions=("multisine_mid", "trapezoid"), held_out=0, friction=0.1, counts=16384
)


def case_of(effect_id: str, **changes: object) -> Drawn:
    changed: Drawn = replace(CASE, effects=(effect_id,), **changes)  # type: ignore[arg-type]
    return changed


@pytest.mark.parametrize(("effect_id", "size"), [("cogging", 12.0), ("wire_slack", 20.0), ("channel_skew", 20.0)])
def test_a_case_shows_as_much_as_was_wanted(effect_id: str, size: float) -> None:
    made = make(case_of(effect_id, size=size))
    fitted, _ = even_parts(made)
    assert own_size(fitted, made.assumed, made.true, effect_id) == pytest.approx(size, rel=TOLERANCE)


def test_what_dry_friction_hides_is_made_larger() -> None:
    free, stuck = (hidden(case_of("transmission_play", size=20.0, friction=share)) for share in (0.0, 0.1))
    ratio = stuck["transmission_play"]["half_width_rad"] / free["transmission_play"]["half_width_rad"]
    assert ratio > 2.0


def test_what_no_size_shows_is_refused() -> None:
    with pytest.raises(ValueError, match="no size of wire_slack gives d = 20"):
        sized(20.0, "wire_slack", {"half_width_m": 1e-6}, lambda _: 1.0)


def test_the_size_is_found_where_d_jumps() -> None:
    """As a current that saturates: nothing, then much."""
    found = sized(20.0, "wire_slack", {"half_width_m": 1e-6}, lambda e: 5e5 * e["wire_slack"]["half_width_m"] ** 0.5)
    assert found["wire_slack"]["half_width_m"] == pytest.approx((20.0 / 5e5) ** 2, rel=0.35)
