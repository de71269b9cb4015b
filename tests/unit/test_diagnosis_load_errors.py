"""Noise of a measured load: how far it leaves the course open, what that does to the channels, and both made white."""

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.diagnosis.experiment import Record
from hil_forceps.diagnosis.linear import Response, columns
from hil_forceps.diagnosis.load_course import load_course
from hil_forceps.diagnosis.load_errors import with_load_errors
from hil_forceps.diagnosis.low_rank import LoadErrors, decompose, scale
from hil_forceps.diagnosis.smoothing import LoadNoise, drawn_noise, noise_filter, smooth_load, whitening_matrix
from hil_forceps.diagnosis.spectrum import (
    Layout,
    make_layout,
    measure_noise,
    power_of_load,
    transform,
    white_noise,
    whitening,
)
from hil_forceps.diagnosis.straight import BLOCKS, straight_course
from tests.hidden_effects.generator import RIG, run_seed, simulate
from tests.hidden_effects.generator_scenarios import SCENARIOS

Vector = NDArray[np.float64]

COURSE = "hil_forceps.diagnosis.load_course"
ROWS, PERIOD_S = 4000, 1e-3
TIME_S: Vector = PERIOD_S * np.arange(ROWS, dtype=np.float64)
NONE = np.empty(0, dtype=np.intp)
SD_N_M = 1e-5
WHITE = LoadNoise(np.array([0.0, 500.0]), np.full(2, SD_N_M**2))
COLOURED = LoadNoise(np.array([0.0, 5.0, 50.0, 500.0]), SD_N_M**2 * np.array([9.0, 9.0, 1.0, 0.3]))
# Slow, but for a burst between 2 and 2.5 s.
LOAD_N_M = 1e-3 * np.sin(2.0 * TIME_S) + 2e-4 * np.sin(2.0 * np.pi * 25.0 * TIME_S) * np.exp(
    -(((TIME_S - 2.25) / 0.1) ** 2)
)
BURST, CALM = slice(2150, 2350), slice(500, 1500)
SENSORS = {"theta_m_rad": 1e-5, "theta_j_rad": 3e-5}


def error_of(noisy: Vector, edges: NDArray[np.intp], noise: LoadNoise) -> Vector:
    error = load_course(noisy, edges, PERIOD_S, noise).error
    assert error is not None
    return error.astype(np.float64)


def draws(noise: LoadNoise, edges: NDArray[np.intp] = NONE, load: Vector = LOAD_N_M) -> NDArray[np.float64]:
    """Errors of the course in many draws of the noise (draws, rows)."""
    found = []
    for seed in range(40):
        noisy = load + drawn_noise(np.random.default_rng(seed), ROWS, PERIOD_S, noise)
        found.append(load_course(noisy, edges, PERIOD_S, noise).load - load)
    return np.array(found)


@pytest.mark.parametrize("noise", [WHITE, COLOURED], ids=["white", "coloured"])
def test_errors_are_as_large_as_foretold_where_the_load_bends_and_elsewhere(noise: LoadNoise) -> None:
    errors = draws(noise)
    noisy = LOAD_N_M + drawn_noise(np.random.default_rng(99), ROWS, PERIOD_S, noise)
    foretold = np.sum(error_of(noisy, NONE, noise) ** 2, axis=1)
    for span in (BURST, CALM):
        assert np.sqrt(np.mean(errors[:, span] ** 2) / np.mean(foretold[span])) == pytest.approx(1.0, abs=0.15)
    assert np.mean(foretold[BURST]) > 4.0 * np.mean(foretold[CALM])
    # It isn't bent: what all draws have in common is a small part of what one of them does.
    assert np.std(errors.mean(axis=0)[BURST]) < 0.35 * np.std(errors[:, BURST])


