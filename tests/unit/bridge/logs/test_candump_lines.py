"""Lines of candump's format: what Python's own formatting of each frame gives."""

import random

import pytest

from firmware_protocol.frames import Frame
from hil_forceps.bridge.logs.candump_lines import Batch, CandumpLines, microseconds

BEGIN_NS = 5_000_000_000


def line_of(time_s: float, frame: Frame, is_received: bool) -> str:
    identifier, data, is_fd, is_extended = frame
    shown = f"{identifier:08X}" if is_extended else f"{identifier:03X}"
    return f"({time_s:f}) can0 {shown}{'##1' if is_fd else '#'}{data.hex().upper()} {'R' if is_received else 'T'}\n"


def some_arrival(source: random.Random) -> tuple[int, Frame]:
    is_extended, is_fd = source.random() < 0.3, source.random() < 0.3
    identifier = source.randrange(1 << (29 if is_extended else 11))
    data = source.randbytes(source.choice((0, 1, 8, 16, 64) if is_fd else (0, 1, 7, 8)))
    time_ns = BEGIN_NS + source.randrange(10 ** source.randrange(1, 15)) - 500
    return time_ns, Frame(identifier, data, is_fd, is_extended)


@pytest.mark.parametrize("seed", range(20))
def test_a_batch_is_its_lines(seed: int) -> None:
    source, lines, last_s = random.Random(seed), CandumpLines(), 0.0
    for _ in range(10):
        arrivals = [[some_arrival(source) for _ in range(source.randrange(4))] for _ in range(source.randrange(30))]
        batch: Batch = [(source.random() < 0.5, each) for each in arrivals]
        expected = ""
        for is_received, frames in batch:
            for time_ns, frame in frames:
                last_s = max(last_s, (time_ns - BEGIN_NS) * 1e-9)
                expected += line_of(last_s, frame, is_received)
        assert lines.of(batch, BEGIN_NS) == expected


@pytest.mark.parametrize("seed", range(20))
def test_times_are_rounded_as_python_does(seed: int) -> None:
    source = random.Random(seed)
    halves = [source.randrange(1 << 40) / 2.0**digits for digits in range(20, 41) for _ in range(20)]
    stamps = [(source.randrange(10 ** source.randrange(1, 13)) * 1000 + 500) * 1e-9 for _ in range(400)]
    for time_s in [0.0, *halves, *stamps, *(source.random() * 10.0**size for size in range(-8, 8))]:
        assert microseconds(time_s) == int(f"{time_s:f}".replace(".", "")), time_s
