"""What the gate did besides letting pass: how often, when first, by how much."""

from typing import NamedTuple

from hil_forceps.control.gate import GateVerdict

NOT_TOLD = frozenset({GateVerdict.OPENED, GateVerdict.PASSED})  # what is meant to be


class GateCount(NamedTuple):
    """One verdict over a run."""

    references: int
    first_ns: int  # of the trajectory's time; negative before the zero
    greatest_cut_rad: float  # between request and reference; 0 where none left or there was no request


class GateTally:
    """Counts by verdict."""

    def __init__(self) -> None:
        self.counts: dict[GateVerdict, GateCount] = {}

    def add(self, verdict: GateVerdict, t_ns: int, cut_rad: float) -> None:
        """Count one; `cut_rad` is NaN where nothing left."""
        number, first_ns, greatest_rad = self.counts.get(verdict, (0, t_ns, 0.0))
        self.counts[verdict] = GateCount(number + 1, first_ns, cut_rad if cut_rad > greatest_rad else greatest_rad)

    def told(self) -> dict[GateVerdict, GateCount]:
        """Return what a user is to know, in the order of the verdicts."""
        return {each: self.counts[each] for each in GateVerdict if each in self.counts and each not in NOT_TOLD}
