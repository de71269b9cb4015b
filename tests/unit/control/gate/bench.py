"""A gate in each of its states, and what brings it there."""

import math
from collections.abc import Callable
from typing import Any

from hil_forceps.control.gate import DEFAULT_MAX_GAP_S, Gate, GateState, GateVerdict
from hil_forceps.control.gate.bounds import FeedbackBounds
from hil_forceps.rig.plant import PlantParameters
from hil_forceps.rig.sections import Limits

MS = 1_000_000
GAP_NS = round(DEFAULT_MAX_GAP_S * 1e9)
HOLD_NS = 50 * MS
LSB_RAD = 2.0 * math.pi / (1 << 24)
LIMITS = Limits(
    position_min_rad=-1.0, position_max_rad=2.0, speed_max_rad_per_s=10.0, acceleration_max_rad_per_s2=1000.0
)
PLANT = PlantParameters(2.0e-3, 1.4e-3, 3.18e-8, 6.85e-8, 1.16e-4, 4.62e-7, 4.62e-9, 2.6e4, 1.35e-2)
FEEDBACK = FeedbackBounds(
    plant=PLANT,
    jump_speed_rad_per_s=100.0,
    jump_slack_rad=0.01,
    still_s=0.1,
    still_travel_rad=0.02,
    still_travel_alone_rad=0.5,
    strong_A=0.5,
    against_travel_rad=0.3,
    tension_max_N=5.0,
    current_max_A=0.8,
    hold_s=HOLD_NS * 1e-9,
)
S, V = GateState, GateVerdict


class Bench:
    """A gate with its time; a sample comes each millisecond and is asked about at once."""

    def __init__(self, theta: float = 0.0, feedback: FeedbackBounds | None = FEEDBACK, **limits: float) -> None:
        self.gate = Gate(LIMITS.model_copy(update=limits), feedback)
        self.now_ns, self.theta = 0, theta
        self.gate.see(0, 0, theta, 0.0)
        self.gate.open(0)

    def sample(self, theta: float | None = None, current: float = 0.0, wait_ns: int = MS) -> None:
        self.now_ns += wait_ns
        self.theta = self.theta if theta is None else theta
        self.gate.see(self.now_ns, self.now_ns, self.theta, current)

    def tick(self, requested: float, theta: float | None = None, current: float = 0.0, wait_ns: int = MS) -> Any:
        self.sample(theta, current, wait_ns)
        return self.gate.step(requested, self.now_ns)


def closed() -> Bench:
    bench = Bench()
    bench.gate = Gate(LIMITS, FEEDBACK)
    bench.gate.see(0, 0, 0.0, 0.0)
    return bench


def running(**limits: float) -> Bench:
    bench = Bench(feedback=FEEDBACK, **limits)
    assert bench.tick(0.0) == (0.0, V.OPENED)
    return bench


def frozen() -> Bench:
    """Eight samples with too much current."""
    bench = running()
    bench.gate._monitor.restart(bench.now_ns, 0.0)  # type: ignore[union-attr]
    for _ in range(7):
        assert bench.tick(0.0, current=0.9) == (0.0, V.PASSED)
    assert bench.tick(0.3, current=0.9) == (0.0, V.FROZEN)
    return bench


def failing() -> Bench:
    bench = running()
    assert bench.tick(0.3, theta=0.2) == (0.0, V.FROZEN)
    return bench


def latched() -> Bench:
    bench = failing()
    while bench.gate.state is S.FAILING:
        bench.tick(0.3)
    return bench


BENCHES: dict[GateState, Callable[[], Bench]] = {
    S.CLOSED: closed, S.OPEN: running, S.FROZEN: frozen, S.FAILING: failing, S.LATCHED: latched
}  # fmt: skip


def neighbours(value: float) -> list[float]:
    """The value, a float and a unit of the wire to each side of it, and small and large parts of it."""
    off = (0.0, LSB_RAD, -LSB_RAD, *(sign * part * (abs(value) + 1e-3) for sign in (-1, 1) for part in (1e-9, 1e-3, 1)))
    return [math.nextafter(value, -math.inf), math.nextafter(value, math.inf), *(value + each for each in off)]
