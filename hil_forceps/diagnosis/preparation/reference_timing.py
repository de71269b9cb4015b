"""Which references a drive follows between rows: told by the currents that rows show.

The current at a row was commanded at the last sample before it. So it tells whether the drive had the next row's
reference already, still that of the row before, or one in between.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.signal import savgol_filter

from hil_forceps.diagnosis.state_space.passes import Passed

Matrix = NDArray[np.float64]

WINDOW_S = 2.0  # a host's timing is the same over it: a clock 100 ppm off drifts by less than a sample of the drive
MIN_WEIGHT = 0.01  # of a reference that never held around a row


def reference_timing(passed: Passed, *, first: bool) -> Matrix:
    """Return how likely a drive followed each of `references_between` behind each row (n × 3), from a pass over a run.

    At `first` a host is taken to be always alike within a window; then it may not be, and this is a step of expectation
    and maximisation for the shares of a mixture (Dempster, Laird and Rubin, J. R. Stat. Soc. B 39, 1977).
    """
    share, before = passed.filtered.between.timing.copy(), passed.series.timing
    share[-1] = share[-2]
    window = max(3, round(WINDOW_S / passed.series.period_s))

    def around(values: Matrix) -> Matrix:
        return np.stack([uniform_filter1d(column, window) for column in values.T], axis=1)

    if first:
        log_likelihood = window * around(np.log(np.maximum(share, 1e-12) / before))
        share = np.exp(log_likelihood - log_likelihood.max(axis=1, keepdims=True))
    else:
        # While a clock that is off moves a reference past a sample of the drive, shares follow a parabola in a window.
        odd = min(2 * (window // 2) + 1, 2 * ((share.shape[0] - 1) // 2) + 1)
        share = savgol_filter(share, odd, 2, axis=0)
    share = np.maximum(share / share.sum(axis=1, keepdims=True), MIN_WEIGHT)
    return np.asarray(share / share.sum(axis=1, keepdims=True))
