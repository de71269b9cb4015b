"""What a trajectory asks for, against the limits, before anything moves."""

import pytest

from hil_forceps.control.requests import Excess, first_excess
from hil_forceps.control.trajectories import PAPER_TRAJECTORY, Trajectory
from hil_forceps.rig.plant import PlantParameters
from hil_forceps.rig.sections import Limits

PLANT = PlantParameters(2.0e-3, 1.0e-3, 3.18e-8, 6.85e-8, 1.16e-4, 4.62e-7, 4.62e-9, 2.6e4, 1.35e-2)  # ratio 1/2
LIMITS = Limits(position_min_rad=-1.0, position_max_rad=2.0, speed_max_rad_per_s=10.0)


def excess(times_s: tuple[float, ...], angles_rad: tuple[float, ...], until_s: float = 100.0) -> Excess | None:
    return first_excess(Trajectory(times_s, angles_rad), until_s, PLANT, LIMITS)


@pytest.mark.parametrize(
    ("angle", "key"),
    [
        (4.0, ""), (4.0 * (1 + 1e-10), ""), (4.0 * (1 + 1e-8), "position_max_rad"),
        (-2.0, ""), (-2.0 * (1 + 1e-10), ""), (-2.0 * (1 + 1e-8), "position_min_rad"),
    ],
)  # fmt: skip
def test_positions_from_both_sides(angle: float, key: str) -> None:
    found = excess((0.0, 1.0, 2.0), (0.0, angle, 0.0))
    if key:
        assert found == Excess(1, 1.0, key, 0.5 * angle, getattr(LIMITS, key))
    else:
        assert found is None
    assert (excess((0.0,), (angle,)) is not None) is bool(key)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(("over", "is_refused"), [(0.0, False), (1e-10, False), (1e-8, True), (1.0, True)])
def test_speeds_from_both_sides(sign: float, over: float, is_refused: bool) -> None:
    found = excess((0.0, 1.0, 1.1), (0.5, 0.5, 0.5 + sign * 2.0 * (1 + over)))
    assert (found is not None) is is_refused
    if found is not None:
        assert (found.point, found.time_s, found.key, found.limit) == (2, 1.1, "speed_max_rad_per_s", 10.0)
        assert found.asked == pytest.approx(10.0 * (1 + over))


def test_what_comes_behind_the_end_of_the_run_is_not_asked_for() -> None:
    times, angles = (0.0, 1.0, 2.0, 2.001), (0.0, 3.0, 5.0, 0.0)
    assert excess(times, angles) == Excess(2, 2.0, "position_max_rad", 2.5, 2.0)
    assert excess(times, angles, until_s=1.5) is None
    assert excess(times, angles, until_s=1.0) is None
    found = excess(times, angles, until_s=1.51)
    assert found is not None
    assert found.asked == pytest.approx(2.01)


def test_the_papers_motion_is_within_its_rig() -> None:
    assert first_excess(PAPER_TRAJECTORY, 20.0, PLANT, Limits()) is None
