"""A drive that samples between rows, or in a lost one: its commands are told by angle and current, and how well."""

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.data.even_rows import EvenRun, even_rows
from hil_forceps.data.run import Run
from hil_forceps.diagnosis.preparation.command import driven
from hil_forceps.diagnosis.preparation.records import Record, record_of
from hil_forceps.diagnosis.preparation.reference_timing import reference_timing
from hil_forceps.diagnosis.state_space.advance import physics_of
from hil_forceps.diagnosis.state_space.drive.sample import expected_count, sampled, sampled_covariance
from hil_forceps.diagnosis.state_space.kernel import kernel
from hil_forceps.diagnosis.state_space.layout import (
    COMMAND_ERROR,
    COUNT_ERROR,
    CURRENT,
    DERIVATIVE_ERROR,
    INTEGRAL_ERROR,
    JAW,
    LAW_STATES,
    THETA_M,
    Noise,
)
from hil_forceps.diagnosis.state_space.passes import Passed, pass_one
from hil_forceps.diagnosis.state_space.response_pass import response_run
from hil_forceps.model import closed_loop, parameters
from hil_forceps.model.closed_loop import Inputs
from hil_forceps.model.drive_law import DriveState, law_current, law_vector
from hil_forceps.rig import Rig
from tests.hidden_effects.generator import RIG

Vector = NDArray[np.float64]

LAWS: dict[str, dict[str, float | str]] = {
    "PI": {"drive.ki_A_per_rad_s": 100.0},
    "PID": {"drive.ki_A_per_rad_s": 100.0, "drive.kd_A_s_per_rad": 2.0e-3},
    "cascade": {"drive.kd_A_s_per_rad": 2.0e-3, "drive.ki_A_per_rad_s": 100.0, "drive.cascade_time_s": 2.0e-3},
}
ROWS, PERIOD_S = 4000, 1e-3
NOISE = Noise(np.array([2e-4, 1e-5, 1e-3]), np.zeros(3), np.zeros(3))
THERE = slice(600, -20)


def rig_of(law: str, samples: int, counts: int) -> Rig:
    return RIG.with_changes({**LAWS[law], "drive.sample_time_s": PERIOD_S / samples, "encoder.counts_per_rev": counts})


