"""Smoothing of the load, and the whitening of residuals."""

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.diagnosis.smoothing import LoadNoise, smooth_load
from hil_forceps.diagnosis.spectrum import (
    Flat,
    Layout,
    Noise,
    make_layout,
    measure_noise,
    tapered,
    transform,
    white_noise,
    whitening,
)

ROWS, RUNS, PERIOD_S = 4000, 3, 1e-3
NO_EDGES = np.empty(0, dtype=np.intp)
Vector = NDArray[np.float64]


def coloured(rng: np.random.Generator, correlation: float) -> Vector:
    fresh = rng.standard_normal(ROWS) * np.sqrt(1.0 - correlation**2)
    values = np.empty(ROWS)
    last = rng.standard_normal()
    for k in range(ROWS):
        last = correlation * last + fresh[k]
        values[k] = last
    return values


def two_channels() -> Layout:
    weights = [np.ones(ROWS)] * RUNS
    return make_layout([("theta_m_rad", "theta_j_rad")] * RUNS, weights, [PERIOD_S] * RUNS)


def measured(layout: Layout, flat: Flat, used: Flat | None = None) -> Noise:
    """Noise of a residual, begun from white noise; `used`: orthonormal columns."""
    start = whitening(layout, white_noise(layout, np.ones(len(layout.band_channel))))
    fitted = np.empty((layout.size, 0), dtype=np.float32) if used is None else used
    return measure_noise(layout, start, start.apply(flat), fitted)


def test_smoothing_takes_noise_out_of_a_slow_load_and_keeps_the_load() -> None:
    rng = np.random.default_rng(1)
    time = np.arange(ROWS) * PERIOD_S
    load = np.sin(2 * np.pi * 0.8 * time)
    smooth = smooth_load(load + 0.02 * rng.standard_normal(ROWS), NO_EDGES, PERIOD_S)
    assert np.std(smooth - load) < 0.25 * 0.02


def test_smoothing_leaves_a_jump_where_it_is() -> None:
    rng = np.random.default_rng(2)
    load = np.where(np.arange(ROWS) <= 1500, 0.0, 1.0)
    noisy = load + 0.01 * rng.standard_normal(ROWS)
    smooth = smooth_load(noisy, np.array([1500], dtype=np.intp), PERIOD_S)
    assert abs(smooth[1500]) < 0.02
    assert abs(smooth[1501] - 1.0) < 0.02


def test_coloured_noise_is_smoothed_once_its_colour_is_known() -> None:
    rng = np.random.default_rng(4)
    time = np.arange(ROWS) * PERIOD_S
    load = np.sin(2 * np.pi * 0.3 * time)
    noise = 0.02 * coloured(rng, 0.9)
    frequency = np.linspace(0.0, 0.5 / PERIOD_S, 200)
    power = 0.02**2 * 0.19 / np.abs(1.0 - 0.9 * np.exp(-2j * np.pi * frequency * PERIOD_S)) ** 2
    taken_as_white = smooth_load(load + noise, NO_EDGES, PERIOD_S) - load
    known = smooth_load(load + noise, NO_EDGES, PERIOD_S, LoadNoise(frequency, power)) - load
    assert np.std(known) < 0.7 * np.std(taken_as_white)
    assert np.std(np.diff(known)) < 0.1 * np.std(np.diff(taken_as_white))


def test_a_constant_load_stays_as_it_is() -> None:
    assert np.array_equal(smooth_load(np.full(100, 2.0), NO_EDGES, PERIOD_S), np.full(100, 2.0))


def test_the_transform_keeps_the_variance_of_white_noise() -> None:
    layout = two_channels()
    rng = np.random.default_rng(3)
    outputs = [{name: 0.3 * rng.standard_normal(ROWS) for name in ("theta_m_rad", "theta_j_rad")} for _ in range(RUNS)]
    flat = transform(layout, outputs)
    variance = np.mean([np.mean(flat[part.start + 2 : part.stop - 2] ** 2) for part in layout.parts])
    assert variance == pytest.approx(0.09, rel=0.05)


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.9, 0.98])
def test_whitening_makes_noise_of_any_colour_white(correlation: float) -> None:
    layout = two_channels()
    rng = np.random.default_rng(4)
    outputs = [
        {"theta_m_rad": coloured(rng, correlation), "theta_j_rad": 1e-3 * coloured(rng, correlation)}
        for _ in range(RUNS)
    ]
    flat = transform(layout, outputs)
    white = whitening(layout, measured(layout, flat)).apply(flat)
    power = np.bincount(layout.band_of, weights=white.astype(float) ** 2) / np.bincount(layout.band_of)
    assert power == pytest.approx(np.ones(power.size), rel=1e-3)  # of every band, on which it was measured
    # Within bands, too: entries of the lower and of the upper half have the same power.
    halves = []
    for band in range(power.size):
        entries = np.flatnonzero(layout.band_of == band)
        middle = entries.size // 2
        halves.append(np.mean(white[entries[:middle]] ** 2) - np.mean(white[entries[middle:]] ** 2))
    assert abs(float(np.mean(halves))) < 0.15


