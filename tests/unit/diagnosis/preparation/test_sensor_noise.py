"""Deviation, colour and resolution of the sensors' noise, from the data alone."""

from dataclasses import replace

import numpy as np
import pytest

from hil_forceps.data.run import Run
from hil_forceps.diagnosis.preparation.resolution import resolution_of
from hil_forceps.diagnosis.preparation.sensor_noise import sensor_noise
from tests.hidden_effects.drawn_cases import draw, make
from tests.hidden_effects.generator import COLOURED, RIG, WHITE, NoiseKind, generate
from tests.hidden_effects.generator_scenarios import SCENARIOS

TRUE = np.array([RIG.noise.theta_j_rad, RIG.noise.tau_w_N_m, RIG.noise.current_A])
KINDS = ("teleoperation", "slow", "trapezoid")
UNTOLD = RIG.with_changes({"noise.theta_j_rad": 0.0, "noise.tau_w_N_m": 0.0, "noise.current_A": 0.0})


def runs(kind: NoiseKind) -> list[Run]:
    return [generate(RIG, SCENARIOS[name], 40 + place, kind, name) for place, name in enumerate(KINDS)]


def test_white_noise_is_found_where_the_rig_says_none() -> None:
    noise = sensor_noise(runs(WHITE), UNTOLD)
    assert noise.deviation == pytest.approx(TRUE, rel=0.03)
    assert not noise.correlation.any()
    assert not noise.resolution.any()


def test_coloured_noise_is_told_from_white() -> None:
    noise = sensor_noise(runs(COLOURED), UNTOLD)
    assert noise.correlation == pytest.approx(np.full(3, COLOURED.correlation), abs=0.06)
    driving = noise.deviation**2 * (1.0 - noise.correlation**2)  # what is new in each row: all that a filter sees of it
    assert driving == pytest.approx(TRUE**2 * (1.0 - COLOURED.correlation**2), rel=0.15)


def test_a_loop_that_hunts_over_a_coarse_count_does_not_colour_the_jaw_sensor() -> None:
    hunting = replace(draw("pair", 9700, usual=True), kind="none", effects=())
    assert (hunting.counts, hunting.law) == (2048, "PI")
    case = make(hunting)
    noise = sensor_noise(case.fit, case.assumed)
    assert noise.deviation[0] == pytest.approx(TRUE[0], rel=0.05)
    assert not noise.correlation.any()


def test_steps_of_a_converter_are_found_and_are_no_noise() -> None:
    step = 2.0e-4
    coarse = []
    for run in runs(WHITE):
        current = np.rint((run.columns["current_A"] - run.columns["current_A"].mean()) / step) * step
        smooth = np.rint(np.convolve(current, np.full(201, 1.0 / 201.0), mode="same") / step) * step
        coarse.append(Run(run.name, {**run.columns, "tau_w_N_m": smooth}))
    noise = sensor_noise(coarse, RIG)
    assert noise.resolution == pytest.approx([0.0, step, 0.0])  # a shunt's noise is as wide as five of its steps
    assert resolution_of([np.random.default_rng(0).standard_normal(1000)]) == 0.0


def test_no_sensor_is_taken_to_be_better_than_the_integrators() -> None:
    still = RIG.with_changes({"noise.theta_j_rad": 0.0, "noise.tau_w_N_m": 0.0, "noise.current_A": 0.0})
    noiseless = [generate(still, SCENARIOS[name], 40, name=name) for name in KINDS]
    noise = sensor_noise(noiseless, still)
    spans = [max(float(np.ptp(run.columns[c])) for run in noiseless) for c in ("theta_j_rad", "tau_w_N_m", "current_A")]
    assert np.all(noise.deviation >= np.array(spans) * [1e-4, 1e-3, 1e-4] * (1.0 - 1e-12))
