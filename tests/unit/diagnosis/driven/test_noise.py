"""The noise of driven runs: where strokes repeat, what no model explains yet isn't taken for noise."""

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.data.run import Run
from hil_forceps.diagnosis.driven.noise import noise_of_strokes
from hil_forceps.diagnosis.driven.passed import DrivenRun, driven_runs
from hil_forceps.diagnosis.driven.rows import driven_rows
from hil_forceps.diagnosis.driven.starting_values import completed
from hil_forceps.rig import load_rig

Vector = NDArray[np.float64]
TIME: Vector = np.arange(20_000, dtype=np.float64) * 1e-3
NOISE_N_m = 2e-5


def run_of(misfit_N_m: float, *, repeats: bool, name: str = "a", seed: int = 1) -> Run:
    """A motion with a torque that no parameter of a plain forceps explains."""
    rng = np.random.default_rng(seed)
    phase = 2.0 * np.pi * (0.4 * TIME if repeats else 0.1 * TIME + 0.02 * TIME**2)
    theta = 0.5 * np.sin(phase)
    load = 1e-3 * np.cos(phase)
    torque = load + misfit_N_m * np.tanh(3.0 * np.sin(3.0 * theta)) + NOISE_N_m * rng.standard_normal(TIME.size)
    columns = {"time_s": TIME, "theta_m_rad": theta, "tau_m_N_m": torque, "tau_w_N_m": load}
    return Run(name, {**columns, "theta_j_rad": theta + 1e-4 * rng.standard_normal(TIME.size)})


def made_of(*runs: Run) -> list[DrivenRun]:
    rows, _ = driven_rows(list(runs))
    completed(rows, load_rig("configs/paper.yaml"))
    return driven_runs(rows)


def test_what_every_stroke_repeats_is_no_noise() -> None:
    plain = noise_of_strokes(made_of(run_of(0.0, repeats=True)))
    beside_misfit = noise_of_strokes(made_of(run_of(1e-3, repeats=True)))
    assert plain is not None
    assert beside_misfit is not None
    assert set(plain) == {"tau_m_N_m", "theta_j_rad"}
    # The last row of the filters: one over the deviation of what the rows before don't tell.
    told, beside = 1.0 / plain["tau_m_N_m"].taps[-1, 0], 1.0 / beside_misfit["tau_m_N_m"].taps[-1, 0]
    assert beside == pytest.approx(told, rel=0.05)
    slow = plain["tau_m_N_m"].taps[-1].sum() / beside_misfit["tau_m_N_m"].taps[-1].sum()
    assert slow == pytest.approx(1.0, rel=0.2)


def test_filters_of_strokes_make_the_noise_white() -> None:
    (run,) = made_of(run_of(0.0, repeats=True))
    filters = noise_of_strokes([run])
    assert filters is not None
    (fresh,) = made_of(run_of(0.0, repeats=True, seed=2))
    for name, mean in (
        ("tau_m_N_m", 1e-3 * np.cos(0.8 * np.pi * TIME)),
        ("theta_j_rad", 0.5 * np.sin(0.8 * np.pi * TIME)),
    ):
        values = fresh.rows.channels[name]
        noise = values - np.interp(fresh.rows.time_s, TIME, mean)
        left = filters[name].of(noise[:, np.newaxis], fresh.mask)[fresh.mask, 0]
        assert float(np.mean(left**2)) == pytest.approx(1.0, abs=0.2), name


def test_runs_that_mostly_do_not_repeat_have_none() -> None:
    once, again = run_of(0.0, repeats=False, name="once"), run_of(0.0, repeats=True, name="again")
    assert noise_of_strokes(made_of(once)) is None
    assert noise_of_strokes(made_of(once, run_of(0.0, repeats=False, name="too"), again)) is None
    assert noise_of_strokes(made_of(once, again, run_of(0.0, repeats=True, name="more"))) is not None
