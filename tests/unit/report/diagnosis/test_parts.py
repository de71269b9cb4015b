"""Parts of a diagnosis's report: binned means, spectra, prefixes, numbers in words, which run and where."""

import numpy as np
import pytest

from hil_forceps.diagnosis.result import Diagnosis, Estimate, RunEvidence
from hil_forceps.report.diagnosis.figures.bins import binned, edges_of, smoothed, spectrum, strided
from hil_forceps.report.diagnosis.figures.view import channels, telling_run, telling_window
from hil_forceps.report.diagnosis.names import parameter_words, quantity, scale_for
from hil_forceps.report.diagnosis.words import equation, number, percent, unit_words, with_interval


def test_the_interval_of_a_bin_counts_visits_not_rows() -> None:
    random = np.random.default_rng(3)
    visits, rows = 400, 50
    variable = np.repeat(np.tile([0.25, 0.75], visits), rows)
    values = np.repeat(random.standard_normal(2 * visits), rows)  # one draw per visit: rows add nothing
    mean = binned(variable, values, np.array([0.0, 0.5, 1.0]))
    half = (mean.high - mean.low) / 2
    assert half == pytest.approx(1.96 / np.sqrt(visits), rel=0.1)
    assert np.all(np.abs(mean.mean) < 3 / np.sqrt(visits))
    assert mean.mean == pytest.approx([values[variable < 0.5].mean(), values[variable > 0.5].mean()])


def test_bins_without_rows_or_with_few_visits_have_no_mean_or_no_limits() -> None:
    edges = np.array([0.0, 1.0, 2.0, 3.0])
    mean = binned(np.array([0.5, 0.5, np.nan, 2.5, 9.0]), np.array([1.0, 3.0, 5.0, np.nan, 7.0]), edges)
    assert mean.mean == pytest.approx([2.0, np.nan, np.nan], nan_ok=True)
    assert np.all(np.isnan(mean.low))
    assert np.all(np.isnan(binned(np.zeros(0), np.zeros(0), edges).mean))


def test_edges_need_a_variable_that_varies() -> None:
    assert edges_of(np.full(1000, 2.0)) is None
    assert edges_of(np.full(1000, np.nan)) is None
    edges = edges_of(np.linspace(-1, 1, 1000), bins=10)
    assert edges is not None
    assert len(edges) == 11


def test_white_noise_stands_at_its_floor_and_a_sine_at_its_frequency() -> None:
    random = np.random.default_rng(5)
    time_s = np.arange(60_000, dtype=np.float64) * 1e-3
    found = spectrum(time_s, 2e-3 * random.standard_normal(len(time_s)))
    assert found is not None
    assert np.sqrt(np.mean(found[1] ** 2)) == pytest.approx(2e-3 * np.sqrt(2e-3), rel=0.03)
    sine = spectrum(time_s, np.sin(2 * np.pi * 40 * time_s))
    assert sine is not None
    assert sine[0][np.argmax(sine[1])] == pytest.approx(40, abs=0.3)
    assert np.sum(sine[1] ** 2) * (sine[0][1] - sine[0][0]) == pytest.approx(0.5, rel=0.02)  # power of the sine
    assert spectrum(time_s[:100], time_s[:100]) is None
    grid, density = smoothed(*found)
    assert len(grid) < 160
    assert np.median(density) == pytest.approx(2e-3 * np.sqrt(2e-3), rel=0.05)


def test_a_stride_keeps_at_most_what_is_asked() -> None:
    for rows, most in ((10, 100), (100, 100), (101, 100), (10_000_000, 200_000)):
        assert len(range(rows)[strided(rows, most)]) <= most


@pytest.mark.parametrize(
    ("unit", "largest", "factor", "shown"),
    [
        ("rad", 0.7, 1.0, "rad"),
        ("rad", 4e-3, 1e3, "mrad"),
        ("rad", 4000.0, 1.0, "rad"),
        ("N m", 2e-3, 1e3, "mN m"),
        ("N m", 4e-6, 1e6, "µN m"),
        ("A", 0.1, 1.0, "A"),
        ("N", 2500.0, 1e-3, "kN"),
        ("", 1e-6, 1.0, ""),
        ("A", 0.0, 1.0, "A"),
        ("A", float("nan"), 1.0, "A"),
    ],
)
def test_prefixes(unit: str, largest: float, factor: float, shown: str) -> None:
    scale = scale_for(unit, [-largest, 0.1 * largest])
    assert scale.factor == pytest.approx(factor)
    assert scale.unit == shown


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (1.0, "1"),
        (-0.0123, "−0.0123"),
        (1234.0, "1230"),
        (2.06e-6, "2.06 × 10<sup>−6</sup>"),
        (-2.6e4, "−2.6 × 10<sup>4</sup>"),
        (float("nan"), "–"),
        (None, "–"),
    ],
)
def test_numbers(value: float | None, text: str) -> None:
    assert number(value) == text


def test_intervals_share_their_power_and_show_what_they_know() -> None:
    text = with_interval(Estimate(2.06e-6, 1.98e-6, 2.14e-6, "m"))
    assert text == '<span class="n">2.06 (1.98 … 2.14) × 10<sup>−6</sup> m</span>'
    assert "0.0213 (0.0197 … 0.0229)" in with_interval(Estimate(0.0213, 0.0197, 0.0229))
    assert "1.00 (0.50 … –)" in with_interval(Estimate(1.0, 0.5, float("inf")))
    assert with_interval(Estimate(float("nan"), 0.0, 1.0)) == "–"
    assert "3.000 (3.000 … 3.000)" in with_interval(Estimate(3.0, 3.0, 3.0))


def test_words() -> None:
    assert percent(0.981) == "98.1 %"
    assert percent(float("inf")) == "–"
    assert unit_words("per_m2") == "1/m²"
    assert unit_words("N_m_s_per_rad") == "N m s/rad"
    assert equation("F_m += a & b") == "F<sub>m</sub> += a &amp; b"
    assert parameter_words("forceps.wire_stiffness_N_per_m") == "wire stiffness"
    assert quantity("spring_force_N") == ("spring force", "spring force", "N")
    assert quantity("$x$").words == r"\$x\$"


def test_the_run_and_the_window_with_the_largest_misfit_are_shown() -> None:
    time_s = np.arange(3000, dtype=np.float64) * 1e-3
    zero = np.zeros(3000)
    wrong = np.where((time_s > 1.0) & (time_s < 1.2), 5.0, 0.0)
    measured = {"current_A": zero, "theta_m_rad": zero}
    runs = tuple(
        RunEvidence(name, False, time_s, measured, {"current_A": off, "theta_m_rad": small}, {}, {}, {}, {})
        for name, off, small in (("good", zero, zero + 0.1), ("bad", wrong, zero))
    )
    diagnosis = Diagnosis("unnamed", "", runs=runs, noise_sd={"current_A": 1.0, "theta_m_rad": 1.0})
    run = telling_run(diagnosis)
    assert run is runs[1]
    assert channels(diagnosis) == ("current_A", "theta_m_rad")
    window = telling_window(diagnosis, runs[1])
    assert np.count_nonzero(wrong[window]) == np.count_nonzero(wrong)
    assert telling_run(diagnosis, held_out=True) is None
