"""`Estimator`: reaction torque and wire elongation from motor angle and current, for single samples or a record."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hil_forceps.api.arguments import check_number, check_sample, check_stamp, check_text, kind
from hil_forceps.api.runs import RigSource, as_rig
from hil_forceps.data.run import bad_row
from hil_forceps.data.time_order import MAX_SAMPLE_TIME_S, check_time_unit
from hil_forceps.estimation.batch import run as run_whole
from hil_forceps.estimation.interface import Estimate, Sample, State
from hil_forceps.estimation.registry import ALGORITHMS, ESTIMATOR_IDS, make_estimator
from hil_forceps.rig.errors import UserError

Vector = NDArray[np.float64]


class Estimates(NamedTuple):
    """Estimates for each sample of a record."""

    tau_w_N_m: Vector
    elongation_m: Vector


class Estimator:
    """An estimator with a rig's parameters and the state after its samples.

    `algorithm`: `kalman`, `improved`, `improved_as_published`, `previous`, or one that was added. `sample_time_s`:
    nominal time between samples. `over_wire`: samples are rounded to the protocol's resolution. Effects of the rig are
    corrected for as in docs/estimators.md. UserError for an unknown algorithm, or a rig without a required value;
    ValueError for a sample time that isn't positive, or longer than any drive's.
    """

    def __init__(self, algorithm: str, rig: RigSource, sample_time_s: float, *, over_wire: bool = True) -> None:
        check_text("algorithm", algorithm)
        check_number("sample_time_s", sample_time_s, "s", is_positive=True)
        if sample_time_s > MAX_SAMPLE_TIME_S:
            longest = f"no drive of a rig samples slower than every {MAX_SAMPLE_TIME_S:g} s"
            raise ValueError(f"sample_time_s: is {sample_time_s:g} s, and {longest}; give it in seconds")
        if algorithm not in ALGORITHMS:
            raise UserError(f"unknown algorithm '{algorithm}'; use one of {', '.join(ESTIMATOR_IDS)}")
        known = as_rig(rig)
        self.algorithm = algorithm
        self.sample_time_s = sample_time_s
        self._estimator = make_estimator(algorithm, known, sample_time_s, over_wire=over_wire)
        self._torque_per_A = known.plant().torque_constant_N_m_per_A
        self._period_ns = round(sample_time_s * 1e9)
        self._state: State | None = None
        self._stamp_ns = 0

    def step(self, theta_m_rad: float, current_A: float, stamp_ns: int | None = None) -> Estimate:
        """Process the next sample; return the estimates after it, `tau_w_N_m` and `elongation_m`.

        `current_A` was held over the interval that ended at `stamp_ns`, a stamp of the drive's clock; without one the
        sample comes `sample_time_s` after the last. Gaps are allowed; a repeated stamp changes nothing. UserError for a
        sample that isn't finite, and for a stamp before the last one.
        """
        check_sample("theta_m_rad", theta_m_rad)
        check_sample("current_A", current_A)
        if stamp_ns is None:
            stamp_ns = 0 if self._state is None else self._stamp_ns + self._period_ns
        check_stamp("stamp_ns", stamp_ns)
        if self._state is not None and stamp_ns < self._stamp_ns:
            told = f"stamp_ns: {stamp_ns} comes before the last sample's {self._stamp_ns}"
            raise UserError(f"{told}; leave out late samples, or call reset() before another record")
        stamp_ns = int(stamp_ns)  # numpy's would overflow
        sample = Sample(stamp_ns, theta_m_rad, self._torque_per_A * current_A)
        estimator = self._estimator
        self._state = estimator.start(sample) if self._state is None else estimator.step(self._state, sample)
        self._stamp_ns = max(self._stamp_ns, stamp_ns)
        return estimator.estimate(self._state)

    def estimate(self, theta_m_rad: ArrayLike, current_A: ArrayLike, time_s: ArrayLike | None = None) -> Estimates:
        """Estimate a whole record from its first sample on, with the same results as `step` for each sample.

        Arrays of equal length, at least 1; without `time_s` rows are `sample_time_s` apart. The state of `step` is
        neither used nor changed. UserError, as of `read_runs`, for values that aren't finite, for time that doesn't
        increase or has another unit; ValueError for arrays of other shapes, TypeError for arrays without numbers.
        """
        given = {"theta_m_rad": theta_m_rad, "current_A": current_A}
        if time_s is not None:
            given["time_s"] = time_s
        columns = {name: _numbers(name, values) for name, values in given.items()}
        shapes = {values.shape for values in columns.values()}
        if len(shapes) > 1 or columns["theta_m_rad"].ndim != 1 or not columns["theta_m_rad"].size:
            told = ", ".join(f"{name} {values.shape}" for name, values in columns.items())
            raise ValueError(
                f"{', '.join(columns)}: must be one-dimensional arrays of equal length, at least 1; they are {told}"
            )
        for name, values in columns.items():
            if (row := bad_row(values, increasing=False)) is not None:
                raise UserError(f"{name}[{row}]: is {values[row]}, not a finite number; correct or remove the row")
        angle, torque = columns["theta_m_rad"], self._torque_per_A * columns["current_A"]
        stamps = np.arange(angle.size, dtype=np.int64) * self._period_ns
        if time_s is not None:
            stamps = _stamps(columns["time_s"])
        return Estimates(*run_whole(self._estimator, stamps, angle, torque))

    def reset(self) -> None:
        """Forget all samples: the next one is the first."""
        self._state = None
        self._stamp_ns = 0


def _numbers(name: str, values: ArrayLike) -> Vector:
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise TypeError(f"{name}: must be an array of numbers in one row, not {kind(values)} ({error})") from error


def _stamps(time_s: Vector) -> NDArray[np.int64]:
    """Return integer nanoseconds; UserError for time that doesn't increase, or is probably not in seconds."""
    late = np.flatnonzero(~(np.diff(time_s) > 0.0)) + 1
    if late.size:
        row = int(late[0])
        told = f"time_s[{row}]: {time_s[row]:.9g} does not come after {time_s[row - 1]:.9g}"
        raise UserError(f"{told}; sort the rows and remove repeated ones, or call estimate for each record")
    if time_s.size > 1:
        check_time_unit(time_s, "estimate", is_table=False)
    return np.rint(time_s * 1e9).astype(np.int64)
