"""What the gate did, counted: how often, when first, by how much."""

import math

from hil_forceps.bridge.gate_tally import GateCount, GateTally
from hil_forceps.control.gate import GateVerdict


def test_each_verdict_has_its_count_its_first_time_and_its_greatest_cut() -> None:
    tally = GateTally()
    tally.add(GateVerdict.OPENED, -1, 0.0)
    tally.add(GateVerdict.DENIED_GAP, 5, math.nan)
    tally.add(GateVerdict.LIMITED_SPEED, 7, 0.25)
    tally.add(GateVerdict.LIMITED_SPEED, 8, 0.5)
    tally.add(GateVerdict.LIMITED_SPEED, 9, math.nan)
    tally.add(GateVerdict.LIMITED_SPEED, 10, 0.125)
    assert tally.told() == {
        GateVerdict.LIMITED_SPEED: GateCount(4, 7, 0.5),
        GateVerdict.DENIED_GAP: GateCount(1, 5, 0.0),
    }
    tally.add(GateVerdict.FROZEN, 11, 0.0, "tension")
    tally.add(GateVerdict.FROZEN, 12, 0.0, "current")
    tally.add(GateVerdict.FROZEN, 13, 0.0, "tension")
    assert tally.counts.pop(GateVerdict.FROZEN) == GateCount(3, 11, 0.0, ("tension", "current"))
    assert list(tally.told()) == [GateVerdict.LIMITED_SPEED, GateVerdict.DENIED_GAP], "in the order of the verdicts"
    assert GateTally().told() == {}
