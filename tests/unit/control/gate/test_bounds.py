"""Bounds of the feedback out of a rig: each by hand."""

import math
from pathlib import Path

import pytest

from hil_forceps.control.gate.bounds import feedback_bounds, greatest_current_A
from hil_forceps.rig import Rig, load_rig

CONFIGS = Path(__file__).parents[4] / "configs"
RIG = load_rig(CONFIGS / "realistic.yaml")
# By hand from Table I: K_t i = 13.5 mN m at 1 A, range 2.1 rad, 16384 counts.
TORQUE, RANGE, COUNT = 1.35e-2, 2.1, 2.0 * math.pi / 16384
INERTIA = 3.18e-8 + (2.0 / 1.4) ** 2 * 6.85e-8


def changed(**changes: object) -> Rig:
    return RIG.with_changes({key.replace("__", "."): value for key, value in changes.items()})


def driver(profile: str, **more: object) -> dict[str, object]:
    return {"profile": profile, **more}


def test_the_realistic_rig_by_hand() -> None:
    bounds = feedback_bounds(RIG)
    assert bounds.plant == RIG.plant()
    assert bounds.jump_speed_rad_per_s == pytest.approx(3.0 * TORQUE / 1.16e-4)  # 349 rad/s
    assert bounds.jump_slack_rad == pytest.approx(8.0 * COUNT)
    assert bounds.still_s == pytest.approx(0.1 + 2.0 * 2.0e-4)
    assert bounds.still_travel_rad == 0.01
    assert bounds.still_travel_alone_rad == pytest.approx(0.01 + 0.5)  # 1 A at 2 A/rad
    assert bounds.strong_A == 0.5
    speed = TORQUE / 1.16e-4
    braking = 0.5 * INERTIA * speed * speed / (0.5 * TORQUE)
    assert bounds.against_travel_rad == pytest.approx(0.01 + braking + 2.0 * TORQUE / (2.6e4 * 4.0e-6))
    assert (bounds.tension_max_N, bounds.current_max_A) == (math.inf, math.inf)
    assert bounds.hold_s == 0.05


def test_limits_of_the_rig_are_taken_as_they_are() -> None:
    bounds = feedback_bounds(changed(limits__tension_max_N=3.0, limits__current_max_A=0.7))
    assert (bounds.tension_max_N, bounds.current_max_A) == (3.0, 0.7)


def test_a_coarse_encoder_has_its_counts_and_an_ideal_one_those_of_the_wire() -> None:
    coarse = feedback_bounds(changed(encoder__counts_per_rev=2048))
    assert coarse.still_travel_rad == pytest.approx(8.0 * 2.0 * math.pi / 2048)
    assert coarse.jump_slack_rad == coarse.still_travel_rad
    ideal = feedback_bounds(changed(encoder__counts_per_rev="ideal"))
    assert ideal.jump_slack_rad == pytest.approx(8.0 * 2.0 * math.pi / (1 << 24))
    assert ideal.still_travel_rad == 0.01


@pytest.mark.parametrize("damping", [0.0, 1e-9])
def test_without_viscous_friction_the_range_bounds_the_speed(damping: float) -> None:
    bounds = feedback_bounds(changed(forceps__motor_viscous_N_m_s_per_rad=damping))
    assert bounds.jump_speed_rad_per_s == pytest.approx(math.sqrt(2.0 * 3.0 * TORQUE * RANGE / 3.18e-8))


def test_the_drives_gain_says_what_gives_all_its_current() -> None:
    assert feedback_bounds(changed(drive__kp_A_per_rad=4.0)).still_travel_alone_rad == pytest.approx(0.26)
    assert feedback_bounds(changed(drive__kp_A_per_rad=0.98)).still_travel_alone_rad == pytest.approx(0.01 + 1.0 / 0.98)
    unknown = changed(motor_driver=driver("odrive", current_limit_A=0.5)).model_copy(update={"drive": None})
    assert feedback_bounds(unknown).still_travel_alone_rad == pytest.approx(0.01 + 1.05)
    for gain in (0.0, 0.1):  # then half of the range
        assert feedback_bounds(changed(drive__kp_A_per_rad=gain)).still_travel_alone_rad == pytest.approx(0.01 + 1.05)


def test_where_the_rig_does_not_say_what_limits_the_current_its_checks_are_off() -> None:
    bounds = feedback_bounds(RIG.model_copy(update={"drive": None}))
    assert bounds.jump_speed_rad_per_s == math.inf
    assert bounds.jump_slack_rad == pytest.approx(8.0 * COUNT)  # and no NaN, which would be a jump
    assert (bounds.strong_A, bounds.against_travel_rad) == (math.inf, math.inf)
    assert bounds.still_travel_alone_rad == pytest.approx(0.01 + 1.05)


def test_stamps_of_arrival_are_off_and_those_of_the_drive_are_not() -> None:
    bounds = feedback_bounds(changed(motor_driver=driver("odrive"), limits__max_sample_age_s=2e-3))
    assert bounds.jump_slack_rad == pytest.approx(8.0 * COUNT + 2e-3 * bounds.jump_speed_rad_per_s)
    assert feedback_bounds(changed(motor_driver=driver("native"))).jump_slack_rad == pytest.approx(8.0 * COUNT)


@pytest.mark.parametrize(
    ("profile", "drive_A", "driver_A", "greatest"),
    [
        *((name, 1.0, 2.0, 2.0) for name in ("odrive", "dynamixel", "moteus")),
        ("odrive", 3.0, 2.0, 3.0),
        ("odrive", None, 2.0, 2.0),
        *((name, 1.0, 2.0, 1.0) for name in ("cia402", "vesc", "native")),
        ("cia402", None, 2.0, math.inf),
    ],
)
def test_the_greatest_current_is_that_of_the_drive_or_what_it_is_told(
    profile: str, drive_A: float | None, driver_A: float, greatest: float
) -> None:
    rig = changed(motor_driver=driver(profile, current_limit_A=driver_A), drive__current_limit_A=drive_A or 1.0)
    assert greatest_current_A(rig if drive_A else rig.model_copy(update={"drive": None})) == greatest


@pytest.mark.parametrize(("watchdog_s", "hold_s"), [(0.1, 0.05), (0.06, 0.03), (1.0, 0.05), (0.0, 0.05)])
def test_a_freeze_ends_before_the_drives_watchdog(watchdog_s: float, hold_s: float) -> None:
    rig = changed(motor_driver=driver("odrive", watchdog_s=watchdog_s))
    assert feedback_bounds(rig).hold_s == hold_s


@pytest.mark.parametrize("path", sorted([*CONFIGS.glob("drives/*.yaml"), CONFIGS / "paper.yaml"]), ids=str)
def test_every_shipped_rig_has_all_checks(path: Path) -> None:
    bounds = feedback_bounds(load_rig(path))
    assert all(map(math.isfinite, (*bounds[1:8], bounds.hold_s)))
