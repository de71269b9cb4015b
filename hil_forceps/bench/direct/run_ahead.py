"""A run without the bus that runs ahead of the gate: compiled as far as the gate will let everything pass, then asked.

A gate whose limits are meant never to shape the motion passes nearly every reference as it was requested. So world,
estimator and (10) run on as if it did, a block of samples at a time and compiled, and then the gate itself sees these
samples and is asked for these references, one by one. Where it changes one, the block is run once more up to there, and
on from what the gate let pass. So the gate decides about every reference, and the results are those of the plain loop.
Where it changes many, the plain loop is faster: `pays` tells.
"""

from collections.abc import Callable
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from numba import types
from numpy.typing import NDArray

from hil_forceps.bench.direct.kernel import kernel
from hil_forceps.control.compensator import motor_reference_rad
from hil_forceps.estimation.interface import ELONGATION, TAU_W, Compiled
from hil_forceps.estimation.kernel_function import KernelFunction
from hil_forceps.rig.plant import PlantParameters

Vector = NDArray[np.float64]

MAX_BLOCK_SAMPLES: Final = 4096
# A block costs as much beside its samples as ten samples of the plain loop.
MIN_MEAN_BLOCK_SAMPLES: Final = 32
TRIAL_SAMPLES: Final = 2000  # as many as if they had gone well before the first
TAU_W_COLUMN, TAU_W_ESTIMATE, THETA_J, THETA_M, CURRENT, STRETCH, REQUESTED = range(7)  # columns of a block
COLUMNS: Final = 7

_VECTOR: Final = types.Array(types.float64, 1, "C")
_STAMPS: Final = types.Array(types.int64, 1, "C")
_WORLD: Final = types.none(
    _VECTOR, _STAMPS, _VECTOR, _VECTOR, types.int64, types.int64, types.float64, _VECTOR
)  # as `virtual_bus.plant.forceps_kernels.follow_and_sense`

_reference = kernel(motor_reference_rad)


class CompiledWorld(Protocol):
    """A world whose steps are a kernel: follow a reference from one sample to the next, and sense."""

    @property
    def kernel(self) -> Callable[..., None]:
        """Memory, times and torques of the load, noise, begin [ns], end [ns], reference [rad], what is sensed."""

    @property
    def memory(self) -> Vector:
        """What the kernel changes."""

    @property
    def load_time_ns(self) -> NDArray[np.int64]:
        """Times of the load."""

    @property
    def load_N_m(self) -> Vector:
        """Torques of the load."""

    @property
    def noise(self) -> Callable[[int], Vector]:
        """Return standard normals for the next n samples."""


class Law(NamedTuple):
    """What makes a reference of an estimate: the believed plant, and whether its stretch is compensated for."""

    plant: PlantParameters
    compensated: bool


@kernel
def _ahead(
    world: KernelFunction,
    memory: Vector,
    load_time_ns: NDArray[np.int64],
    load_N_m: Vector,
    noise: Vector,
    start: KernelFunction,
    step: KernelFunction,
    constants: Vector,
    state: Vector,
    plant: PlantParameters,
    compensated: bool,
    period_ns: int,
    first: int,
    reference_rad: float,
    theta_j_ref_rad: Vector,
    block: Vector,
) -> Vector:
    """Fill a block from sample number `first` on, the reference before it being `reference_rad`; return the state."""
    sensed = np.empty(4)
    for row in range(block.shape[0]):
        now_ns = (first + row) * period_ns
        begin_ns = now_ns if first + row == 0 else now_ns - period_ns
        world(memory, load_time_ns, load_N_m, noise[row], begin_ns, now_ns, reference_rad, sensed)
        torque = plant.torque_constant_N_m_per_A * sensed[1]
        if first + row == 0:
            state = start(constants, now_ns, sensed[0], torque)
        else:
            state = step(state, constants, now_ns, sensed[0], torque)
        reference_rad = _reference(theta_j_ref_rad[row], state[ELONGATION] if compensated else 0.0, plant)
        block[row, TAU_W_COLUMN] = sensed[3]
        block[row, TAU_W_ESTIMATE] = state[TAU_W]
        block[row, THETA_J] = sensed[2]
        block[row, THETA_M] = sensed[0]
        block[row, CURRENT] = sensed[1]
        block[row, STRETCH] = state[ELONGATION]
        block[row, REQUESTED] = reference_rad
        if not np.isfinite(reference_rad):  # no gate lets that pass
            block[row + 1 :, REQUESTED] = np.nan
            break
    return state


class Ahead:
    """World and estimator, ahead of the gate by a block of samples."""

    def __init__(
        self, world: CompiledWorld, estimator: Compiled, law: Law, period_ns: int, theta_j_ref_rad: Vector
    ) -> None:
        """`theta_j_ref_rad`: of all samples of the run."""
        self.length = 1  # of the next block
        self._blocks = 0
        self._world, self._estimator, self._law = world, estimator, law
        self._period_ns, self._theta_j_ref_rad = period_ns, theta_j_ref_rad
        self._kernel: Any = KernelFunction(world.kernel, _WORLD)
        self._state: Vector = np.empty(0)
        self._noise = np.empty((0, 3))  # of the samples to come

    def block(self, first: int, reference_rad: float) -> Vector:
        """Return the samples from `first` on, as many as `length` says and the run has, if every request passes."""
        self._blocks += 1
        samples = min(self.length, self._theta_j_ref_rad.size - first)
        missing = samples - len(self._noise)
        if missing > 0:
            self._noise = np.concatenate((self._noise, self._world.noise(missing)))
        self._before = (first, reference_rad, self._world.memory.copy(), self._state)
        return self._run(first, reference_rad, samples)

    def keep(self, samples: int, of: int) -> None:
        """Go on behind so many samples of the last block, which had `of`; fewer: the gate changed the last request."""
        if samples < of:
            first, reference_rad, memory, state = self._before
            self._world.memory[:], self._state = memory, state
            self._run(first, reference_rad, samples)
        self.length = 1 if samples < of else min(2 * self.length, MAX_BLOCK_SAMPLES)
        self._noise = self._noise[samples:]

    def pays(self, samples: int) -> bool:
        """Tell whether the blocks up to here were long enough."""
        return self._blocks * MIN_MEAN_BLOCK_SAMPLES <= samples + TRIAL_SAMPLES

    def _run(self, first: int, reference_rad: float, samples: int) -> Vector:
        block = np.empty((samples, COLUMNS))
        world, estimator, law = self._world, self._estimator, self._law
        self._state = _ahead(
            self._kernel,
            world.memory,
            world.load_time_ns,
            world.load_N_m,
            self._noise,
            estimator.start,
            estimator.step,
            estimator.constants,
            self._state,
            law.plant,
            law.compensated,
            self._period_ns,
            first,
            reference_rad,
            self._theta_j_ref_rad[first : first + samples],
            block,
        )
        return block
