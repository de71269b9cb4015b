"""What all tests share: the same examples at every run, no judging by the clock, and the longest first."""

import pytest
from hypothesis import HealthCheck, settings

settings.register_profile(
    "house",
    deadline=None,  # machines differ and the first call compiles
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("house")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put what is slow first: a long test that begins last keeps one process busy and the others idle."""
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)
