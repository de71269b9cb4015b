"""A drive that samples between rows: what it counted and what it followed there."""

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.diagnosis.anew import refresher
from hil_forceps.diagnosis.assemble import assemble
from hil_forceps.diagnosis.validation.beside import simulate_beside
from hil_forceps.diagnosis.experiment import prepare
from hil_forceps.diagnosis.predict import REFERENCES, ClosedLoop, Reference, between_rows
from hil_forceps.diagnosis.shaking import counted_between
from hil_forceps.model import closed_loop, parameters
from hil_forceps.model.closed_loop import Inputs, law_vector, rest
from hil_forceps.runs.table import Run
from tests.hidden_effects.generator import FAST_DRIVE_RIG, generate
from tests.hidden_effects.generator_scenarios import SCENARIOS

Vector = NDArray[np.float64]
ROWS, SAMPLES = 3000, 5
RIG = FAST_DRIVE_RIG.with_changes({"drive.sample_time_s": 1e-3 / SAMPLES})
QUANTUM_RAD = 2.0 * np.pi / 16384
TIME_S: Vector = np.arange(ROWS, dtype=np.float64) * 1e-3
NO_EDGES = (np.empty(0, np.int64), np.empty(0))


def run_after(reference: Reference) -> Run:
    """Simulate a run whose reference goes on between rows in one of the ways."""
    rows: Vector = 0.6 + 0.3 * (1.0 - np.cos(2.0 * np.pi * 8.0 * TIME_S))
    theta, law = parameters.vector(RIG), law_vector(RIG.require_drive())
    inputs = Inputs(TIME_S, between_rows(rows, SAMPLES, reference), np.zeros(ROWS), *NO_EDGES)
    out = closed_loop.simulate(theta, law, QUANTUM_RAD, inputs, rest(theta, float(rows[0])), 2 * SAMPLES, SAMPLES)
    channels = {"theta_m_rad": out.theta_m_rad, "current_A": out.current_A, "theta_j_rad": out.theta_j_rad}
    return Run(reference, {"time_s": TIME_S, "theta_m_ref_rad": rows, **channels, "tau_w_N_m": np.zeros(ROWS)})


def test_a_reference_between_rows() -> None:
    rows = np.array([0.0, 1.0, 4.0, 9.0])
    assert between_rows(rows, 2, "held").tolist() == [0.0, 0.0, 1.0, 1.0, 4.0, 4.0, 9.0, 9.0]
    assert between_rows(rows, 2, "straight").tolist() == [0.0, 0.5, 1.0, 2.5, 4.0, 6.5, 9.0, 9.0]
    assert between_rows(rows, 2, "smooth") == pytest.approx([0.0, 0.25, 1.0, 2.25, 4.0, 6.25, 9.0, 9.0])
    assert all(np.array_equal(between_rows(rows, 1, reference), rows) for reference in REFERENCES)


def test_an_angle_is_counted_between_rows() -> None:
    angle = 40.3 * QUANTUM_RAD * np.sin(np.arange(60) / 9.0)
    error = np.rint(angle / QUANTUM_RAD) * QUANTUM_RAD - angle
    found = counted_between(angle, error, 4, QUANTUM_RAD)
    assert np.array_equal(found[::4], error)
    exact = 40.3 * QUANTUM_RAD * np.sin(np.arange(4 * 59) / 36.0)
    counts = (exact + found[: exact.size]) / QUANTUM_RAD
    assert np.abs(counts - np.rint(counts)).max() < 0.01
    assert np.abs(found).max() <= 0.5 * QUANTUM_RAD * 1.0001
    assert counted_between(angle, error, 1, QUANTUM_RAD) is error


def test_the_loop_reads_a_value_at_each_sample() -> None:
    theta, law = parameters.vector(RIG), law_vector(RIG.require_drive())
    rows: Vector = 0.1 * np.sin(TIME_S)
    load, start = np.zeros(ROWS), rest(theta, 0.0)
    of_rows = Inputs(TIME_S, rows, load, *NO_EDGES)
    error = np.random.default_rng(1).uniform(-1e-4, 1e-4, ROWS)
    of_samples = of_rows._replace(reference_rad=np.repeat(rows, SAMPLES), encoder_error_rad=np.repeat(error, SAMPLES))
    each = closed_loop.simulate(theta, law, 0.0, of_samples, start, SAMPLES, SAMPLES)
    held = closed_loop.simulate(theta, law, 0.0, of_rows._replace(encoder_error_rad=error), start, SAMPLES, SAMPLES)
    assert all(np.array_equal(a, b) for a, b in zip(each, held, strict=True))
    error_between = np.repeat(error, SAMPLES) * (np.arange(ROWS * SAMPLES) % SAMPLES == 0)
    other = closed_loop.simulate(
        theta, law, 0.0, of_samples._replace(encoder_error_rad=error_between), start, SAMPLES, SAMPLES
    )
    assert np.abs(other.current_A - each.current_A).max() > 1e-5
    for wrong in (of_rows._replace(reference_rad=np.zeros(2 * ROWS)), of_samples._replace(encoder_error_rad=error)):
        with pytest.raises(ValueError, match="same length"):
            closed_loop.simulate(theta, law, 0.0, wrong, start, SAMPLES, SAMPLES)


@pytest.mark.parametrize("reference", REFERENCES)
def test_runs_show_how_their_reference_went_on(reference: Reference) -> None:
    records, _ = prepare([run_after(reference)], RIG)
    simulator = assemble(records, RIG, map).simulator
    assert isinstance(simulator, ClosedLoop)
    assert simulator.reference == reference


def test_the_simulation_beside_a_run_says_what_the_drive_was_given() -> None:
    held, moving = (simulate_beside(run_after(reference), RIG) for reference in ("held", "smooth"))
    assert held.notes == ()
    assert any("smooth reference" in note for note in moving.notes)
    for beside in (held, moving):
        assert beside.rmse("theta_m_rad") < QUANTUM_RAD


def test_counting_between_rows_makes_the_currents_noise() -> None:
    """Of the simulated world: with each row's rounding held to the next one the current is off by a third more.

    Not by all: of the slow part of the rounding what the motor did can't be told, and then a count may be another.
    """
    quiet = FAST_DRIVE_RIG.with_changes({"noise": {}})
    records, _ = prepare([generate(quiet, SCENARIOS["multisine"], 5)], FAST_DRIVE_RIG)
    problem = assemble(records, FAST_DRIVE_RIG, map).problem
    start = np.zeros(problem.size)
    loop = refresher(FAST_DRIVE_RIG)(problem, start).simulate_runs
    assert isinstance(loop, ClosedLoop)
    theta, nuisance = problem.theta(start), problem.nuisances(start)[0]
    (error,) = loop.encoder_error_rad
    held = type(loop)(loop.records, loop.law, loop.starts, (np.repeat(error[::2], 2),), reference=loop.reference)

    def off(simulated: ClosedLoop) -> float:
        left = records[0].channels["current_A"] - simulated.raw(0, theta, nuisance).current_A
        return float(np.std(np.diff(left)))

    assert off(loop) < 0.85 * off(held)
