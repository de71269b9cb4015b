"""What a user sees of the gate: trajectories that are refused, what was limited, and feedback that can't be."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hil_forceps.bridge.gate_tally import GateCount
from hil_forceps.bridge.results import ServiceResult, StopReason
from hil_forceps.cli import main as cli
from hil_forceps.cli.terminal.gate_words import gate_lines
from hil_forceps.control.gate import GateVerdict
from hil_forceps.drives.registry import PROFILES
from hil_forceps.rig import dump_rig, load_rig
from virtual_bus.plant.forceps import SimulatedForceps

CONFIGS = Path(__file__).parents[4] / "configs"
REALISTIC = CONFIGS / "realistic.yaml"
COUNT_RAW = (1 << 24) // 16384
Alter = Callable[[int, int, int], tuple[int, int]]  # sample, angle, current -> angle, current


def run(folder: Path, *more: str, rig: Path = REALISTIC) -> int:
    channel = ("--interface", "virtual_forceps", "--channel", str(folder), "--option", f"rig={rig}")
    with pytest.raises(SystemExit) as ended:
        cli.main(["run", "--rig", str(rig), *channel, "--out", str(folder / "out"), *more])
    return int(ended.value.code or 0)


def told(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "out" / "run.json").read_text())
    return found


def rig_with(folder: Path, *lines: str) -> Path:
    text = REALISTIC.read_text(encoding="utf-8")
    path = folder / "rig.yaml"
    path.write_text(
        text.replace("  max_sample_age_s:", "".join(f"  {line}\n" for line in lines) + "  max_sample_age_s:")
    )
    return path


def trajectory(folder: Path, text: str) -> str:
    path = folder / "motion.csv"
    path.write_text("time_s,theta_j_rad\n" + text, encoding="utf-8")
    return str(path)


@pytest.mark.parametrize(
    ("motion", "said"),
    [
        ("0,1.5\n1,1\n3,3.4\n5,0.7\n", "motion.csv:4: at 3 s the motor reference is 2.38 rad"),
        ("0,1.5\n1,-0.8\n", "motion.csv:3: at 1 s the motor reference is -0.56 rad"),
        ("0,1.5\n1,1\n1.001,1.4\n", "motion.csv:4: at 1.001 s the motor reference is 280 rad/s"),
    ],
)
def test_a_trajectory_beyond_the_limits_is_refused_before_anything_moves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], motion: str, said: str
) -> None:
    assert run(tmp_path, "--trajectory", trajectory(tmp_path, motion)) == 2
    err = capsys.readouterr().err
    assert said in err
    assert f"in {REALISTIC}; change the trajectory, or the limit" in err
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_the_papers_own_trajectory_is_held_to_the_limits_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(REALISTIC.read_text().replace("position_min_rad: -0.5", "position_min_rad: 0.5"))
    assert run(tmp_path, rig=rig) == 2
    said = capsys.readouterr().err
    assert "the paper's trajectory: at 5 s the motor reference is 0.1222 rad" in said
    assert "limits.position_min_rad of 0.5" in said
    assert run(tmp_path, "--duration", "1", rig=rig) == 0, "what is asked for within the run is all that counts"


def test_what_the_gate_limits_is_told_and_counted_and_the_run_is_good(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = rig_with(tmp_path, "jerk_max_rad_per_s3: 5.0e+4", "window_travel_max_rad: 0.5")
    motion = trajectory(tmp_path, "0,1.57\n0.5,1.57\n1.0,0.2\n3,0.2\n")
    assert run(tmp_path, "--trajectory", motion, rig=rig) == 0
    said = capsys.readouterr().err.splitlines()
    found = told(tmp_path)
    assert found["reason"] == "completed"
    asked = found["counters"]["pipeline"]["passed"] + found["counters"]["pipeline"]["denied"]
    jerk = found["gate"]["verdicts"]["limited_jerk"]
    assert jerk["references"] == found["counters"]["gate"]["limited_jerk"] > 0
    assert jerk["first_s"] >= 0.0
    assert jerk["greatest_cut_rad"] > 0.0
    assert found["gate"]["trip"] is None
    notes = [line for line in said if line.startswith("note: the gate limited ")]
    assert len(notes) == len(found["gate"]["verdicts"]), "a line for each kind"
    assert any(f"limited {jerk['references']} of {asked} references (jerk), first " in line for line in notes)


def test_nothing_is_told_where_nothing_was_limited(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(tmp_path, "--duration", "2") == 0
    assert "gate" not in capsys.readouterr().err
    found = told(tmp_path)
    assert "gate" not in found["counters"]
    assert found["gate"] == {"verdicts": {}, "trip": None}


def altered(monkeypatch: pytest.MonkeyPatch, alter: Alter) -> None:
    """Let the drive tell other values than it closes its loop with."""
    sample, number = SimulatedForceps.sample, 0

    def wrong(self: SimulatedForceps, now_ns: int, until_ns: int, reference: int | None) -> tuple[int, int, int, int]:
        nonlocal number
        number += 1
        theta_m, current, theta_j, tau_w = sample(self, now_ns, until_ns, reference)
        return *alter(number, theta_m, current), theta_j, tau_w

    monkeypatch.setattr(SimulatedForceps, "sample", wrong)


def jumping(number: int, theta: int, current: int) -> tuple[int, int]:
    return (theta if number < 2000 else theta + 3000 * COUNT_RAW), current


def freezing() -> Alter:
    kept: list[int] = []

    def alter(number: int, theta: int, current: int) -> tuple[int, int]:
        if number < 2000:
            return theta, current
        kept.append(theta)
        return kept[0], current

    return alter


def running_away(number: int, theta: int, current: int) -> tuple[int, int]:
    return (theta, current) if number < 2000 else (theta - 4 * COUNT_RAW * (number - 2000), 3500)


@pytest.mark.parametrize(
    ("alter", "lines", "reason", "check"),
    [
        (jumping, (), "feedback_implausible", "encoder_jump"),
        (freezing(), (), "feedback_implausible", "encoder_frozen"),
        (running_away, (), "feedback_implausible", "against_current"),
        (lambda n, th, i: (th, i if n < 2000 else 4000), ("current_max_A: 0.6",), "gate_latched", "current"),
        (lambda n, th, i: (th, i if n < 2000 else 4000), ("tension_max_N: 3.0",), "gate_latched", "tension"),
    ],
)
def test_feedback_that_cannot_be_ends_the_run_and_takes_torque_off(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    alter: Alter,
    lines: tuple[str, ...],
    reason: str,
    check: str,
) -> None:
    altered(monkeypatch, alter)
    assert run(tmp_path, "--duration", "5", rig=rig_with(tmp_path, *lines)) == 2
    found = told(tmp_path)
    assert (found["reason"], found["drive_disabled"]) == (reason, True)
    trip = found["gate"]["trip"]
    assert trip["check"] == check
    assert trip["value"] > trip["limit"]
    said = capsys.readouterr().err
    assert [found["fault"][key] for key in ("check", "value", "limit", "unit")] == list(trip.values())[:4]
    assert f"the gate has latched: {found['message'].partition('latched: ')[2]}\n" in said
    assert found["gate"]["verdicts"]["frozen"]["references"] >= 1
    assert found["gate"]["verdicts"]["denied_latched"]["references"] == 1
    with pytest.raises(SystemExit) as ended:
        cli.main(["replay", str(tmp_path / "out")])
    assert not ended.value.code, "and a replay comes to the same references"


def test_a_short_excess_is_held_and_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    altered(monkeypatch, lambda n, th, i: (th, 4000 if 2000 <= n < 2040 else i))
    assert run(tmp_path, "--duration", "3", rig=rig_with(tmp_path, "current_max_A: 0.6")) == 0
    said = capsys.readouterr().err
    assert "note: the gate held " in said
    assert ": failed check: current" in said
    assert 8 <= told(tmp_path)["gate"]["verdicts"]["frozen"]["references"] <= 32


def test_lines_for_people() -> None:
    lines = gate_lines(ended_with({
        GateVerdict.LIMITED_SPEED: GateCount(812, 5_000_000_000 + 1_204_000_000, 2.314),
        GateVerdict.DENIED_GAP: GateCount(1, 5_000_000_000, 0.0),
        GateVerdict.FROZEN: GateCount(20, 6_000_000_000, 0.0, ("tension", "current")),
    }))  # fmt: skip
    assert lines[0].startswith(
        "the gate limited 812 of 4001 references (speed), first 1.204 s after the start, by up to 2.31 rad: "
    )
    assert lines[1].startswith("the gate denied 1 of 4001 references, first 0.000 s after the start: ")
    assert "held 20 of 4001 references, first 1.000 s after the start: failed check: tension and current" in lines[2]
    each = [gate_lines(ended_with({verdict: GateCount(1, 0, math.pi)})) for verdict in list(GateVerdict)[2:]]
    assert all(len(told) == 1 for told in each)


@pytest.mark.parametrize(
    ("verdict", "key"),
    [
        (GateVerdict.LIMITED_JERK, "jerk_max_rad_per_s3"),
        (GateVerdict.LIMITED_ACCELERATION, "acceleration_max_rad_per_s2"),
        (GateVerdict.LIMITED_SPEED, "speed_max_rad_per_s"),
        (GateVerdict.LIMITED_WINDOW, "window_travel_max_rad"),
    ],
)
def test_what_limits_most_references_is_not_called_usual(verdict: GateVerdict, key: str) -> None:
    (most,) = gate_lines(ended_with({verdict: GateCount(4000, 0, 0.1)}))
    assert "4000 of 4001 references" in most
    assert f"these are most of the references; limits.{key} is too small for this motion" in most
    assert "usual" not in most
    (few,) = gate_lines(ended_with({verdict: GateCount(40, 0, 0.1)}))
    assert "most of the references" not in few


def ended_with(gate: dict[GateVerdict, GateCount]) -> ServiceResult:
    """A run that was asked for 4001 references, on a host whose clock said 5 s at its start."""
    counters = {"pipeline": {"passed": 4000, "denied": 1}}
    stages = ((5_000_000_000, "connecting"),)
    return ServiceResult(StopReason.COMPLETED, "", True, 0, counters, {}, gate, None, stages)


def test_one_time_base_in_all_that_tells_of_a_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The check, the hold of 50 ms and the end: on the terminal, in run.json and in `explain`, to the millisecond."""
    altered(monkeypatch, jumping)
    assert run(tmp_path, "--duration", "5") == 2
    err, found = capsys.readouterr().err, told(tmp_path)
    trip_s, stopped_s = found["gate"]["trip"]["time_s"], found["stages_s"]["stopping"]
    held = found["gate"]["verdicts"]["frozen"]
    latched_s = found["gate"]["verdicts"]["denied_latched"]["first_s"]
    assert 0.0 <= held["first_s"] - trip_s <= 0.002
    assert latched_s - trip_s == pytest.approx(0.05, abs=0.002)
    assert f"first {held['first_s']:.3f} s after the start" in err
    assert f"{trip_s:.3f} s after the start, while running; the run ended at {stopped_s:.3f} s" in err
    assert "held 50 of" in err
    assert err.count("1.15 rad") == err.count("0.3522 rad") == 1, "value and limit once"
    assert "failed check: encoder_jump" in err
    with pytest.raises(SystemExit):
        cli.main(["explain", str(tmp_path / "out")])
    said = capsys.readouterr().out
    assert "Events (time in s since the start of the run" in said
    course, _, end = said.partition("End\n")
    for time_s, words in (
        (trip_s, "the gate's check encoder_jump fails: 1.15 rad, the limit is 0.3522 rad"),
        (held["first_s"], "50 ticks with their references held"),
        (latched_s, "1 tick with its reference denied: the gate has latched"),
        (stopped_s, "the drive is requested to remove torque"),
    ):
        assert f"{time_s:9.3f}  {words}" in course
    assert end.startswith(f"  {stopped_s:9.3f}  the gate has latched")
    rows = end.partition("The samples around the failed check, and the last samples")[2]
    assert [rows.count(word) for word in ("PASSED", "FROZEN", "DENIED_LATCHED", "...")] == [3, 4, 1, 1]


