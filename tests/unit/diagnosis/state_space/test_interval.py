import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import special

from hil_forceps.diagnosis.state_space.interval import interval_likelihood


def by_logarithms(low: float, high: float, mean: float, deviation: float) -> tuple[float, float, float]:
    """Log probability, score and information, by scipy's logarithm of the normal distribution."""
    a, b = (low - mean) / deviation, (high - mean) / deviation
    near, far = (a, b) if a + b >= 0.0 else (-b, -a)
    top, bottom = special.log_ndtr(-near), special.log_ndtr(-far)
    log_p = top + math.log1p(-math.exp(bottom - top))

    def density(x: float) -> float:
        return math.exp(-0.5 * x * x - 0.5 * math.log(2.0 * math.pi) - log_p)

    score = density(a) - density(b)
    information = score**2 - (a * density(a) - b * density(b))
    return log_p, score / deviation, information / deviation**2


@given(
    mean=st.floats(-30.0, 30.0),
    width=st.floats(0.02, 40.0),
    deviation=st.floats(0.05, 5.0),
)
@settings(max_examples=300, deadline=None)
def test_an_interval_agrees_with_logarithms(mean: float, width: float, deviation: float) -> None:
    log_p, score, information = interval_likelihood(-width / 2, width / 2, mean, deviation)
    wanted = by_logarithms(-width / 2, width / 2, mean, deviation)
    assert log_p == pytest.approx(wanted[0], rel=1e-5, abs=1e-8)
    # The logarithms' own differences lose as many digits as the interval is narrow and far off.
    reach, narrow = (abs(mean) + width) / deviation, min(1.0, width / deviation)
    lost = 1e-14 * (1.0 + reach) ** 3 / narrow**2
    assert score * deviation == pytest.approx(wanted[1] * deviation, rel=1e-4, abs=1e-6 + lost)
    assert information * deviation**2 == pytest.approx(wanted[2] * deviation**2, abs=1e-4 + lost)


@pytest.mark.parametrize("mean", [0.0, 1e3, -1e3, 1e8, -1e12])
@pytest.mark.parametrize("width", [1e-9, 1.0, 1e3])
def test_a_measurement_never_adds_variance_nor_takes_more_than_there_is(mean: float, width: float) -> None:
    log_p, score, information = interval_likelihood(-width / 2, width / 2, mean, 1.0)
    assert all(map(math.isfinite, (log_p, score, information)))
    assert 0.0 <= information <= 1.0
    assert score * mean <= 0.0
