"""The menu of experiments: within limits, what it offers, and its files."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil_forceps.cli.arguments.trajectory_file import read_trajectory, write_trajectory
from hil_forceps.control.gate import Gate, GateVerdict
from hil_forceps.diagnosis.experiment_design.menu import Bounds, Experiment, bounds_of, menu, trajectory_of
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.sections import Limits
from tests.hidden_effects.generator import RIG

LIMITED = RIG.with_changes(
    {
        "limits.position_min_rad": -1.0,
        "limits.position_max_rad": 2.0,
        "limits.speed_max_rad_per_s": 30.0,
        "limits.acceleration_max_rad_per_s2": 2e4,
    }
)
ALWAYS = {"slow_ramps_and_holds", "chirp", "load_hold_and_release", "warm_up", "orientation_flip", "known_spring"}


def test_the_menu_holds_what_it_should() -> None:
    found = menu(bounds_of(LIMITED, 0.0, 0.0))
    assert {e.name for e in found} == ALWAYS | {"small_motions", "rest"}
    assert {e.name for e in found if e.loaded} == {"load_hold_and_release", "known_spring"}
    assert [e.name for e in found if e.turned_over] == ["orientation_flip"]
    assert all(e.instruction and "\n" not in e.instruction and e.excites for e in found)


def test_a_spin_is_offered_where_there_is_room_for_turns() -> None:
    wide = LIMITED.with_changes({"limits.position_min_rad": -14.0, "limits.position_max_rad": 14.0})
    spin = next(e for e in menu(bounds_of(wide, 0.0, 0.0)) if e.name == "multi_turn_spin")
    assert float(np.ptp(spin.theta_m_rad)) > 1.5 * 2.0 * math.pi


def test_a_rig_without_limits_moves_no_further_than_it_did() -> None:
    for experiment in menu(bounds_of(RIG, -0.3, 0.5)):
        assert -0.3 < experiment.theta_m_rad.min() <= experiment.theta_m_rad.max() < 0.5


@settings(max_examples=40, deadline=None)
@given(
    low=st.floats(-20.0, 0.0),
    span=st.floats(0.01, 40.0),
    speed=st.floats(0.5, 200.0),
    acceleration=st.floats(100.0, 1e5),
)
def test_every_motion_on_the_menu_passes_the_gate_untouched(
    low: float, span: float, speed: float, acceleration: float
) -> None:
    limits = Limits(
        position_min_rad=low,
        position_max_rad=low + span,
        speed_max_rad_per_s=speed,
        acceleration_max_rad_per_s2=acceleration,
    )
    bounds = Bounds(low, low + span, 0.5 * speed, 0.5 * acceleration, 1e-3, 1e-3)
    offered = menu(bounds)
    assert "rest" in {e.name for e in offered}
    for experiment in offered:
        ticks = np.arange(0.0, min(float(experiment.time_s[-1]), 4.0), 1e-3)
        wanted = np.interp(ticks, experiment.time_s, experiment.theta_m_rad)
        gate = Gate(limits)
        gate.see(-1_000_000, -1_000_000, float(wanted[0]), 0.0)
        gate.open(-1_000_000)
        for tick, angle in enumerate(wanted.tolist()):
            gate.see(tick * 1_000_000, tick * 1_000_000, angle, 0.0)
            _, verdict = gate.step(angle, tick * 1_000_000)
            assert verdict in {GateVerdict.OPENED, GateVerdict.PASSED}, (experiment.name, tick)


def within(experiment: Experiment, bounds: Bounds) -> bool:
    """Whether a motion respects the bounds; at a corner the speed changes within one tick."""
    angle = experiment.theta_m_rad
    speed = np.diff(angle) / np.diff(experiment.time_s)
    acceleration = np.diff(np.concatenate(([0.0], speed, [0.0]))) / bounds.tick_s
    return bool(
        bounds.low_rad <= angle.min() <= angle.max() <= bounds.high_rad
        and np.abs(speed).max() <= bounds.speed_rad_per_s
        and np.abs(acceleration).max() <= bounds.acceleration_rad_per_s2
    )


def test_every_motion_is_within_the_bounds_and_larger_ones_are_not() -> None:
    bounds = bounds_of(LIMITED, 0.0, 0.0)
    found = {e.name: e for e in menu(bounds)}
    assert all(within(e, bounds) for e in found.values())
    slow = found["slow_ramps_and_holds"]
    assert not within(slow._replace(theta_m_rad=2.0 * slow.theta_m_rad), bounds)
    assert not within(slow._replace(time_s=slow.time_s / 100.0), bounds)
    jump = slow.theta_m_rad.copy()
    jump[1000] += 0.05
    assert not within(slow._replace(theta_m_rad=jump), bounds)


def test_no_range_is_a_wrong_call() -> None:
    with pytest.raises(ValueError, match="no range"):
        menu(bounds_of(RIG, 0.2, 0.2))


def test_what_is_written_for_run_is_read_back(tmp_path: Path) -> None:
    ratio = RIG.plant().motor_pulley_radius_m / RIG.plant().jaw_pulley_radius_m
    for experiment in menu(bounds_of(LIMITED, 0.0, 0.0)):
        path = tmp_path / f"{experiment.name}.csv"
        write_trajectory(trajectory_of(experiment, LIMITED), path)
        read = read_trajectory(path)
        angles = np.array([read(float(t)) for t in experiment.time_s[::50]])
        assert np.abs(angles - ratio * experiment.theta_m_rad[::50]).max() < 1e-8
        assert read.times_s[-1] == pytest.approx(experiment.time_s[-1])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", ":1: the first line must be time_s,theta_j_rad"),
        ("time_s,theta_m_rad\n0,0\n", ":1: the first line must be"),
        ("time_s,theta_j_rad\n", "contains no points"),
        ("time_s,theta_j_rad\n0,0\n1,x\n", ":3: '1,x' is not two finite numbers"),
        ("time_s,theta_j_rad\n0,0\n1,2,3\n", ":3: '1,2,3' is not two finite numbers"),
        ("time_s,theta_j_rad\n0,nan\n", ":2: '0,nan' is not two finite numbers"),
        ("time_s,theta_j_rad\n0,0\n0,1\n", ":3: time_s does not increase"),
    ],
)
def test_a_broken_trajectory_file_says_where(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "broken.csv"
    path.write_text(text)
    with pytest.raises(UserError) as caught:
        read_trajectory(path)
    assert said in str(caught.value)
