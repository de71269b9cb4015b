"""What all tests share: the same examples at every run, no judging by the clock, and the longest first."""

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

settings.register_profile(
    "house",
    deadline=None,  # machines differ and the first call compiles
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("house")


@pytest.fixture(scope="session", autouse=True)
def interruptible() -> Iterator[None]:
    """Let tests and what they start be stopped: in a shell's background SIGINT is ignored, under nohup SIGHUP."""
    numbers = (signal.SIGINT, signal.SIGHUP, signal.SIGTERM)
    before = [signal.signal(number, signal.SIG_DFL) for number in numbers]
    signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """With `-m "mark and not another"`, leave out files that don't name the mark: importing all takes a minute."""
    terms = config.getoption("markexpr").split(" and ")
    wanted = [f"mark.{term}" for term in terms if term.isidentifier()]
    if not wanted or collection_path.suffix != ".py" or not collection_path.name.startswith("test_"):
        return None
    text = collection_path.read_text(encoding="utf-8")
    return None if all(each in text for each in wanted) else True


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put what is slow first: a long test that begins last keeps one process busy and the others idle."""
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)
