"""A motor that runs away is told at its drive's current limit; a load that the drive holds is not taken for one."""

import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from firmware_protocol.scales import ANGLE_LSB_RAD, CURRENT_LSB_A
from hil_forceps.cli import main as cli
from hil_forceps.data.recording.reader import read_recording
from hil_forceps.drives.registry import current_limit_A
from hil_forceps.drives.supervision.runaway import SAMPLES_IN_A_ROW, RunawayWatch
from hil_forceps.rig import load_rig
from tests.unit.drives.supervision.reversed_motors import reverse
from virtual_bus.drive import forceps_of
from virtual_bus.plant.load import LoadProfile, paper_load, piecewise_linear

CONFIGS = Path(__file__).parents[4] / "configs"
RIG = load_rig(CONFIGS / "drives" / "odrive.yaml")
LIMIT_A = 1.0
# What the motor holds at its limit, at the jaw.
HOLDABLE_N_m = 1.35e-2 * LIMIT_A * RIG.plant().jaw_pulley_radius_m / RIG.plant().motor_pulley_radius_m
LOOP_NS = 500_000

Shape = Callable[[NDArray[np.float64]], NDArray[np.float64]]
SHAPES: dict[str, Shape] = {
    "step": lambda t: np.where(t > 0.0, 1.0, 0.0),
    "ramp": lambda t: t,
    "smooth": lambda t: 0.5 - 0.5 * np.cos(np.pi * t),
    "cubic": lambda t: t**3,
    "exponential": lambda t: np.expm1(5.0 * t) / np.expm1(5.0),
    "to and fro": lambda t: np.sin(4.0 * np.pi * t),
}


class Held(NamedTuple):
    has_tripped: bool
    largest_rad: float


def held(load: LoadProfile, seed: int, *, loops: int = 2, is_reversed: bool = False, moves: float = 0.0) -> Held:
    """Hold a motor at its angle for 0.4 s, with a sample each few loops; `moves`: the reference's speed, rad/s."""
    forceps, watch = forceps_of(RIG, load, seed), RunawayWatch(LIMIT_A)
    theta = start = forceps.read(0).theta_m
    forceps.start_load(0)
    largest = 0.0
    for k in range(800):
        reference = start + round(moves * k * LOOP_NS * 1e-9 / ANGLE_LSB_RAD)
        followed = 2 * theta - reference if is_reversed else reference
        theta, current, _, _ = forceps.sample(k * LOOP_NS, (k + 1) * LOOP_NS, followed)
        largest = max(largest, abs(theta - reference) * ANGLE_LSB_RAD)
        if k % loops == 0:
            watch.see(theta * ANGLE_LSB_RAD, current * CURRENT_LSB_A, reference * ANGLE_LSB_RAD)
        if watch.has_tripped:
            break
    return Held(watch.has_tripped, largest)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("share", [0.15, 0.5, 0.85, -0.85])
def test_no_load_that_the_drive_holds_is_taken_for_a_reversed_motor(shape: str, share: float) -> None:
    time = np.linspace(0.0, 1.0, 41)
    furthest = 0.0
    for place, lasting_s in enumerate((0.002, 0.01, 0.02, 0.04, 0.16)):
        load = piecewise_linear(list(1e-3 + time * lasting_s), list(share * HOLDABLE_N_m * SHAPES[shape](time)))
        for loops in (1, 2, 4):
            seen = held(load, seed=10 * place + loops)
            assert not seen.has_tripped, (lasting_s, loops)
            furthest = max(furthest, seen.largest_rad)
    assert furthest > math.radians(1.0 if abs(share) > 0.2 else 0.5)  # the loads were no small ones


@pytest.mark.parametrize("loops", [1, 2, 4])
@pytest.mark.parametrize("seed", range(3))
def test_a_reversed_motor_is_told(loops: int, seed: int) -> None:
    seen = held(paper_load(0), seed, loops=loops, is_reversed=True, moves=0.2)
    assert seen.has_tripped
    assert seen.largest_rad < math.radians(120.0)  # a sample each 2 ms at 116 rad/s, and what saturates the loop


@given(st.lists(st.tuples(st.floats(-10, 10), st.floats(-0.89, 0.89), st.floats(-10, 10)), max_size=60))
def test_below_the_limit_nothing_is_said(samples: list[tuple[float, float, float]]) -> None:
    watch = RunawayWatch(1.0)
    assert not any(watch.see(*each) for each in samples)


def walk(ways: list[float], current_A: float = 1.0, reference_rad: float = 0.0) -> Iterator[bool]:
    watch, theta = RunawayWatch(1.0), 1.0
    for way in ways:
        theta += way
        yield watch.see(theta, current_A, reference_rad)


def test_what_counts_is_the_motor_that_goes_away_and_does_not_slow_down() -> None:
    assert list(walk([0.1] * 5)).index(True) == SAMPLES_IN_A_ROW  # the first sample has no way yet
    assert not any(walk([-0.1] * 5))  # towards the reference
    assert not any(walk([0.1 * 0.97**n for n in range(9)]))  # it is braked
    assert not any(walk([0.1] * 5, reference_rad=math.nan))  # there is none yet
    assert not any(walk([0.1, 0.1, -0.1] * 3))
    assert any(walk([0.1] * 5, current_A=-0.95))


@pytest.mark.parametrize("limit_A", [0.0, -1.0, math.nan])
def test_a_limit_that_is_none_is_a_mistake(limit_A: float) -> None:
    with pytest.raises(ValueError, match="is none"):
        RunawayWatch(limit_A)


def test_the_limit_is_the_lowest_that_the_rig_says() -> None:
    assert current_limit_A(RIG.with_changes({"motor_driver.current_limit_A": 0.4})) == 0.4
    assert current_limit_A(load_rig(CONFIGS / "drives" / "cia402.yaml")) == 1.0
    assert current_limit_A(load_rig(CONFIGS / "realistic.yaml")) == 1.0


@pytest.mark.parametrize("tells", [1, -1])
@pytest.mark.parametrize("profile", ["odrive", "cia402", "moteus", "dynamixel", "vesc", "mit"])
def test_a_run_with_a_reversed_motor_ends_in_one_line_with_the_drive_off(
    profile: str, tells: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    reverse(monkeypatch, profile, tells)
    rig = CONFIGS / "drives" / f"{profile}.yaml"
    arguments = ["run", "--rig", str(rig), "--interface", "virtual_forceps", "--channel", str(tmp_path)]
    with pytest.raises(SystemExit) as ended:
        cli.main([*arguments, "--option", f"rig={rig}", "--duration", "2", "--out", str(tmp_path / "out")])
    assert ended.value.code == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if not line.startswith(("note: ", "  "))]
    assert "the motor runs away from its reference" in line
    assert "encoder and motor have opposite directions" in line
    result = json.loads((tmp_path / "out" / "run.json").read_text())
    assert (result["reason"], result["drive_disabled"]) == ("runaway", True)
    recording = read_recording(tmp_path / "out" / "run.mcap")
    assert recording.notes == ()
    moved_rad = np.ptp(recording.samples["theta_m_rad"])
    assert moved_rad < math.pi  # nothing else would have stopped it