def test_a_run_that_ends_well_counts_from_the_same_instant(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With fault.json and without: the zero is at the same time of both courses."""
    zeros = []
    for name, duration in (("good", "1"), ("bad", "5")):
        (tmp_path / name).mkdir()
        if name == "bad":
            altered(monkeypatch, jumping)
        run(tmp_path / name, "--duration", duration)
        capsys.readouterr()
        with pytest.raises(SystemExit):
            cli.main(["explain", str(tmp_path / name / "out"), "--json"])
        story = json.loads(capsys.readouterr().out)
        zeros += [event["time_s"] for event in story["events"] if event["kind"] == "zero"]
        assert story["counted_from"].startswith("the start of the run")
    assert len(zeros) == 2
    assert zeros[0] == zeros[1]


# 2048 counts, dry friction of 30 % of the load of 2 mN m (r_m/r_j · 0.3 · 2 mN m), a slow motion, quick ones, holds.
HARD = {"encoder.counts_per_rev": 2048, "forceps.motor_coulomb_N_m": 8.6e-4}
SLOW_AND_QUICK = "0,1.57\n6,1.45\n6.5,0.4\n9,0.38\n9.3,1.5\n11,1.5\n"


# The one whose line is half duplex has the oldest samples; what else differs are messages, with tests of their own.
EVERY_PROFILE = [pytest.param(name, marks=() if name == "dynamixel" else pytest.mark.long) for name in sorted(PROFILES)]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["realistic", "realistic, a twentieth of the frames lost", *EVERY_PROFILE])
def test_no_check_trips_on_hard_but_sound_feedback(tmp_path: Path, name: str) -> None:
    """With the pulses of the paper's simulation 2 from 10 s on."""
    path = CONFIGS / "drives" / f"{name}.yaml" if name in PROFILES else REALISTIC
    rig, faults = tmp_path / "rig.yaml", tmp_path / "faults.yaml"
    more: tuple[str, ...] = ()
    rig.write_text(dump_rig(load_rig(path).with_changes(HARD)), encoding="utf-8")
    if name.endswith("lost"):
        faults.write_text("- {fault: drop, direction: to_host, probability: 0.05}\n", encoding="utf-8")
        more = ("--option", f"faults={faults}")
    motion = trajectory(tmp_path, SLOW_AND_QUICK)
    assert run(tmp_path, "--trajectory", motion, "--duration", "11", *more, rig=rig) == 0
    found = told(tmp_path)
    assert (found["reason"], found["gate"]["trip"]) == ("completed", None)
    assert "frozen" not in found["gate"]["verdicts"]
