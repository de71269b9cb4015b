import json

import numpy as np
import pytest

from hil_forceps.bridge.statistics import STAMP_PERIOD_NS, Histogram, StampMap, make_loop_statistics

MS = 1_000_000


def test_percentiles_agree_with_numpy_to_a_bin() -> None:
    durations = np.random.default_rng(1).gamma(2.0, 200_000.0, 5_000).astype(int)
    histogram = Histogram(bin_ns=1_000, bins=10_000)
    for duration in durations.tolist():
        histogram.add(duration)
    for share in (0.0, 0.01, 0.5, 0.99, 0.999, 1.0):
        exact = int(np.quantile(durations, share, method="inverted_cdf"))
        found = histogram.percentile_ns(share)
        assert found is not None
        assert 0 <= found - exact <= 1_000, share
    assert histogram.max_ns == durations.max()
    assert histogram.total_ns == durations.sum()


def test_what_does_not_fit_is_counted_apart() -> None:
    histogram = Histogram(bin_ns=10, bins=10)
    for duration in (-5, 0, 99, 100, 12345):
        histogram.add(duration)
    summary = histogram.summary()
    assert (summary["count"], summary["above_range"], summary["below_zero"]) == (5, 2, 1)
    assert sum(count for _, count in summary["bins"]) + summary["above_range"] == 5
    assert summary["max_us"] == 12.345
    assert histogram.percentile_ns(1.0) == 12345


def test_an_empty_histogram_has_no_figures_and_all_of_them_are_json() -> None:
    summary = make_loop_statistics().summary()
    assert summary["lateness"]["p50_us"] is None
    assert json.loads(json.dumps(summary))["period"]["bins"] == []


def test_wrong_calls_raise() -> None:
    with pytest.raises(ValueError, match="share"):
        Histogram().percentile_ns(1.5)
    with pytest.raises(ValueError, match="bins"):
        Histogram(bins=0)
    with pytest.raises(ValueError, match="window"):
        StampMap(window=0)
    with pytest.raises(ValueError, match="no sample"):
        StampMap().host_time_ns(0)


def test_stamps_of_the_same_clock_map_exactly_whatever_the_delay() -> None:
    boot_ns = 3 * STAMP_PERIOD_NS + 123_456_000  # stamps have wrapped three times
    stamps = StampMap(same_clock=True)
    for k, delay_ns in enumerate((350_000, 90_000, 2_000_000)):
        stamp_ns = 123_456_000 + k * 1_000_000
        stamps.see(stamp_ns, boot_ns + k * 1_000_000 + delay_ns)
        assert stamps.host_time_ns(stamp_ns) == boot_ns + k * 1_000_000


def test_the_least_delay_of_the_window_maps_the_stamps() -> None:
    stamps = StampMap(window=10)
    delays = np.random.default_rng(2).integers(100_000, 900_000, 200)
    for k, delay in enumerate(delays.tolist()):
        stamps.see(k * MS, k * MS + 7_000_000_000 + delay)
        offset = stamps.host_time_ns(0)
        least = delays[max(0, k - 9) : k + 1].min()
        assert offset <= 7_000_000_000 + least
        assert offset >= 7_000_000_000 + delays[max(0, k - 21) : k + 1].min()


@pytest.mark.parametrize("ppm", [-100, 100])
def test_a_drifting_clock_is_followed(ppm: int) -> None:
    stamps = StampMap(window=100)
    worst = 0
    for k in range(5_000):
        taken_ns = k * 1_000_000
        stamp_ns = taken_ns + taken_ns * ppm // 1_000_000
        stamps.see(stamp_ns, taken_ns + 200_000)
        worst = max(worst, abs(stamps.host_time_ns(stamp_ns) - taken_ns - 200_000))
    assert worst <= 200 * MS * abs(ppm) // 1_000_000 + 1_000


def test_a_drive_clock_that_steps_back_is_followed_after_two_windows() -> None:
    stamps = StampMap(window=50)
    wrong = 0
    for k in range(1000):
        taken_ns = k * MS
        stamp_ns = taken_ns - (15 * MS if k >= 300 else 0)
        stamps.see(stamp_ns, taken_ns + 100_000)
        wrong += stamps.host_time_ns(stamp_ns) != taken_ns + 100_000
    assert 50 <= wrong <= 100