def test_a_step_between_the_ends_of_a_run_does_not_show_at_high_frequencies() -> None:
    layout = make_layout([("theta_m_rad",)], [np.ones(ROWS)], [PERIOD_S])
    [part] = layout.parts
    ramp = np.linspace(0.0, 1.0, ROWS)
    power = transform(layout, [{"theta_m_rad": ramp}]).astype(float) ** 2
    frequency = np.repeat(np.fft.rfftfreq(ROWS, PERIOD_S), 2)
    high = power[frequency > 30.0].sum() / power.sum()
    spectrum = np.abs(np.fft.rfft(ramp)) ** 2
    untapered = spectrum[np.fft.rfftfreq(ROWS, PERIOD_S) > 30.0].sum() / spectrum.sum()
    assert high < 1e-3 * untapered
    assert part.weights[0] < 0.01 > part.weights[-1]
    assert part.weights[ROWS // 2] == 1.0


def test_the_taper_begins_where_rows_begin_to_count_and_spares_a_short_run() -> None:
    weights = np.ones(200)
    weights[:50] = 0.0
    found = tapered(weights, PERIOD_S)
    assert not found[:50].any()
    assert 0.0 < found[50] < 0.1
    assert np.count_nonzero(found == 1.0) >= 0.75 * 150
    assert not tapered(np.zeros(10), PERIOD_S).any()


def test_each_run_has_its_own_noise_where_its_bands_are_wide_enough() -> None:
    layout = two_channels()
    rng = np.random.default_rng(6)
    loud = (1.0, 3.0, 0.5)
    outputs = [{n: much * rng.standard_normal(ROWS) for n in ("theta_m_rad", "theta_j_rad")} for much in loud]
    flat = transform(layout, outputs)
    white = whitening(layout, measured(layout, flat)).apply(flat)
    for part in layout.parts:
        half = part.start + (part.stop - part.start) // 2  # from 250 Hz on
        assert np.mean(white[half : part.stop] ** 2) == pytest.approx(1.0, rel=0.05)
    first, other = (set(layout.band_of[part.start : part.stop].tolist()) for part in layout.parts[:3:2])
    shared = sorted(first & other)
    assert len(shared) > 3
    assert max(layout.band_Hz[shared]) < 60.0


def test_a_corner_is_kept_where_slow_noise_is_strong_and_fast_noise_weak() -> None:
    rng = np.random.default_rng(7)
    load = 3.0 * np.abs(np.arange(ROWS) % 800 - 400) / 400.0
    noise = 0.02 * coloured(rng, 0.98)
    frequency = np.linspace(0.0, 0.5 / PERIOD_S, 200)
    power = 0.02**2 * (1.0 - 0.98**2) / np.abs(1.0 - 0.98 * np.exp(-2j * np.pi * frequency * PERIOD_S)) ** 2
    error = smooth_load(load + noise, NO_EDGES, PERIOD_S, LoadNoise(frequency, power)) - load
    corners = np.concatenate([np.arange(k - 15, k + 15) for k in range(400, ROWS - 15, 400)])
    calm = np.setdiff1d(np.arange(ROWS), np.concatenate([corners + shift for shift in (-40, 0, 40)]))
    quick = np.diff(error, n=2, prepend=error[:2])
    assert np.std(quick[corners]) < 3.0 * np.std(np.diff(noise, n=2))
    assert np.std(error[calm]) < 0.03


def test_the_motor_s_share_is_taken_out_of_the_jaw() -> None:
    layout = two_channels()
    rng = np.random.default_rng(5)
    outputs = []
    for _ in range(RUNS):
        motor = coloured(rng, 0.9)
        outputs.append({"theta_m_rad": motor, "theta_j_rad": 1.4 * motor + 0.05 * rng.standard_normal(ROWS)})
    flat = transform(layout, outputs)
    noise = measured(layout, flat)
    jaw = np.array([name == "theta_j_rad" for name in layout.band_channel])
    assert noise.mix[jaw] == pytest.approx(1.4, abs=0.05)
    assert not noise.mix[~jaw].any()
    assert np.sqrt(noise.power[jaw]) == pytest.approx(0.05, rel=0.2)
    white = whitening(layout, noise).apply(flat)
    for part in layout.parts:
        assert np.mean(white[part.start : part.stop] ** 2) == pytest.approx(1.0, rel=0.2)


def test_undo_is_the_inverse_and_columns_are_whitened_alike() -> None:
    layout = two_channels()
    rng = np.random.default_rng(6)
    bands = len(layout.band_channel)
    mix = np.where([name == "theta_j_rad" for name in layout.band_channel], 0.7 + 0.2j, 0.0)
    whitener = whitening(layout, Noise(rng.uniform(0.5, 2.0, bands), mix))
    flat = rng.standard_normal((layout.size, 2)).astype(np.float32)
    white = whitener.apply(flat)
    assert white[:, 1] == pytest.approx(whitener.apply(flat[:, 1]), abs=1e-5)
    assert whitener.undo(white[:, 0].copy()) == pytest.approx(flat[:, 0], abs=1e-5)


def test_rows_without_weight_do_not_count() -> None:
    weights = np.ones(ROWS)
    weights[:1000] = 0.0
    layout = make_layout([("current_A",)], [weights], [PERIOD_S])
    rng = np.random.default_rng(7)
    values = rng.standard_normal(ROWS)
    changed = np.where(weights > 0.0, values, 99.0)
    assert np.array_equal(transform(layout, [{"current_A": values}]), transform(layout, [{"current_A": changed}]))


def test_what_a_fit_has_used_up_counts_as_noise() -> None:
    layout = make_layout([("current_A",)], [np.ones(ROWS)], [PERIOD_S])
    flat = np.ones(layout.size, dtype=np.float32)
    plain = measured(layout, flat)
    assert plain.power == pytest.approx(np.ones(len(layout.band_channel)))
    assert not plain.mix.any()
    one = np.flatnonzero(layout.band_of == 3)
    used = np.zeros((layout.size, one.size // 2), dtype=np.float32)
    used[one[: one.size // 2], np.arange(one.size // 2)] = 1.0
    found = measured(layout, flat, used)
    assert found.power[3] == pytest.approx(one.size / (one.size - one.size // 2))
    assert np.delete(found.power, 3) == pytest.approx(np.ones(len(layout.band_channel) - 1))
