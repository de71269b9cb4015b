"""Metrics of traces whose errors are known beforehand."""

import math

import numpy as np
import pytest

from hil_forceps.bench.metrics import ERROR_WINDOW_S, STEADY_WINDOW_S, judge
from hil_forceps.report.traces import RunTraces

SAMPLE_TIME_S = 1e-3


def traces(simulation: int = 2, end_s: float = 20.0, sample_time_s: float = SAMPLE_TIME_S) -> RunTraces:
    """Return a run without any error."""
    time_s = np.arange(round(end_s / sample_time_s) + 1, dtype=np.float64) * sample_time_s
    zeros = np.zeros_like(time_s)
    jaw = np.full_like(time_s, 0.3)
    return RunTraces(time_s, zeros, zeros, jaw, jaw, zeros, zeros, "kalman", True, simulation, sample_time_s)


def cut(run: RunTraces, end: int) -> RunTraces:
    time_s, tau_w_true, tau_w_est, jaw, jaw_ref, x_true, x_est = (field[:end] for field in run[:7])
    return RunTraces(time_s, tau_w_true, tau_w_est, jaw, jaw_ref, x_true, x_est, *run[7:])


def inside(run: RunTraces) -> "np.ndarray[tuple[int], np.dtype[np.bool_]]":
    return (run.time_s >= ERROR_WINDOW_S[0]) & (run.time_s <= ERROR_WINDOW_S[1])


def test_no_error_is_nought() -> None:
    assert judge(traces())._asdict() == {
        "finite": True,
        "tau_w_rmse_N_m": 0.0,
        "tau_w_peak_error_N_m": 0.0,
        "jaw_error_steady_deg": 0.0,
        "elongation_rmse_m": 0.0,
    }


def test_sine_has_its_rms_and_its_peak() -> None:
    run = traces()
    wave = np.sin(2.0 * math.pi * run.time_s)  # whole periods in the window
    metrics = judge(run._replace(tau_w_est=3e-3 * wave, x_est=-2e-6 * wave))
    assert metrics.tau_w_rmse_N_m == pytest.approx(3e-3 / math.sqrt(2.0), rel=1e-3)
    assert metrics.tau_w_peak_error_N_m == pytest.approx(3e-3, rel=1e-6)
    assert metrics.elongation_rmse_m == pytest.approx(2e-6 / math.sqrt(2.0), rel=1e-3)


def test_peak_is_of_the_error_and_counts_below_zero() -> None:
    run = traces()
    estimate = np.zeros_like(run.time_s)
    estimate[12_000] = -5e-3
    truth = np.zeros_like(run.time_s)
    truth[12_000] = 2e-3
    metrics = judge(run._replace(tau_w_est=estimate, tau_w_true=truth))
    assert metrics.tau_w_peak_error_N_m == pytest.approx(7e-3)
    assert metrics.tau_w_rmse_N_m == pytest.approx(7e-3 / math.sqrt(np.count_nonzero(inside(run))))


def test_window_is_that_of_the_paper() -> None:
    assert ERROR_WINDOW_S == (9.0, 20.0)


def test_nothing_before_the_window_counts() -> None:
    run = traces()
    before = np.where(run.time_s < ERROR_WINDOW_S[0], 1.0, 0.0)
    metrics = judge(run._replace(tau_w_est=before, x_est=before, theta_j_true=run.theta_j_ref + before))
    assert metrics == judge(run)


@pytest.mark.parametrize("simulation", [1, 2])
def test_jaw_error_is_the_signed_mean_under_steady_load(simulation: int) -> None:
    run = traces(simulation)
    first, last = STEADY_WINDOW_S[simulation]
    steady = (run.time_s >= first) & (run.time_s <= last)
    ripple = 0.01 * (-1.0) ** np.arange(run.time_s.size)
    error = np.where(steady, -math.radians(2.25) + ripple, 1.0)
    assert judge(run._replace(theta_j_true=run.theta_j_ref + error)).jaw_error_steady_deg == pytest.approx(
        -2.25, abs=2e-3
    )


def test_steady_windows_lie_where_the_load_is_on() -> None:
    assert STEADY_WINDOW_S[1][0] >= 15.0
    assert 15.0 + 1.0 < STEADY_WINDOW_S[2][0] < STEADY_WINDOW_S[2][1] <= 17.5
    assert all(ERROR_WINDOW_S[0] <= first < last <= ERROR_WINDOW_S[1] for first, last in STEADY_WINDOW_S.values())


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("field", ["tau_w_est", "x_est"])
def test_estimate_that_is_not_finite_has_no_figures(value: float, field: str) -> None:
    run = traces()
    estimate = np.zeros_like(run.time_s)
    estimate[15_000] = value
    metrics = judge(run._replace(tau_w_est=estimate) if field == "tau_w_est" else run._replace(x_est=estimate))
    assert not metrics.finite
    assert set(metrics[1:]) == {None}


def test_not_finite_before_the_window_is_forgiven() -> None:
    run = traces()
    estimate = np.zeros_like(run.time_s)
    estimate[0] = math.nan
    assert judge(run._replace(tau_w_est=estimate)).finite


@pytest.mark.parametrize("end_s", [5.0, 19.9])
def test_run_that_ended_early_has_no_figures(end_s: float) -> None:
    metrics = judge(traces(end_s=end_s))
    assert metrics == (False, None, None, None, None)


def test_run_without_a_sample_has_no_figures() -> None:
    assert not judge(cut(traces(), 0)).finite


def test_last_sample_may_be_a_period_short() -> None:
    assert judge(cut(traces(), -1)).finite
