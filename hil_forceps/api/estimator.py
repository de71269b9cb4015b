"""`Estimator`: reaction torque and wire elongation from what a motor driver measures, sample by sample or at once."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hil_forceps.api.runs import RigSource, as_rig
from hil_forceps.estimation.batch import run as run_whole
from hil_forceps.estimation.interface import Estimate, Sample, State
from hil_forceps.estimation.registry import ALGORITHMS, ESTIMATOR_IDS, make_estimator
from hil_forceps.rig.errors import UserError

Vector = NDArray[np.float64]


class Estimates(NamedTuple):
    """What an estimator says at each sample of a record."""

    tau_w_N_m: Vector
    elongation_m: Vector


class Estimator:
    """An estimator with a rig's numbers, which remembers the samples it was fed.

    `algorithm`: `kalman`, `improved`, `improved_as_published`, `previous`, or one that was added. `sample_time_s`:
    nominal time between samples. `over_wire`: samples are rounded as the protocol does it. Effects of the rig are taken
    into account as docs/estimators.md says. UserError for a name that is no algorithm, or a rig that lacks a value;
    ValueError for a sample time that isn't positive.
    """

    def __init__(self, algorithm: str, rig: RigSource, sample_time_s: float, *, over_wire: bool = True) -> None:
        if algorithm not in ALGORITHMS:
            raise UserError(f"unknown algorithm '{algorithm}'; there are {', '.join(ESTIMATOR_IDS)}")
        known = as_rig(rig)
        self.algorithm = algorithm
        self.sample_time_s = sample_time_s
        self._estimator = make_estimator(algorithm, known, sample_time_s, over_wire=over_wire)
        self._torque_per_A = known.plant().torque_constant_N_m_per_A
        self._period_ns = round(sample_time_s * 1e9)
        self._state: State | None = None
        self._stamp_ns = 0

    def step(self, theta_m_rad: float, current_A: float, stamp_ns: int | None = None) -> Estimate:
        """Take the next sample; return what is known after it, `tau_w_N_m` and `elongation_m`.

        `current_A` was held over the interval that ended at `stamp_ns`, a stamp of the drive's clock; without one the
        sample comes `sample_time_s` after the last. Gaps are bridged; a stamp that isn't later changes nothing.
        """
        if stamp_ns is None:
            stamp_ns = 0 if self._state is None else self._stamp_ns + self._period_ns
        sample = Sample(stamp_ns, theta_m_rad, self._torque_per_A * current_A)
        estimator = self._estimator
        self._state = estimator.start(sample) if self._state is None else estimator.step(self._state, sample)
        self._stamp_ns = max(self._stamp_ns, stamp_ns)
        return estimator.estimate(self._state)

    def estimate(self, theta_m_rad: ArrayLike, current_A: ArrayLike, time_s: ArrayLike | None = None) -> Estimates:
        """Run a whole record through at once, from its first sample on: the same numbers as `step` for each.

        Arrays of one length, 1 or more; without `time_s` rows are `sample_time_s` apart. What `step` was fed is neither
        used nor changed. ValueError for arrays of other shapes.
        """
        angle = np.asarray(theta_m_rad, dtype=np.float64)
        torque = self._torque_per_A * np.asarray(current_A, dtype=np.float64)
        if time_s is None:
            stamps = np.arange(angle.size, dtype=np.int64) * self._period_ns
        else:
            stamps = np.rint(np.asarray(time_s, dtype=np.float64) * 1e9).astype(np.int64)
        return Estimates(*run_whole(self._estimator, stamps, angle, torque))

    def reset(self) -> None:
        """Forget all samples: the next one is the first."""
        self._state = None
        self._stamp_ns = 0
