"""Trajectories and the compensator (10)."""

import math
from typing import Any

import numpy as np
import pytest

from hil_forceps.control.compensator import motor_reference_rad
from hil_forceps.control.trajectories import Trajectory, paper_jaw_reference
from hil_forceps.rig.plant import PlantParameters

PAPER = PlantParameters(2.0e-3, 1.4e-3, 3.18e-8, 6.85e-8, 1.16e-4, 4.62e-7, 4.62e-9, 2.6e4, 1.35e-2)


@pytest.mark.parametrize(
    ("t_s", "degrees"), [(-1e9, 90.0), (-0.001, 90.0), (0.0, 90.0), (2.5, 50.0), (5.0, 10.0), (20.0, 10.0)]
)
def test_paper_reference(t_s: float, degrees: float) -> None:
    assert paper_jaw_reference(t_s) == pytest.approx(math.radians(degrees), abs=1e-15)


def test_points_are_met_exactly_and_joined_by_lines() -> None:
    trajectory = Trajectory((-1.0, 0.5, 2.0), (0.25, 1.0, -0.5))
    assert [trajectory(t) for t in (-2.0, -1.0, 0.5, 2.0, 3.0)] == [0.25, 0.25, 1.0, -0.5, -0.5]
    assert trajectory(-0.25) == pytest.approx(0.625)
    assert trajectory(1.25) == pytest.approx(0.25)


@pytest.mark.parametrize("points", [((0.0, 5.0), (1.5, 0.2)), ((-1.0, 0.5, 2.0), (0.25, 1.0, -0.5)), ((3.0,), (0.5,))])
def test_many_times_at_once_have_the_bits_of_single_calls(points: tuple[tuple[float, ...], tuple[float, ...]]) -> None:
    trajectory = Trajectory(*points)
    times = np.concatenate((np.random.default_rng(0).uniform(-2.0, 6.0, 500), points[0]))
    np.testing.assert_array_equal(trajectory.angles(times), [trajectory(t) for t in times.tolist()])


def test_one_point_is_a_constant() -> None:
    assert [Trajectory((0.0,), (0.7,))(t) for t in (-1.0, 0.0, 1.0)] == [0.7, 0.7, 0.7]


def test_nan_comes_out_as_nan() -> None:
    assert math.isnan(paper_jaw_reference(math.nan))


@pytest.mark.parametrize(
    ("times", "angles", "says"),
    [
        ((), (), "one at least"),
        ((0.0, 1.0), (0.0,), "there are 2 times and 1 angles; give as many of each"),
        ((0.0, 0.0), (0.0, 1.0), r"times_s\[1\]: 0 s does not come after 0 s; sort the points"),
        ((1.0, 0.0), (0.0, 1.0), "does not come after"),
        ((0.0, math.inf), (0.0, 1.0), r"times_s\[1\]: is inf; must be a finite number"),
        ((0.0, 1.0), (0.0, math.nan), r"angles_rad\[1\]: is nan"),
    ],
)
def test_nonsense_is_refused(times: tuple[float, ...], angles: tuple[float, ...], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        Trajectory(times, angles)


def test_arrays_and_lists_are_taken() -> None:
    assert Trajectory(np.array([0.0, 1.0]), [1, np.float64(0.5)]) == Trajectory((0.0, 1.0), (1.0, 0.5))
    assert type(Trajectory(np.arange(2), np.arange(2)).times_s[1]) is float


@pytest.mark.parametrize("values", ["12", 3, None, [[0.0, 1.0]], np.zeros((2, 2)), ["0", "1"]])
def test_what_holds_no_numbers_is_named(values: Any) -> None:
    with pytest.raises(TypeError, match=r"^angles_rad(\[0\])?: must be a (list|number)"):
        Trajectory((0.0, 1.0), values)


def test_compensation_of_the_stretch_under_2_mN_m() -> None:
    plain = motor_reference_rad(math.radians(10.0), 0.0, PAPER)
    assert plain == pytest.approx(0.7 * math.radians(10.0))
    # 54.945 µm of wire on a pulley of 2 mm
    assert motor_reference_rad(math.radians(10.0), 54.945e-6, PAPER) - plain == pytest.approx(27.4725e-3)
