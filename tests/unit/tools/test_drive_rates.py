"""The largest rate that a line carries: foretold from bits, and what is tried doesn't go beyond it."""

import pytest

from hil_forceps.rig import load_rig
from tools.drives.drive_costs import RIGS
from tools.drives.drive_rates import at_period, computed_Hz, is_carried


@pytest.mark.parametrize(
    ("name", "carried_s", "lost_s"),
    [("odrive", 1e-3, 5e-4), ("cia402", 1e-3, 5e-4), ("vesc", 1e-3, 8e-4), ("moteus", 5e-4, None)],
)
def test_what_is_tried_is_within_what_is_computed(name: str, carried_s: float, lost_s: float | None) -> None:
    rig = load_rig(RIGS[name])
    assert is_carried(at_period(rig, carried_s))
    assert computed_Hz(rig) >= 1.0 / carried_s
    if lost_s is not None:
        assert not is_carried(at_period(rig, lost_s))


def test_half_the_bits_take_twice_the_rate() -> None:
    rig = load_rig(RIGS["odrive"])
    slow = rig.with_changes({"bench.bitrate_bit_per_s": 500_000})
    assert computed_Hz(rig) == pytest.approx(2.0 * computed_Hz(slow))
