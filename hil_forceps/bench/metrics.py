"""Metrics of a run of the bench."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.report.traces import RunTraces

# The paper shows 9–20 s: the ramp and the settling have ended, and the load begins at 10 s.
ERROR_WINDOW_S = (9.0, 20.0)
# Half a second under steady load: the end of simulation 1, the end of simulation 2's last pulse.
STEADY_WINDOW_S = {1: (19.5, 20.0), 2: (17.0, 17.5)}


class Metrics(NamedTuple):
    """Errors of one run over `ERROR_WINDOW_S`; None if the estimate is not finite to the end."""

    finite: bool
    tau_w_rmse_N_m: float | None
    tau_w_peak_error_N_m: float | None
    jaw_error_steady_deg: float | None
    elongation_rmse_m: float | None


def judge(traces: RunTraces) -> Metrics:
    """Compare estimates with the bench's sensors at the instants of the drive's samples.

    The jaw error is the mean of θ_j − θ_j_ref over `STEADY_WINDOW_S`.
    """
    window = _within(traces.time_s, ERROR_WINDOW_S)
    steady = _within(traces.time_s, STEADY_WINDOW_S[traces.simulation])
    reaches_end = traces.time_s.size > 0 and traces.time_s[-1] >= ERROR_WINDOW_S[1] - 2.0 * traces.sample_time_s
    estimates = np.concatenate((traces.tau_w_est[window], traces.x_est[window]))
    if not reaches_end or not np.all(np.isfinite(estimates)):
        return Metrics(False, None, None, None, None)
    torque_error = (traces.tau_w_est - traces.tau_w_true)[window]
    jaw_error = (traces.theta_j_true - traces.theta_j_ref)[steady]
    return Metrics(
        finite=True,
        tau_w_rmse_N_m=_rms(torque_error),
        tau_w_peak_error_N_m=float(np.max(np.abs(torque_error))),
        jaw_error_steady_deg=float(np.degrees(np.mean(jaw_error))),
        elongation_rmse_m=_rms((traces.x_est - traces.x_true)[window]),
    )


def _within(time_s: NDArray[np.float64], window_s: tuple[float, float]) -> NDArray[np.bool_]:
    return (time_s >= window_s[0]) & (time_s <= window_s[1])


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
