"""What the gate did besides letting pass: how often, when first, by how much."""

from typing import NamedTuple

from hil_forceps.control.gate import GateVerdict

NOT_TOLD = frozenset({GateVerdict.OPENED, GateVerdict.PASSED})  # what is meant to be


class GateCount(NamedTuple):
    """One verdict over a run."""

    references: int
    first_ns: int  # host's clock
    greatest_cut_rad: float  # between request and reference; 0 where none left or there was no request
    checks: tuple[str, ...] = ()  # of the feedback, that said so


class GateTally:
    """Counts by verdict."""

    def __init__(self) -> None:
        self.counts: dict[GateVerdict, GateCount] = {}

    def add(self, verdict: GateVerdict, now_ns: int, cut_rad: float, check: str = "") -> None:
        """Count one; `cut_rad` is NaN where nothing left, `check` the one of the feedback that holds the reference."""
        number, first_ns, greatest_rad, checks = self.counts.get(verdict, (0, now_ns, 0.0, ()))
        if check and check not in checks:
            checks = (*checks, check)
        greatest_rad = cut_rad if cut_rad > greatest_rad else greatest_rad
        self.counts[verdict] = GateCount(number + 1, first_ns, greatest_rad, checks)

    def told(self) -> dict[GateVerdict, GateCount]:
        """Return what a user is to know, in the order of the verdicts."""
        return {each: self.counts[each] for each in GateVerdict if each in self.counts and each not in NOT_TOLD}
