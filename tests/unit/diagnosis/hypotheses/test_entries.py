"""Where entries of the catalogue are looked for."""

import numpy as np

from hil_forceps.diagnosis.hypotheses.entries import Probe, Scene, probes, quantiles_of_speed

REACH = (-0.6, 1.2)


def friction_places(reach: tuple[float, ...]) -> list[Probe]:
    scene = Scene(12.0, 5.0, reach, (0.1, 1.0), 1e-4, 0.3, (4.0,), (4.0,))
    return [probe for probe in probes(scene) if probe.effect_id == "jaw_position_friction"]


def level(
    probe: Probe, theta_j: np.ndarray[tuple[int], np.dtype[np.float64]]
) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return probe.start["slope_N_m_per_rad"] * theta_j + probe.start["curvature_N_m_per_rad2"] * theta_j**2


def test_friction_over_the_jaws_angle_is_looked_for_on_either_side() -> None:
    open_places = [probe for probe in friction_places(REACH) if not probe.together]
    assert {np.sign(probe.start["slope_N_m_per_rad"]) for probe in open_places} == {-1.0, 1.0}


def test_friction_that_rises_and_falls_again_is_looked_for_within_the_jaws_reach() -> None:
    theta_j = np.linspace(*REACH, 2001)
    humps = [probe for probe in friction_places(REACH) if probe.together]
    sides = []
    for probe in humps:
        there = theta_j[level(probe, theta_j) > 0.0]
        assert there.size > 0
        assert np.all(there > 0.0) or np.all(there < 0.0)
        assert np.abs(there).max() < 0.6 * (REACH[1] if there[0] > 0.0 else -REACH[0])
        sides.append(float(np.sign(there[0])))
    assert sorted(sides) == [-1.0, -1.0, -1.0, 1.0, 1.0, 1.0]


def test_a_side_that_the_jaw_does_not_reach_is_left_out() -> None:
    humps = [probe for probe in friction_places((1.2,)) if probe.together]
    assert [probe.start["slope_N_m_per_rad"] > 0.0 for probe in humps] == [True, True, True]


def test_where_the_jaw_turns_round_narrow_humps_are_looked_for_too() -> None:
    """A hump of 38 mrad (d = 50) gained nothing at 1.5 rad, 0.05 of the way, and 429 at 61 mrad."""
    humps = [probe for probe in friction_places((-0.7, 30.0)) if probe.together]
    widths = [-p.start["slope_N_m_per_rad"] / p.start["curvature_N_m_per_rad2"] for p in humps]
    np.testing.assert_allclose(widths, [-0.315, -0.105, -0.035, 13.5, 4.5, 1.5, 0.3, 0.06])


def test_a_jump_of_the_load_does_not_hide_the_slow_motion() -> None:
    """A mass that shoots ahead for 10 ms is fifty times as fast as the motion that tells friction of slow speeds."""
    motion = np.sin(np.linspace(0.0, 60.0, 12_000))
    with_a_jump = np.concatenate((motion, np.full(10, 50.0)))
    np.testing.assert_allclose(quantiles_of_speed(with_a_jump), quantiles_of_speed(motion), rtol=0.02)
    assert quantiles_of_speed(motion)[0] < 0.1


def test_speeds_do_not_depend_on_how_long_a_mass_rests() -> None:
    motion = np.sin(np.linspace(0.0, 60.0, 12_000))
    rests = 1e-3 * np.sin(np.linspace(0.0, 60.0, 50_000))
    np.testing.assert_allclose(
        quantiles_of_speed(np.concatenate((motion, rests))), quantiles_of_speed(motion), rtol=0.01
    )


def test_speeds_of_what_never_moves_are_finite() -> None:
    assert quantiles_of_speed(np.zeros(10)) == quantiles_of_speed(np.zeros(0)) == (0.1,)
