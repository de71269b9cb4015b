"""What frames take of a bus: the bounds agree with those of the simulated bus, which counts bits on its own."""

import pytest

from hil_forceps.drives.line_use import LineUse, most_bits
from virtual_bus.bus.bit_timing import INTERMISSION_BITS, frame_bits_bounds

FD_LENGTHS = (0, 1, 7, 8, 12, 16, 20, 24, 32, 48, 64)


@pytest.mark.parametrize("is_extended", [False, True])
@pytest.mark.parametrize("is_fd", [False, True])
def test_as_many_bits_as_the_simulated_bus_has_at_most(is_fd: bool, is_extended: bool) -> None:
    for length in FD_LENGTHS if is_fd else range(9):
        most = frame_bits_bounds(length, is_fd, is_extended)[1]
        assert most_bits(length, is_fd, is_extended) == (most.nominal + INTERMISSION_BITS, most.data)


def test_times_add_up() -> None:
    use = LineUse()
    for _ in range(1000):
        use.add(8, False, False)
    assert use.time_s(1_000_000, 5_000_000) == pytest.approx(0.135)
    use.add(64, True, True)
    assert use.time_s(1_000_000, 5_000_000) > 0.135
