"""The reaction torque τ_w that the world puts on the jaw, as a piecewise-linear function of time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from virtual_bus.kernel import kernel

PAPER_TORQUE_N_M = 2.0e-3


@dataclass(frozen=True, slots=True, eq=False)
class LoadProfile:
    """τ_w over time since the first operational sample; two breakpoints at one time make a step.

    Before the first breakpoint (and so before the experiment) its torque holds, after the last one that. At a step the
    later value counts.
    """

    time_ns: NDArray[np.int64]  # (n,), n >= 1, never decreasing
    torque_N_m: NDArray[np.float64]  # (n,)

    def torque_at(self, time_ns: int) -> float:
        """Return τ_w in N m at this time since zero."""
        return float(load_at(self.time_ns, self.torque_N_m, segment_of(self.time_ns, time_ns), time_ns))


def piecewise_linear(time_s: Sequence[float], torque_N_m: Sequence[float]) -> LoadProfile:
    """Make a profile of breakpoints in seconds and N m; ValueError when they don't make one."""
    times = np.asarray(time_s, dtype=np.float64)
    torques = np.array(torque_N_m, dtype=np.float64)
    if times.ndim != 1 or times.size == 0 or times.shape != torques.shape:
        raise ValueError("a load profile needs as many times as torques, and at least one")
    if not (np.isfinite(times).all() and np.isfinite(torques).all()):
        raise ValueError("a load profile needs finite times and torques")
    if np.abs(times).max() > 1.0e9:
        raise ValueError("a load profile must lie within 1e9 s")
    if (np.diff(times) < 0.0).any():
        raise ValueError("the times of a load profile must not decrease")
    times_ns = np.rint(times * 1.0e9).astype(np.int64)
    times_ns.setflags(write=False)
    torques.setflags(write=False)
    return LoadProfile(times_ns, torques)


def paper_load(simulation: int) -> LoadProfile:
    """Return the load of the paper's simulation 1 or 2, or none for 0; ValueError for any other."""
    full = PAPER_TORQUE_N_M
    if simulation == 0:
        return piecewise_linear([0.0], [0.0])
    if simulation == 1:
        return piecewise_linear([10.0, 15.0], [0.0, full])
    if simulation == 2:
        edges = [10.0, 12.5, 15.0, 17.5]
        return piecewise_linear([t for t in edges for _ in range(2)], [0.0, full, full, 0.0] * 2)
    raise ValueError(f"the paper has simulations 1 and 2 (0 is no load), not {simulation}")


@kernel
def segment_of(load_time_ns: NDArray[np.int64], time_ns: int) -> int:
    """Return the number of breakpoints at or before `time_ns`: the index of the next one."""
    first, end = 0, load_time_ns.size
    while first < end:
        middle = (first + end) // 2
        if load_time_ns[middle] <= time_ns:
            first = middle + 1
        else:
            end = middle
    return first


@kernel
def load_at(load_time_ns: NDArray[np.int64], load_N_m: NDArray[np.float64], segment: int, time_ns: int) -> float:
    """Return τ_w on the line of a segment of `segment_of`; at its end the limit from within, before any step."""
    if segment == 0:
        return float(load_N_m[0])
    left = float(load_N_m[segment - 1])
    if segment == load_time_ns.size:
        return left
    left_ns, right_ns = load_time_ns[segment - 1], load_time_ns[segment]
    share = (time_ns - left_ns) / (right_ns - left_ns)
    return left + float(share) * (float(load_N_m[segment]) - left)
