"""The rule of dry friction over a step, for one free mass of I/h = 1 under a torque that changes along a line."""

import numpy as np
import pytest

from hil_forceps.model.step.friction import MOVING, STOPPED, Levels, Response, friction

FREE = Response(1.0, 0.0, 0.5, -1.0 / 12.0, 1.0, 1.0)
LEVELS = Levels(1.0, 1.0, 1.0, 0.0, 0.0)


def speed_at_the_end(speed: float, first: float, last: float) -> float:
    """Return the speed at the end of a step in which the torque goes from `first` to `last`."""
    free_speed, free_way = speed + 0.5 * (first + last), speed + first / 3.0 + last / 6.0
    mean, slope, fate = friction(speed, free_speed, free_way, first, 1.0, FREE, LEVELS)
    assert np.isfinite(slope)
    return 0.0 if fate >= STOPPED else free_speed - mean


def integrated(speed: float, first: float, last: float, pieces: int = 4000) -> float:
    """Return the same by short steps, in which a mass stops where friction would turn it round."""
    for piece in range(pieces):
        torque = first + (last - first) * (piece + 0.5) / pieces
        if speed == 0.0 and abs(torque) <= 1.0:
            continue
        brakes = np.sign(speed) if speed != 0.0 else np.sign(torque)
        after = speed + (torque - brakes) / pieces
        speed = 0.0 if after * brakes < 0.0 else float(after)
    return speed


@pytest.mark.parametrize(
    ("speed", "first", "last"),
    [
        (2.0, 0.0, 0.5),
        (1.0, -8.0, -9.0),
        (1.0, -20.0, -20.0),
        (0.3, -9.0, 16.0),
        (0.05, -9.0, 12.0),
        (-0.3, 9.0, -16.0),
    ],
)
def test_a_mass_that_goes_on_turns_round_turns_twice_or_is_held_for_a_while(
    speed: float, first: float, last: float
) -> None:
    assert speed_at_the_end(speed, first, last) == pytest.approx(integrated(speed, first, last), abs=5e-3)


@pytest.mark.parametrize(("first", "last"), [(-9.0, 12.0), (9.0, -12.0), (-6.0, 9.0), (-15.0, 3.0), (-3.0, -3.0)])
def test_the_speed_at_the_end_is_continuous_in_that_at_the_start(first: float, last: float) -> None:
    """A jump over the step of a finite difference would be its answer, many thousand times too large."""
    starts = np.linspace(-0.5, 0.5, 20_002)
    ends = np.array([speed_at_the_end(float(v), first, last) for v in starts])
    assert np.abs(np.diff(ends)).max() < 2e-3


def test_a_mass_that_friction_can_hold_stops() -> None:
    assert friction(0.1, 0.1 - 0.5, 0.1 - 0.25, -0.5, 1.0, FREE, LEVELS)[2] == STOPPED
    assert friction(0.1, 0.1 - 3.0, 0.1 - 1.5, -3.0, 1.0, FREE, LEVELS)[2] == MOVING
