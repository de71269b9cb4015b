"""What every estimator is: pure functions from (state, sample) to state, and a view of the state."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

State = NDArray[np.float64]

# Where the states of our own estimators keep what they tell; the rest of a state is each one's own.
TAU_W, ELONGATION = 3, 4


class Sample(NamedTuple):
    """What the drive measured at one instant."""

    time_ns: int  # the drive's own stamp, unwrapped, strictly increasing
    theta_m_rad: float
    motor_torque_N_m: float  # K_t·i, held over the interval that ended at `time_ns`


class Estimate(NamedTuple):
    """What an estimator knows after a sample."""

    tau_w_N_m: float
    elongation_m: float


class Compiled(NamedTuple):
    """The kernels behind an estimator, for loops that run compiled."""

    kind: int  # which kernels: `single`
    constants: NDArray[np.float64]


Record = Callable[[NDArray[np.int64], State, State], tuple[State, State]]


@dataclass(frozen=True, slots=True)
class Estimator:
    """One algorithm with its parameters bound.

    `start` makes a state from the first sample (at rest, load unknown), `step` takes the next sample, whatever time
    has passed since the last (gaps are bridged, never ignored; a stamp that isn't later leaves the state as it is),
    `estimate` reads the state. All are pure; a state is never changed in place. Not finite numbers come out as they
    are: the gate stops them. `compiled` is there where `batch` can run the same kernels in a compiled loop; `record`
    where an estimator with corrections has a loop of its own: stamps [ns], θ_m, motor torque -> τ̂_w, x̂.
    """

    id: str
    start: Callable[[Sample], State]
    step: Callable[[State, Sample], State]
    estimate: Callable[[State], Estimate]
    compiled: Compiled | None = None
    record: Record | None = None
