"""Noise is white within each band, too, where what the load cell's noise does is known."""

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis import linear
from hil_forceps.diagnosis.experiment import Record
from hil_forceps.diagnosis.linear import Response
from hil_forceps.diagnosis.noise_shape import shaped
from hil_forceps.diagnosis.smoothing import LoadNoise, noise_left, smooth_load
from hil_forceps.diagnosis.spectrum import JAW, Layout, followed, make_layout, measure_noise, transform, whitening
from tests.hidden_effects.generator import RIG

Vector = NDArray[np.float64]

PERIOD_S, ROWS, SETS = 1e-3, 6000, 60
NOISE_N_M = 1e-5
SENSORS = {"theta_m_rad": 1e-5, JAW: 2e-4}
NONE = np.empty(0, dtype=np.intp)
WHITE = LoadNoise(np.array([0.0, 500.0]), np.full(2, NOISE_N_M**2))


TIME_S: Vector = PERIOD_S * np.arange(ROWS, dtype=np.float64)
LOAD_N_M: Vector = 1e-3 * np.sin(2.0 * np.pi * 0.5 * TIME_S)


def a_record() -> Record:
    left = noise_left(LOAD_N_M, NONE, PERIOD_S, WHITE)
    channels = {name: np.zeros(ROWS) for name in SENSORS}
    return Record(
        "run", "closed_loop", PERIOD_S, TIME_S, np.zeros(ROWS), channels, LOAD_N_M, NONE, np.ones(ROWS), True,
        load_noise=WHITE, load_noise_left=left,
    )  # fmt: skip


def answer() -> Response:
    return linear.responses(RIG.plant(), RIG.require_drive(), ROWS, PERIOD_S)


def flat_and_shaped(record: Record) -> tuple[Layout, Layout]:
    """Return the layout of a run with even bands, and the same with what is known of the noise."""
    layout = make_layout([list(SENSORS)], [record.weights], [PERIOD_S])
    sensors = np.array([SENSORS[name] ** 2 for name in layout.band_channel])
    return layout, shaped(layout, [record], [answer()], sensors)


def residuals(response: Response, seed: int) -> dict[str, Vector]:
    """Return what a load measured with noise, and smoothed, leaves in a simulation without any error."""
    rng = np.random.default_rng(seed)
    wrong = smooth_load(LOAD_N_M + NOISE_N_M * rng.standard_normal(ROWS), NONE, PERIOD_S, WHITE) - LOAD_N_M
    return {
        name: np.fft.irfft(np.fft.rfft(wrong) * response.gains["jaw"][name], ROWS)
        + deviation * rng.standard_normal(ROWS)
        for name, deviation in SENSORS.items()
    }


def lowest_over_rest(layout: Layout) -> float:
    """Return the whitened power of the jaw's lowest bins over that of the rest of their band."""
    response = answer()
    low, rest = [], []
    for seed in range(SETS):
        flat = transform(layout, [residuals(response, seed)])
        white = whitening(layout, measure_noise(layout, flat)).apply(flat)
        part = next(part for part in layout.parts if part.channel == JAW)
        own = white[part.start : part.stop].astype(float) ** 2
        first = layout.band_of[part.start : part.stop] == layout.band_of[part.start]
        low.append(own[2:8].mean())
        rest.append(own[first][8:].mean())
    return float(np.mean(low) / np.mean(rest))


def test_the_lowest_bins_are_as_sure_as_they_are() -> None:
    layout, whole = flat_and_shaped(a_record())
    assert whole.shape is not None
    counts = np.bincount(layout.band_of)
    np.testing.assert_allclose(np.bincount(layout.band_of, weights=whole.shape) / counts, 1.0, rtol=1e-4)
    assert lowest_over_rest(layout) > 1.65
    assert lowest_over_rest(whole) < 1.45  # tapering lets the motor's slow noise into its lowest bins


def test_without_the_load_s_noise_bands_stay_flat() -> None:
    layout, same = flat_and_shaped(a_record()._replace(load_noise_left=None))
    assert same is layout


def test_smoothing_leaves_what_is_slow() -> None:
    left = a_record().load_noise_left
    assert left is not None
    slow, fast = left.power[left.frequency_Hz < 1.0], left.power[left.frequency_Hz > 50.0]
    np.testing.assert_allclose(slow, NOISE_N_M**2, rtol=0.2)
    assert fast.max() < 1e-2 * NOISE_N_M**2


def test_no_noise_leaves_none() -> None:
    none = LoadNoise(np.array([0.0, 500.0]), np.zeros(2))
    assert noise_left(np.zeros(ROWS), NONE, PERIOD_S, none) is none


def test_what_follows_is_told_band_by_band() -> None:
    layout, whole = flat_and_shaped(a_record())
    flat = transform(layout, [residuals(answer(), 1)])
    first = layout.band_channel.index(JAW)
    plain, told = (followed(each, measure_noise(each, flat))[first] for each in (layout, whole))
    # The motor turns the jaw by the ratio of both pulleys; the wire's stretch comes on top.
    assert abs(plain) > 1.3
    np.testing.assert_allclose(told, plain, rtol=0.2)
