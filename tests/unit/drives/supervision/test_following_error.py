"""A following error window ends a run with a reversed motor at once, and none without a load in which all is well."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from hil_forceps.bench.session import motion_watches
from hil_forceps.bridge.results import StopReason
from hil_forceps.cli import main as cli
from hil_forceps.cli.commands.runs.run_checks import with_following_error
from hil_forceps.data.recording.reader import read_recording
from hil_forceps.drives.supervision.following_error import FollowingErrorWatch
from hil_forceps.rig import load_rig
from tests.unit.drives.supervision.reversed_motors import reverse

CONFIGS = Path(__file__).parents[4] / "configs"
MAKERS = ["odrive", "cia402", "moteus", "dynamixel", "vesc", "mit"]


def run(rig: Path, folder: Path, *options: str) -> int:
    """Run the simulated drive of a rig in virtual time; return the exit code."""
    arguments = ["run", "--rig", str(rig), "--interface", "virtual_forceps", "--channel", str(folder)]
    with pytest.raises(SystemExit) as ended:
        cli.main([*arguments, "--option", f"rig={rig}", *options, "--out", str(folder / "out")])
    assert isinstance(ended.value.code, int)
    return ended.value.code


@pytest.mark.parametrize("tells", [1, -1])
@pytest.mark.parametrize("profile", MAKERS)
def test_a_reversed_motor_ends_the_run_at_once_with_the_drive_off(
    profile: str, tells: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    reverse(monkeypatch, profile, tells)
    rig = CONFIGS / "drives" / f"{profile}.yaml"
    assert run(rig, tmp_path, "--duration", "2", "--max-following-error", "0.5") == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if not line.startswith(("note: ", "  "))]
    assert "following error" in line
    assert "encoder and motor have opposite directions" in line
    result = json.loads((tmp_path / "out" / "run.json").read_text())
    assert (result["reason"], result["drive_disabled"]) == ("following_error", True)
    recording = read_recording(tmp_path / "out" / "run.mcap")
    assert recording.notes == ()
    samples, references = recording.samples, recording.references
    sent = np.isfinite(references["passed_rad"])
    before = np.searchsorted(references["tick_ns"][sent], samples["received_ns"]) - 1
    follows = before >= 0
    error_rad = samples["theta_m_rad"][follows] - references["passed_rad"][sent][before[follows]]
    beyond = np.flatnonzero(np.abs(error_rad) > math.radians(0.5))
    last_ns = references["tick_ns"][sent][-1]
    # Not a reference more: those of the tick that the sample came in are not sent.
    assert samples["received_ns"][follows][beyond[0]] >= last_ns
    # The host closes a mini cheetah drive's loop, so its motor goes on until the next tick.
    assert np.ptp(samples["theta_m_rad"]) < math.radians(2.5 if profile == "mit" else 1.0)


@pytest.mark.parametrize("name", ["realistic", *(f"drives/{profile}" for profile in MAKERS)])
def test_a_run_without_load_stays_within_half_a_degree(name: str, tmp_path: Path) -> None:
    rig = CONFIGS / f"{name}.yaml"
    assert run(rig, tmp_path, "--duration", "6", "--max-following-error", "0.5", "--option", "simulation=0") == 0


def test_a_load_that_moves_the_motor_further_ends_the_run_by_the_rigs_own_limit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "rig.yaml"
    text = (CONFIGS / "drives" / "odrive.yaml").read_text()
    age = "  max_sample_age_s: 3.0e-3"
    rig.write_text(text.replace(age, f"{age}\n  following_error_max_rad: 0.03"))
    assert run(rig, tmp_path, "--option", "simulation=2") == 2
    assert "the limit is 1.719 deg" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        cli.main(["explain", str(tmp_path / "out")])
    assert "position loop is too soft" in capsys.readouterr().out


def test_the_option_is_no_way_around_missing_limits(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = tmp_path / "rig.yaml"
    text = (CONFIGS / "realistic.yaml").read_text()
    begin = text.index("\nlimits:")
    end = text.index("\n\n", begin)
    rig.write_text(text[:begin] + text[end:])
    assert run(rig, tmp_path, "--max-following-error", "0.5", "--duration", "0.5") == 2
    assert "limits: is missing" in capsys.readouterr().err


def test_the_option_never_widens_the_limit_of_a_rig() -> None:
    rigs = {"a": load_rig(CONFIGS / "realistic.yaml").with_changes({"limits.following_error_max_rad": 0.02})}
    assert with_following_error(rigs, 5.0)["a"].limits.following_error_max_rad == 0.02
    assert with_following_error(rigs, 1.0)["a"].limits.following_error_max_rad == pytest.approx(math.radians(1.0))
    assert with_following_error(rigs, None) == rigs


@pytest.mark.parametrize("value", ["0", "-1", "nan", "361"])
def test_a_window_that_is_none_is_one_line(value: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(CONFIGS / "realistic.yaml", tmp_path, f"--max-following-error={value}") == 2
    assert "--max-following-error" in capsys.readouterr().err


def test_the_edge_of_the_window_is_inside_and_it_stays_tripped() -> None:
    watch = FollowingErrorWatch(0.25)
    assert not watch.see(1.25, 0.0, 1.0)
    assert not watch.see(0.75, 0.0, 1.0)
    assert not watch.see(9.0, 0.0, math.nan)  # no reference yet
    assert watch.see(1.0, 0.5, 1.5)
    assert watch.see(1.0, 0.0, 1.0)
    assert "following error of -28.65 deg at 0.5 A, the limit is 14.32 deg" in watch.words()
    with pytest.raises(ValueError, match="is none"):
        FollowingErrorWatch(0.0)


def test_it_watches_where_the_rig_has_a_limit() -> None:
    rig = load_rig(CONFIGS / "realistic.yaml")
    assert set(motion_watches(rig)) == {StopReason.RUNAWAY}
    limited = rig.with_changes({"limits.following_error_max_rad": 0.1})
    assert set(motion_watches(limited)) == {StopReason.RUNAWAY, StopReason.FOLLOWING_ERROR}
