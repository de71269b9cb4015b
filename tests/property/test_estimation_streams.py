"""Whatever the stamps, the encoder and the beliefs, estimates of a finite stream stay finite and honest."""

from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hil_forceps.estimation.algorithms import kalman
from hil_forceps.estimation.interface import Sample
from hil_forceps.estimation.registry import make_estimator
from hil_forceps.rig import load_rig

RIG = load_rig(Path(__file__).parents[2] / "configs" / "paper.yaml")

waits_ns = st.one_of(
    st.integers(900_000, 1_100_000),
    st.integers(1, 10_000).map(lambda us: us * 1000),  # the wire's stamps count microseconds
    st.sampled_from([1000, 500_000, 1_000_000, 1_500_001, 250_000_000, 10**9, 60 * 10**9, 0, -1_000_000]),
)
counts = st.one_of(st.none(), st.sampled_from([500, 4096, 16384, 2**24]))
factors = st.floats(0.5, 2.0)
streams = st.lists(st.tuples(waits_ns, st.floats(-3.0, 3.0), st.floats(-0.05, 0.05)), min_size=2, max_size=60)


@settings(max_examples=60)
@given(st.sampled_from(["previous", "improved", "kalman"]), counts, factors, factors, streams)
def test_finite_in_finite_out(
    name: str, count: int | None, stiffness: float, inertia: float, stream: list[tuple[int, float, float]]
) -> None:
    rig = RIG.with_changes(
        {
            "encoder.counts_per_rev": "ideal" if count is None else count,
            "forceps.wire_stiffness_N_per_m": 2.6e4 * stiffness,
            "forceps.jaw_inertia_kg_m2": 6.85e-8 * inertia,
        }
    )
    estimator = make_estimator(name, rig, 1e-3)
    now_ns = 0
    state = estimator.start(Sample(0, stream[0][1], stream[0][2]))
    last_ns = 0
    for wait_ns, theta, torque in stream[1:]:
        now_ns += wait_ns
        after = estimator.step(state, Sample(now_ns, theta, torque))
        if now_ns <= last_ns:
            assert np.array_equal(after, state)
        last_ns = max(last_ns, now_ns)
        state = after
        assert np.isfinite(state).all()
        if name == "kalman":
            fresh, settling = state[kalman.FRESH_WEIGHT], state[kalman.SETTLING_WEIGHT]
            assert min(fresh, settling, 1.0 - fresh - settling) >= 0.0
            for block in state[6:].reshape(3, 30):
                assert (np.diag(block[5:].reshape(5, 5)) >= 0.0).all()
    # Whatever it was, half a second of rest is enough to know it for that.
    theta = stream[-1][1]
    for n in range(1, 501):
        state = estimator.step(state, Sample(last_ns + n * 1_000_000, theta, 0.0))
    tau_w, elongation_m = estimator.estimate(state)
    assert abs(tau_w) < 2e-5
    assert abs(elongation_m) < 2e-6