def slow_noise(sd_N_m: float) -> LoadNoise:
    """Noise with a correlation of 0.9 from row to row."""
    frequency = np.geomspace(0.1, 500.0, 60)
    turn = np.exp(-2j * np.pi * frequency * PERIOD_S)
    return LoadNoise(frequency, np.asarray(sd_N_m**2 * 0.19 / np.abs(1.0 - 0.9 * turn) ** 2))


@pytest.mark.parametrize(("scenario", "straight"), [("spin", False), ("slow", True)])
def test_pieces_so_short_that_noise_hides_how_a_load_bends_are_not_straight(scenario: str, straight: bool) -> None:
    _, run = simulate(RIG, SCENARIOS[scenario], run_seed(17307, 0))
    load, noise = np.asarray(run.tau_w_N_m), slow_noise(2.0 * SD_N_M)
    noisy = load + drawn_noise(np.random.default_rng(0), load.size, PERIOD_S, noise)
    pieces = straight_course(noisy, load.size // BLOCKS, PERIOD_S, noise)
    assert pieces is not None  # within the noise both are
    found = load_course(noisy, NONE, PERIOD_S, noise)
    assert found.straight is straight
    whitened = whitening_matrix(noise_filter(noise, PERIOD_S), load.size)
    off, of_pieces = (float(np.sum((whitened @ (one - load)) ** 2)) for one in (found.load, pieces.load))
    assert found.error is not None
    assert off < 1.5 * found.error.shape[1]
    assert straight or of_pieces > 2.0 * off


def stands_out(scenario: str) -> float:
    """χ² in motor and jaw of what the courses of a load have in common that is wrong, over what they say is open."""
    _, run = simulate(RIG, SCENARIOS[scenario], run_seed(11500, 3))
    load, count = np.asarray(run.tau_w_N_m)[:ROWS], 6
    noises = [drawn_noise(np.random.default_rng(seed), ROWS, PERIOD_S, WHITE) for seed in range(count)]
    courses = [load_course(load + noise, NONE, PERIOD_S, WHITE) for noise in noises]
    layout, sensors = laid_out(a_record()._replace(load_error=courses[0].error))
    wrong = np.mean([course.load for course in courses], axis=0) - load
    white = whitening(layout, white_noise(layout, sensors)).apply(
        columns(layout, [answer()], "jaw", [wrong[None]])[:, 0]
    )
    return float(np.sum(white.astype(np.float64) ** 2))


@pytest.mark.parametrize(("scenario", "most"), [("multisine_mid", 10.0), ("slow", 10.0), ("grasp", 150.0)])
def test_no_bend_of_a_load_stands_out(scenario: str, most: float, monkeypatch: pytest.MonkeyPatch) -> None:
    told = stands_out(scenario)
    assert told < most  # a sixth of what the course leaves open is in it: much where a touch bends the load
    monkeypatch.setattr(f"{COURSE}.straight_course", lambda *_: None)
    # As smooth all along as nothing is that has corners.
    monkeypatch.setattr("hil_forceps.diagnosis.smooth_course.FOLLOWS", (0.0,))
    monkeypatch.setattr("hil_forceps.diagnosis.smooth_course.ORDERS", (6,))
    assert stands_out(scenario) > 20.0 * told


def test_a_jump_stays_where_it_is_and_rows_too_few_to_fit_stay_as_measured() -> None:
    step = np.where(np.arange(ROWS) > 1999, 1e-3, 0.0)
    edges = np.array([1999, 2002], dtype=np.intp)
    noisy = step + drawn_noise(np.random.default_rng(1), ROWS, PERIOD_S, WHITE)
    found = load_course(noisy, edges, PERIOD_S, WHITE)
    assert np.abs(found.load[1980:2000]).max() < 2e-5
    assert np.abs(found.load[2003:2020] - 1e-3).max() < 2e-5
    assert np.array_equal(found.load[2000:2003], noisy[2000:2003])
    assert np.sum(error_of(noisy, edges, WHITE)[2001] ** 2) == pytest.approx(SD_N_M**2, rel=1e-3)


def test_what_is_one_line_between_jumps_is_told_as_one() -> None:
    edges = np.r_[199:ROWS:600, 269:ROWS:600].astype(np.intp)
    edges.sort()
    steps = 1e-3 * np.where(np.arange(edges.size) % 2, -1.0, 1.0)
    load = (
        np.concatenate([[0.0], np.cumsum(steps)])[np.searchsorted(edges, np.arange(ROWS))]
        + 5e-5 * np.arange(ROWS) / ROWS
    )
    noises = [drawn_noise(np.random.default_rng(seed), ROWS, PERIOD_S, WHITE) for seed in range(10)]
    fitted = [load_course(load + noise, edges, PERIOD_S, WHITE).fitted for noise in noises]
    assert fitted.count(2 * (edges.size + 1)) >= 7  # none by Akaike's criterion alone


def test_no_noise_leaves_nothing_open() -> None:
    none = LoadNoise(WHITE.frequency_Hz, np.zeros(2))
    found = load_course(LOAD_N_M, NONE, PERIOD_S, none)
    assert found.load is LOAD_N_M
    assert error_of(LOAD_N_M, NONE, none).shape == (ROWS, 0)


def test_a_load_that_bends_too_often_is_smoothed_and_its_error_not_told(monkeypatch: pytest.MonkeyPatch) -> None:
    noisy = LOAD_N_M + drawn_noise(np.random.default_rng(2), ROWS, PERIOD_S, WHITE)
    wanted = error_of(noisy, NONE, WHITE).shape[1]
    monkeypatch.setattr(f"{COURSE}.MOST_KNOTS", wanted // 2)
    found = load_course(noisy, NONE, PERIOD_S, WHITE)
    assert found.error is None
    assert np.array_equal(found.load, smooth_load(noisy, NONE, PERIOD_S, WHITE))


def answer() -> Response:
    """A motor and a jaw that follow a load up to some Hz, the jaw more stiffly."""
    frequency = np.fft.rfftfreq(ROWS, PERIOD_S)
    low: NDArray[np.complex128] = np.asarray(1.0 / (1.0 + 1j * frequency / 20.0), dtype=np.complex128)
    return Response({"jaw": {"theta_m_rad": np.asarray(8.0 * low**2), "theta_j_rad": np.asarray(20.0 * low)}})


def a_record(seed: int = 7) -> Record:
    noisy = LOAD_N_M + drawn_noise(np.random.default_rng(seed), ROWS, PERIOD_S, WHITE)
    course = load_course(noisy, NONE, PERIOD_S, WHITE)
    nothing = {name: np.zeros(ROWS) for name in SENSORS}
    return Record(
        "a", "closed_loop", PERIOD_S, TIME_S, np.zeros(ROWS), nothing, course.load, NONE, np.ones(ROWS), True,
        load_noise=WHITE, load_error=course.error,
    )  # fmt: skip


def laid_out(record: Record) -> tuple[Layout, Vector]:
    layout = make_layout([list(SENSORS)], [record.weights], [PERIOD_S])
    sensors = np.array([SENSORS[name] ** 2 for name in layout.band_channel])
    return with_load_errors(layout, [record], [answer()], sensors), sensors


def residual(layout: Layout, record: Record, rng: np.random.Generator) -> NDArray[np.float32]:
    """What a simulation leaves that is driven by the course of a noisy load."""
    assert record.tau_w_N_m is not None
    own = transform(layout, [{name: sd * rng.standard_normal(ROWS) for name, sd in SENSORS.items()}])
    return own + columns(layout, [answer()], "jaw", [(record.tau_w_N_m - LOAD_N_M)[None]])[:, 0]


def test_noise_in_bursts_is_white_over_time_and_between_channels() -> None:
    burst: dict[str, list[float]] = {"white": [], "plain": []}
    between = {"white": 0.0, "plain": 0.0}
    draws = 12
    for seed in range(draws):
        record = a_record(seed)
        layout, sensors = laid_out(record)
        whitener = whitening(layout, white_noise(layout, sensors))
        plain = whitening(layout._replace(load=()), white_noise(layout, sensors))
        motor, jaw = layout.parts
        flat = residual(layout, record, np.random.default_rng([seed, 5]))
        for name, how in (("white", whitener), ("plain", plain)):
            white = how.apply(flat)
            course = np.fft.irfft(white[motor.start : motor.stop].view(np.complex64), ROWS) * np.sqrt(ROWS / 2.0)
            burst[name].append(float(np.mean(course[BURST] ** 2)))
            low = [white[part.start : part.start + 120].astype(float) for part in (motor, jaw)]
            between[name] += float(low[0] @ low[1]) / np.sqrt(120.0 * draws)
    assert np.mean(burst["white"]) == pytest.approx(1.0, abs=0.2)
    assert np.mean(burst["plain"]) > 3.0  # what would be without
    assert abs(between["white"]) < 4.0 < 0.1 * abs(between["plain"])  # of white noise: normal, of deviation 1


def test_the_sensors_noise_is_found_beside_the_load_s() -> None:
    record = a_record()
    layout, sensors = laid_out(record)
    nothing = np.empty((layout.size, 0), dtype=np.float32)
    flat = residual(layout, record, np.random.default_rng(3))
    noise = white_noise(layout, 4.0 * sensors)  # a wrong guess
    for _ in range(4):
        whitener = whitening(layout, noise)
        noise = measure_noise(layout, whitener, whitener.apply(flat), nothing)
    ratio = noise.power / sensors
    count = np.bincount(layout.band_of)
    assert ratio[count > 300] == pytest.approx(np.ones(np.count_nonzero(count > 300)), rel=0.25)
    assert np.all((ratio > 0.3) & (ratio < 5.0))
    # Where the load's error hides all, what was taken to be the noise stands; all together the load's is far larger.
    assert power_of_load(layout).max() > 30.0 * sensors.max()


def test_whitening_is_undone_and_matrices_are_whitened_column_by_column() -> None:
    layout, sensors = laid_out(a_record())
    whitener = whitening(layout, white_noise(layout, sensors))
    flat = np.random.default_rng(4).standard_normal((layout.size, 3)).astype(np.float32)
    white = whitener.apply(flat)
    assert white[:, 1] == pytest.approx(whitener.apply(flat[:, 1]), rel=1e-3, abs=1.0)
    back = whitener.undo(white[:, 2].copy())
    assert np.linalg.norm(back - flat[:, 2]) < 1e-3 * np.linalg.norm(flat[:, 2])


def test_a_low_rank_covariance_is_made_white() -> None:
    rng = np.random.default_rng(5)
    columns = rng.standard_normal((50, 4)).astype(np.float32) * np.array([100.0, 10.0, 1.0, 0.1], dtype=np.float32)
    factor = rng.uniform(0.5, 2.0, 80).astype(np.float32)
    entries = np.sort(rng.choice(80, 50, replace=False))
    (low,) = decompose([LoadErrors(entries, columns)], factor)
    whole = np.zeros((80, 4))
    whole[entries] = factor[entries, None] * columns
    covariance = (np.eye(80) + whole @ whole.T).astype(np.float32)
    for _ in range(2):  # from both sides
        covariance = np.ascontiguousarray(covariance.T)
        scale(covariance, [low], [1.0 / np.sqrt(1.0 + low.power)])
    assert covariance == pytest.approx(np.eye(80), abs=0.02)


def test_without_known_errors_the_layout_stays_as_it_is() -> None:
    layout, sensors = laid_out(a_record())
    bare = with_load_errors(layout, [a_record()._replace(load_error=None)], [answer()], sensors)
    assert bare.load == ()
