"""A replicate is like the measured run, but for counts and noise."""

import numpy as np
import pytest

from hil_forceps.data.even_rows import EvenRun
from hil_forceps.diagnosis.preparation.records import Record
from hil_forceps.diagnosis.state_space.advance import physics_of
from hil_forceps.diagnosis.state_space.layout import Noise
from hil_forceps.diagnosis.state_space.passes import Passed
from hil_forceps.diagnosis.validation.replicate import replicate
from hil_forceps.model import parameters
from hil_forceps.rig import Rig
from tests.hidden_effects.generator import COLOURED, RIG, generate
from tests.hidden_effects.generator_scenarios import SCENARIOS
from tests.unit.diagnosis.simulated_runs import STICKING, records_of, runs_of

NOISE = Noise(np.array([RIG.noise.theta_j_rad, RIG.noise.tau_w_N_m, RIG.noise.current_A]), np.zeros(3), np.zeros(3))


def beside(even: EvenRun, rig: Rig) -> tuple[Record, Passed]:
    theta = parameters.vector(rig)
    plant = physics_of(theta)
    record = records_of([even.run], rig)[0].with_friction_of(plant)
    return record, record.passed(theta, plant)


def made(even: EvenRun, rig: Rig, noise: Noise = NOISE, seed: int = 0) -> tuple[EvenRun, int]:
    record, passed = beside(even, rig)
    again = replicate(even, record, passed, rig, parameters.vector(rig), noise, np.random.default_rng(seed))
    return again, record.settling_rows


@pytest.mark.parametrize("kind", ["multisine_mid", "short_hold", "grasp"])
def test_a_run_goes_the_same_way(kind: str) -> None:
    (run,) = runs_of(STICKING, (kind,), 6100)
    again, first = made(EvenRun.whole(run), STICKING)
    assert again.name == run.name
    assert again.run.columns.keys() == run.columns.keys()
    assert again.begin_s == pytest.approx(first * 1e-3)
    for name, noise in (("theta_j_rad", NOISE.deviation[0]), ("tau_w_N_m", NOISE.deviation[1])):
        apart = again.run.columns[name] - run.columns[name][first:]
        span = float(np.ptp(run.columns[name]))
        assert np.std(apart) < np.sqrt(2.0) * 1.2 * noise + 0.01 * span  # two noises, and the motion within a count
    apart = again.run.columns["theta_m_rad"] - run.columns["theta_m_rad"][first:]
    assert np.std(apart) < 0.01 * np.ptp(run.columns["theta_m_rad"])
    np.testing.assert_array_equal(again.run.columns["theta_m_ref_rad"], run.columns["theta_m_ref_rad"][first:])


def test_the_same_seed_gives_the_same_bytes_and_another_one_others() -> None:
    (run,) = runs_of(STICKING, ("short_hold",), 6110)
    one, again, other = (made(EvenRun.whole(run), STICKING, seed=seed)[0].run.columns for seed in (1, 1, 2))
    for name in run.columns:
        np.testing.assert_array_equal(one[name], again[name])
    assert not np.array_equal(one["current_A"], other["current_A"])


def test_noise_is_as_coloured_and_as_coarse_as_it_was_found() -> None:
    run = generate(RIG, SCENARIOS["short_hold"], 6120, COLOURED)
    noise = Noise(NOISE.deviation, np.array([0.9, 0.9, 0.0]), np.array([0.0, 0.0, 3.0 * RIG.noise.current_A]))
    again, _ = made(EvenRun.whole(run), RIG, noise)
    without, _ = made(EvenRun.whole(run), RIG, NOISE._replace(deviation=np.zeros(3)))
    apart = again.run.columns["tau_w_N_m"] - without.run.columns["tau_w_N_m"]
    assert np.std(apart) == pytest.approx(NOISE.deviation[1], rel=0.1)
    assert np.corrcoef(apart[1:], apart[:-1])[0, 1] == pytest.approx(0.9, abs=0.03)
    steps = again.run.columns["current_A"] / noise.resolution[2]
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-6)


def test_lost_rows_stay_lost() -> None:
    (run,) = runs_of(RIG, ("short_hold",), 6130)
    lost = np.zeros(len(run), dtype=np.bool_)
    lost[1000:1003] = True
    record, passed = beside(EvenRun.whole(run), RIG)
    even = EvenRun(run, lost, 2.0, "whole")
    again = replicate(even, record, passed, RIG, parameters.vector(RIG), NOISE, np.random.default_rng(0))
    assert np.flatnonzero(again.lost).tolist() == [row - record.settling_rows for row in (1000, 1001, 1002)]
    assert again.of == "whole"
    assert again.begin_s == pytest.approx(2.0 + record.settling_rows * 1e-3)
