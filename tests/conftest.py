"""What all tests share: the same examples at every run, and no judging by the clock."""

from hypothesis import HealthCheck, settings

settings.register_profile(
    "house",
    deadline=None,  # machines differ and the first call compiles
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("house")
