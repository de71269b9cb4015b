"""Interface of all estimators: pure functions from (state, sample) to state, and a view of the state."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.estimation.kernel_function import KernelFunction
from hil_forceps.rig.schema import Rig

Vector = NDArray[np.float64]
State = Vector

_new: Final = tuple.__new__  # makes a NamedTuple in half the time of its constructor

# Places of the estimates in a state of our own estimators; the rest of a state is private.
TAU_W, ELONGATION = 3, 4


class Sample(NamedTuple):
    """What the drive measured at one instant."""

    time_ns: int  # the drive's own stamp, unwrapped, strictly increasing
    theta_m_rad: float
    motor_torque_N_m: float  # K_t·i, held over the interval that ended at `time_ns`


class Estimate(NamedTuple):
    """Estimates after a sample."""

    tau_w_N_m: float
    elongation_m: float


class Compiled(NamedTuple):
    """The kernels behind an estimator, for loops that run compiled."""

    start: KernelFunction  # constants, time_ns, θ_m, motor torque -> state
    step: KernelFunction  # state, constants, time_ns, θ_m, motor torque -> state
    constants: Vector


Record = Callable[[NDArray[np.int64], State, State], tuple[State, State]]


@dataclass(frozen=True, slots=True)
class Estimator:
    """One algorithm with its parameters bound.

    `start` makes a state from the first sample (at rest, load unknown). `step` takes the next sample after any
    interval; a stamp that isn't later leaves the state as it is. `estimate` reads the state. All are pure; a state is
    never changed in place. Values that aren't finite pass through; the gate stops them. `compiled`: for a compiled loop
    in `batch`. `record`: the loop of an estimator with corrections: stamps [ns], θ_m, motor torque -> τ̂_w, x̂.
    """

    id: str
    start: Callable[[Sample], State]
    step: Callable[[State, Sample], State]
    estimate: Callable[[State], Estimate]
    compiled: Compiled | None = None
    record: Record | None = None


class Algorithm(NamedTuple):
    """What a file of `algorithms` offers: how to make its estimator for a rig, and what that does about effects.

    `make(rig, sample_time_s, over_wire)`: `sample_time_s` is the nominal time between samples; `over_wire`: these are
    rounded as by the protocol. UserError when the rig doesn't know a value that is needed.
    """

    id: str
    make: Callable[[Rig, float, bool], Estimator]
    corrected: bool = False  # its samples are corrected for effects of the rig (`corrections`)
    models: frozenset[str] = frozenset()  # effects in its own model


def estimator_of_kernels(
    estimator_id: str,
    start: Callable[[Vector, int, float, float], State],
    step: Callable[[State, Vector, int, float, float], State],
    constants: Vector,
) -> Estimator:
    """Return an estimator whose steps are kernels: the same ones serve single samples and compiled loops."""

    def start_(sample: Sample) -> State:
        return start(constants, *sample)

    def step_(state: State, sample: Sample) -> State:
        time_ns, theta_m_rad, motor_torque_N_m = sample
        return step(state, constants, time_ns, theta_m_rad, motor_torque_N_m)

    kernels = Compiled(KernelFunction.of_start(start), KernelFunction.of_step(step), constants)
    return Estimator(estimator_id, start_, step_, _estimate, kernels)


def _estimate(state: State) -> Estimate:
    number = state.item  # a Python float in a fifth of the time of `float(state[...])`
    return _new(Estimate, (number(TAU_W), number(ELONGATION)))