def logged(rig: Rig, samples: int, kind: str) -> tuple[Run, Vector]:
    """Return the rows of a run without friction or load, and the commands of all samples; `kind`: of references."""
    step_s, count = PERIOD_S / samples, ROWS * samples
    rows: Vector = 0.4 * np.sin(2.0 * np.pi * 0.7 * PERIOD_S * np.arange(ROWS + 1))
    at = np.arange(count)
    ahead = np.where(at % samples == 0, at // samples, at // samples + 1)
    reference = {
        "held": rows[at // samples],
        "ahead": rows[ahead],
        "line": np.interp(at / samples, np.arange(ROWS + 1), rows),
    }[kind]
    theta, law, time_s = parameters.vector(rig), law_vector(rig.require_drive()), step_s * np.arange(count, dtype=float)
    inputs = Inputs(time_s, reference, np.zeros(count), np.empty(0, dtype=np.int64), np.empty(0))
    start = closed_loop.rest(theta, 0.0)
    shown = closed_loop.simulate(theta, law, rig.encoder.quantum_rad, inputs, start)
    commands = law_current(law, reference, shown.theta_m_rad, DriveState(0.0, float("nan"), 0.0, 0.0))
    rng = np.random.default_rng(1)
    columns = {
        "time_s": time_s[::samples],
        "theta_m_ref_rad": reference[::samples],
        "theta_m_rad": shown.theta_m_rad[::samples],
        "current_A": shown.current_A[::samples] + NOISE.deviation[2] * rng.standard_normal(ROWS),
        "theta_j_rad": shown.theta_j_rad[::samples] + NOISE.deviation[0] * rng.standard_normal(ROWS),
        "tau_w_N_m": NOISE.deviation[1] * rng.standard_normal(ROWS),
    }
    return Run("sine", columns), commands


def told(rig: Rig, run: Run) -> tuple[Record, Passed]:
    even, plant = EvenRun.whole(run), physics_of(parameters.vector(rig))
    record = record_of(even, rig, NOISE)
    for turn in range(2):
        record = record.with_timing(reference_timing(pass_one(record, plant), first=turn == 0))
    return record, pass_one(record, plant)


@pytest.mark.parametrize("kind", ["held", "ahead", "line"])
@pytest.mark.parametrize(("law", "samples", "counts"), [("PI", 2, 16384), ("PID", 4, 4096), ("cascade", 4, 4096)])
def test_commands_between_rows_are_told_whatever_the_host_sends(kind: str, law: str, samples: int, counts: int) -> None:
    rig = rig_of(law, samples, counts)
    run, commands = logged(rig, samples, kind)
    record, passed = told(rig, run)
    assert record.series.timing.mean(axis=0)[["held", "line", "ahead"].index(kind)] > 0.9
    last = slice(samples - 1, None, samples)
    off = (passed.filtered.command_A - commands)[last][THERE]
    by_current = (run.columns["current_A"][1:] - commands[last][:-1])[THERE]
    assert np.std(off) < 0.6 * np.std(by_current)  # better than the measured current itself
    assert abs(float(np.mean(off))) < 0.1 * NOISE.deviation[2]  # the integral keeps to what the drive followed


@pytest.mark.parametrize("law", ["PID", "cascade"])
def test_innovations_are_white_and_as_large_as_they_are_said_to_be(law: str) -> None:
    rig = rig_of(law, 4, 4096)
    _, passed = told(rig, logged(rig, 4, "line")[0])
    for channel in range(4):
        here = passed.filtered.residual[THERE, channel][passed.counts[THERE, channel]]
        assert here.size > 300
        # Within its count an angle is known, and an innovation next to nothing; the others are one deviation.
        assert 0.9 < float(np.mean(here**2)) < 1.1 or channel == 0
        assert abs(float(np.mean(here[1:] * here[:-1]))) < 4.0 / np.sqrt(here.size)


@pytest.mark.parametrize("law", list(LAWS))
def test_answers_are_those_of_another_pass(law: str) -> None:
    """Of other parameters, at the jaw: single counts are weighed otherwise there, and no linear answer holds that."""
    rig = rig_of(law, 4, 4096)
    record, passed = told(rig, logged(rig, 4, "line")[0])
    theta = parameters.vector(rig)
    for name in ("forceps.jaw_pulley_radius_m", "forceps.motor_viscous_N_m_s_per_rad"):
        other, place = theta.copy(), parameters.index(name)
        other[place] *= 1.02
        answer = response_run(physics_of(other), physics_of(theta), record.series, passed.filtered, 1.0)
        change = pass_one(record, physics_of(other)).filtered.residual - passed.filtered.residual
        there, its = change[THERE, JAW], answer[THERE, JAW]
        assert float(there @ its) == pytest.approx(float(its @ its), rel=0.2)


def test_lost_rows_leave_open_what_a_count_makes_of_the_command() -> None:
    rig = rig_of("PID", 1, 4096)
    run, commands = logged(rig, 1, "held")
    kept = np.ones(ROWS, dtype=np.bool_)
    kept[700::40] = False
    even = even_rows(Run("lost", {key: values[kept] for key, values in run.columns.items()}), rig)
    assert even is not None
    record = record_of(even, rig, NOISE)
    assert record.series.states == LAW_STATES
    filtered = pass_one(record, physics_of(parameters.vector(rig))).filtered
    lost = np.flatnonzero(even.lost)
    assert np.all(filtered.count_slope[lost] > 0.0)
    assert np.all(np.delete(filtered.count_slope, lost) == 0.0)
    off = filtered.command_A[:-1] - commands[: even.lost.size - 1]
    assert np.std(off[lost]) > 5.0 * np.std(np.delete(off, np.concatenate((lost, lost + 1)))[650:])
    said = np.sqrt(filtered.variance[lost + 1, COMMAND_ERROR])
    assert 0.7 < float(np.std(filtered.residual[lost + 1, CURRENT])) < 1.3
    assert np.all(said > 0.0)


@pytest.mark.parametrize(("angle", "deviation"), [(0.1, 0.05), (0.48, 0.1), (0.5, 0.3), (3.2, 1.5)])
def test_the_expected_count_is_that_of_many_angles(angle: float, deviation: float) -> None:
    found = _expected(angle, deviation, 1.0)
    angles = angle + deviation * np.random.default_rng(2).standard_normal(400_000)
    counts = np.floor(angles + 0.5)
    both = np.cov(counts, angles)
    slope = both[0, 1] / both[1, 1]
    assert found[0] == pytest.approx(counts.mean(), abs=4e-3 * max(1.0, deviation))
    assert found[1] == pytest.approx(slope, abs=0.02)
    assert found[2] == pytest.approx(both[0, 0] - slope**2 * both[1, 1], abs=4e-3)


@pytest.mark.parametrize("kind", ["PID", "cascade"])
def test_a_sample_carries_covariance_as_it_carries_draws(kind: str) -> None:
    law, rng = law_vector(rig_of(kind, 4, 4096).require_drive()), np.random.default_rng(3)
    root = np.zeros((LAW_STATES, LAW_STATES))
    own = [THETA_M, INTEGRAL_ERROR, DERIVATIVE_ERROR, COUNT_ERROR]
    root[np.ix_(own, own)] = rng.standard_normal((4, 4)) * np.array([1e-4, 1e-3, 1e-3, 1e-4])[:, np.newaxis]
    covariance, draws = root @ root.T, rng.standard_normal((100_000, LAW_STATES)) @ root.T
    slope, variance = 0.7, 2.5e-9
    counts = slope * draws[:, THETA_M] + np.sqrt(variance) * rng.standard_normal(draws.shape[0])
    for draw, count in zip(draws, counts, strict=True):
        _sampled(law, float(count), draw)
    sampled_covariance(law, slope, variance, 0.0, True, covariance)
    for i in (COMMAND_ERROR, INTEGRAL_ERROR, DERIVATIVE_ERROR, COUNT_ERROR):
        for j in (COMMAND_ERROR, INTEGRAL_ERROR, DERIVATIVE_ERROR, COUNT_ERROR, THETA_M):
            scale = np.sqrt(covariance[i, i] * covariance[j, j])
            assert float(np.mean(draws[:, i] * draws[:, j])) == pytest.approx(covariance[i, j], abs=0.02 * scale)


def test_rows_that_are_no_whole_number_of_samples_are_refused() -> None:
    run, _ = logged(rig_of("PI", 2, 16384), 2, "held")
    with pytest.raises(ValueError, match="no 1, 2 or 4 samples"):
        driven(run, np.zeros(ROWS, dtype=np.bool_), rig_of("PI", 3, 16384), 1e-3)


@kernel
def _expected(angle: float, deviation: float, quantum: float) -> tuple[float, float, float]:
    count = expected_count(angle, deviation, quantum)
    return (count.mean_rad, count.slope, count.variance)


@kernel
def _sampled(law: Vector, count: float, x: Vector) -> None:
    sampled(law, count, True, x)
