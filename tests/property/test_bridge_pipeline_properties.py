"""Whatever arrives, whenever: nothing leaves that is not fresh, new, finite and passed by the gate."""

import math
from typing import NamedTuple

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from firmware_protocol.host.samples import RawSample
from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_RAD
from hil_forceps.bridge.pipeline import Pipeline
from hil_forceps.control.gate import Gate, GateVerdict
from hil_forceps.estimation.interface import Estimate, Estimator, Sample, State
from hil_forceps.rig.plant import PlantParameters
from hil_forceps.rig.sections import Limits

PLANT = PlantParameters(2.0e-3, 1.4e-3, 3.18e-8, 6.85e-8, 1.16e-4, 4.62e-7, 4.62e-9, 2.6e4, 1.35e-2)
LIMITS = Limits(position_min_rad=-1.0, position_max_rad=3.0, speed_max_rad_per_s=50.0, acceleration_max_rad_per_s2=1e5)
MAX_AGE_NS = 3_000_000


class Step(NamedTuple):
    """Time passes, samples come, a tick happens."""

    wait_us: int
    samples: tuple[tuple[int, int, float], ...]  # stamp ahead of the last [µs, may be negative], angle, elongation
    delay_us: int
    state: DriveState


elongations = st.one_of(st.floats(-1e-3, 1e-3), st.sampled_from([math.nan, math.inf, -math.inf, 1e300]))
steps = st.builds(
    Step,
    wait_us=st.integers(0, 6_000),
    samples=st.lists(st.tuples(st.integers(-500, 2_000), st.integers(-1_000, 10_000_000), elongations), max_size=3).map(
        tuple
    ),
    delay_us=st.integers(0, 6_000),
    state=st.sampled_from(DriveState),
)


class SpyGate(Gate):
    """Remember the last word."""

    passed_rad: float | None = None
    asked = 0

    def step(self, requested_rad: float, now_ns: int) -> tuple[float | None, GateVerdict]:
        result = super().step(requested_rad, now_ns)
        self.passed_rad = result[0]
        self.asked += 1
        return result


@given(st.lists(steps, max_size=40), st.booleans())
@example([Step(0, ((0, 0, 1e300),), 0, DriveState.OPERATIONAL)], True)  # an approach that would never end
def test_nothing_leaves_but_what_is_fresh_new_and_passed(script: list[Step], compensate: bool) -> None:
    taken: list[int] = []
    elongation_m: dict[int, float] = {}

    def start(sample: Sample) -> State:
        taken.append(sample.time_ns)
        return np.array([float(len(taken) - 1)])

    def known(state: State) -> Estimate:
        return Estimate(0.0, elongation_m[taken[int(state[0])]])

    gate = SpyGate(LIMITS)
    estimator = Estimator("script", start, lambda _, sample: start(sample), known)
    line = Pipeline(estimator, lambda t_s: 1.0 - 0.3 * t_s, PLANT, gate, compensate, 3e-3, same_clock=True)
    now_ns = stamp_ns = 10_000_000
    expected: list[int] = []
    answered = 0
    for step in script:
        now_ns += step.wait_us * 1_000
        for ahead_us, theta_m, elongation in step.samples:
            this_ns = min(stamp_ns + ahead_us * 1_000, now_ns)
            elongation_m.setdefault(this_ns, elongation)
            received_ns = min(this_ns + step.delay_us * 1_000, now_ns)
            line.feed(RawSample(0, this_ns, theta_m, 0, step.state, 0, 0, received_ns))
            if not expected or this_ns > expected[-1]:
                expected.append(this_ns)
                stamp_ns = this_ns
        asked = gate.asked
        reference = line.reference(now_ns)
        assert taken == expected, "each new sample once, in order"
        if reference.reference_raw is None:
            continue
        assert gate.asked == asked + 1
        assert gate.passed_rad is not None
        assert reference.reference_raw == round(gate.passed_rad / ANGLE_LSB_RAD)
        assert LIMITS.position_min_rad <= gate.passed_rad <= LIMITS.position_max_rad
        assert now_ns - expected[-1] <= MAX_AGE_NS
        assert len(expected) > answered, "a reference of its own for a sample of its own"
        answered = len(expected)
