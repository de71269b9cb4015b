"""`check`: each kind of setting that doesn't go with the others is found at its key, and the shipped rigs are clean."""

from pathlib import Path

import pytest

from hil_forceps.cli import main as cli
from hil_forceps.drives.lint import findings
from hil_forceps.rig import load_rig

CONFIGS = Path(__file__).parents[3] / "configs"
RIGS = {name: load_rig(CONFIGS / "drives" / f"{name}.yaml") for name in ("odrive", "cia402")}


@pytest.mark.parametrize("path", ["paper.yaml", "realistic.yaml", "drives/odrive.yaml", "drives/cia402.yaml"])
def test_rigs_that_are_meant_to_run_are_clean(path: str) -> None:
    assert findings(load_rig(CONFIGS / path)) == []


@pytest.mark.parametrize(
    ("profile", "change", "level", "key", "said"),
    [
        ("odrive", {"limits": None}, "problem", "limits", "is missing"),
        ("odrive", {"motor_driver.watchdog_s": 0.0}, "problem", "motor_driver.watchdog_s", "nothing stops the motor"),
        ("cia402", {"motor_driver.watchdog_s": 2e-3}, "problem", "motor_driver.watchdog_s", "one late tick"),
        ("cia402", {"motor_driver.watchdog_s": 2.0}, "note", "motor_driver.watchdog_s", "for so long"),
        ("odrive", {"motor_driver.feedback_period_s": 1e-2}, "problem", "motor_driver.feedback_period_s", "too old"),
        ("odrive", {"motor_driver.feedback_period_s": 2e-3}, "note", "motor_driver.feedback_period_s", "at that pace"),
        ("odrive", {"motor_driver.current_period_s": 5e-3}, "note", "motor_driver.current_period_s", "older current"),
        ("cia402", {"limits.max_sample_age_s": 1.2e-3}, "problem", "limits.max_sample_age_s", "a tick before"),
        ("cia402", {"encoder.counts_per_rev": 2000}, "note", "encoder.counts_per_rev", "of its stretch"),
        ("odrive", {"motor_driver.encoder_zero_rev": 1e4}, "note", "motor_driver.encoder_zero_rev", "of its stretch"),
        ("odrive", {"motor_driver.current_limit_A": 0.1}, "note", "motor_driver.current_limit_A", "saturates"),
        ("cia402", {"bench.bitrate_bit_per_s": 400_000}, "problem", "bench.bitrate_bit_per_s", "load the bus by 98 %"),
        ("cia402", {"bench.bitrate_bit_per_s": 500_000}, "note", "bench.bitrate_bit_per_s", "load the bus by 79 %"),
    ],
)
def test_what_does_not_go_together_is_found(
    profile: str, change: dict[str, object], level: str, key: str, said: str
) -> None:
    found = [(finding.level, finding.key) for finding in findings(RIGS[profile].with_changes(change))]
    assert (level, key) in found
    assert said in next(f.text for f in findings(RIGS[profile].with_changes(change)) if f.key == key)


def test_the_command_tells_problems_first_and_answers_no(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = tmp_path / "rig.yaml"
    text = (CONFIGS / "drives" / "odrive.yaml").read_text()
    rig.write_text(
        text.replace("watchdog_s: 0.1", "watchdog_s: 0.0").replace(
            "feedback_period_s: 1.0e-3", "feedback_period_s: 2.0e-3"
        )
    )
    with pytest.raises(SystemExit) as ended:
        cli.main(["check", str(rig)])
    assert ended.value.code == 1
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(": ")[1] for line in lines] == ["problem", "note", "1 problem, 1 note"]


def test_a_rig_that_its_profile_can_not_take_is_an_error(tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    text = (CONFIGS / "drives" / "cia402.yaml").read_text()
    rig.write_text(text.replace("counts_per_rev: 16384", "counts_per_rev: ideal"))
    with pytest.raises(SystemExit) as ended:
        cli.main(["check", str(rig)])
    assert ended.value.code == 2


def test_a_drive_whose_law_is_not_known_is_driven_all_the_same(tmp_path: Path) -> None:
    whole = CONFIGS / "drives" / "odrive.yaml"
    text = whole.read_text()
    start, end = text.index("\ndrive:"), text.index("\nnoise:")
    rig = tmp_path / "rig.yaml"
    rig.write_text(text[:start] + text[end:])
    arguments = ["run", "--rig", str(rig), "--interface", "virtual_forceps", "--channel", str(tmp_path)]
    with pytest.raises(SystemExit) as ended:
        cli.main([*arguments, "--option", f"rig={whole}", "--duration", "2", "--out", str(tmp_path / "out")])
    assert not ended.value.code
