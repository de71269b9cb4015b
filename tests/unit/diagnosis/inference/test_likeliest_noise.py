"""Noise by the likelihood of all channels, where differences of one take a hunting loop for it."""

from dataclasses import replace

import numpy as np
import pytest

from hil_forceps.data.even_rows import even_rows
from hil_forceps.diagnosis.identification import known_of, records_of
from hil_forceps.diagnosis.inference.fit import fit
from hil_forceps.diagnosis.inference.likeliest_noise import DENSITY_FACTOR, likeliest_noise
from hil_forceps.diagnosis.preparation.sensor_noise import least_deviations, sensor_noise
from hil_forceps.diagnosis.state_space.layout import Noise
from hil_forceps.model import parameters
from tests.hidden_effects.generator import COLOURED, RIG, WHITE, NoiseKind, generate, true_rig
from tests.hidden_effects.generator_scenarios import SCENARIOS

TRUE_DEVIATION = np.array([2.0e-4, 1.0e-5, 1.0e-3])
HUNTING = RIG.with_changes(
    {
        "drive.ki_A_per_rad_s": 0.0,
        "drive.kd_A_s_per_rad": 0.0,
        "drive.sample_time_s": 2.0e-3,
        "encoder.counts_per_rev": 2048,
    }
)


def both(
    kind: NoiseKind, effects: dict[str, dict[str, float]], least_share: float | None = None
) -> tuple[Noise, Noise]:
    """Return the noise by differences, and that by likelihood; no less than this share of it."""
    true = true_rig(HUNTING, effects, {})
    scenarios = [replace(SCENARIOS[name], row_s=2.0e-3) for name in ("multisine_mid", "chirp")]
    runs = [generate(true, scenario, at, kind, f"{at}") for at, scenario in enumerate(scenarios)]
    by_differences = sensor_noise(runs, HUNTING)
    even = [rows for run in runs if (rows := even_rows(run, HUNTING))]
    theta = parameters.vector(HUNTING)
    records, _ = records_of(even, [], HUNTING, by_differences, map, theta)
    found = fit(records, theta, known_of(HUNTING, records), map)
    least = least_deviations(runs) if least_share is None else least_share * by_differences.deviation
    return by_differences, likeliest_noise(by_differences, least, records, found, map)


@pytest.mark.parametrize("kind", [WHITE, COLOURED], ids=["white", "coloured"])
def test_a_loop_that_hunts_is_no_noise(kind: NoiseKind) -> None:
    by_differences, by_likelihood = both(kind, {})
    assert by_differences.deviation[0] > 1.5 * TRUE_DEVIATION[0]
    assert by_likelihood.deviation == pytest.approx(TRUE_DEVIATION, rel=0.12)
    assert by_likelihood.correlation == pytest.approx(kind.correlation, abs=0.03)


def density(noise: Noise) -> float:
    """Return that of the load cell's noise at low frequencies."""
    correlation = noise.correlation[1]
    return float(noise.deviation[1] ** 2 * (1.0 + correlation) / (1.0 - correlation))


def test_what_the_model_lacks_is_no_noise() -> None:
    before, after = both(COLOURED, {"jaw_gravity": {"cosine_N_m": 2.0e-4, "sine_N_m": 1.0e-4}})
    assert density(after) <= 1.01 * DENSITY_FACTOR * density(before)


def test_no_sensor_becomes_better_than_the_equations_are() -> None:
    before, after = both(WHITE, {}, 0.9)
    assert before.deviation[0] > 1.5 * TRUE_DEVIATION[0]
    assert 0.9 * before.deviation[0] <= after.deviation[0] < before.deviation[0]


def test_a_deviation_that_is_as_small_as_the_equations_allow_stays() -> None:
    before, after = both(WHITE, {}, 1.0)
    assert after is before
