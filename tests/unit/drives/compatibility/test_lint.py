"""`check`: each kind of setting that doesn't go with the others is found at its key, and the shipped rigs are clean."""

from pathlib import Path

import pytest

from hil_forceps.cli import main as cli
from hil_forceps.drives.compatibility.lint import findings
from hil_forceps.rig import load_rig

CONFIGS = Path(__file__).parents[4] / "configs"
RIGS = {path.stem: load_rig(path) for path in sorted((CONFIGS / "drives").glob("*.yaml"))}
# 4096 counts a turn, of every servo of the series: the angle is as coarse as it is.
NOTED = {"dynamixel": ["encoder.counts_per_rev"]}


@pytest.mark.parametrize("path", ["paper.yaml", "realistic.yaml", *(f"drives/{name}.yaml" for name in sorted(RIGS))])
def test_rigs_that_are_meant_to_run_are_clean(path: str) -> None:
    found = findings(load_rig(CONFIGS / path))
    assert [each.key for each in found] == NOTED.get(Path(path).stem, [])
    assert all(each.level == "note" for each in found)


@pytest.mark.parametrize(
    ("profile", "change", "level", "key", "said"),
    [
        ("odrive", {"limits": None}, "problem", "limits", "is missing"),
        ("odrive", {"motor_driver.watchdog_s": 0.0}, "problem", "motor_driver.watchdog_s", "nothing stops the motor"),
        ("cia402", {"motor_driver.watchdog_s": 2e-3}, "problem", "motor_driver.watchdog_s", "one late tick"),
        ("cia402", {"motor_driver.watchdog_s": 2.0}, "note", "motor_driver.watchdog_s", "for this time"),
        ("odrive", {"motor_driver.feedback_period_s": 1e-2}, "problem", "motor_driver.feedback_period_s", "too old"),
        (
            "odrive",
            {"motor_driver.feedback_period_s": 2e-3},
            "note",
            "motor_driver.feedback_period_s",
            "with this period",
        ),
        (
            "odrive",
            {"motor_driver.feedback_period_s": 5e-4},
            "problem",
            "motor_driver.feedback_period_s",
            "whole milli",
        ),
        ("odrive", {"motor_driver.current_period_s": 5e-3}, "note", "motor_driver.current_period_s", "old current"),
        ("cia402", {"limits.max_sample_age_s": 1.2e-3}, "problem", "limits.max_sample_age_s", "one tick before"),
        ("cia402", {"encoder.counts_per_rev": 2000}, "note", "encoder.counts_per_rev", "of its stretch"),
        ("odrive", {"motor_driver.encoder_zero_rev": 1e4}, "note", "motor_driver.encoder_zero_rev", "of its stretch"),
        ("odrive", {"motor_driver.current_limit_A": 0.1}, "note", "motor_driver.current_limit_A", "saturates"),
        ("cia402", {"bench.bitrate_bit_per_s": 400_000}, "problem", "bench.bitrate_bit_per_s", "load the bus by 98 %"),
        ("cia402", {"bench.bitrate_bit_per_s": 500_000}, "note", "bench.bitrate_bit_per_s", "load the bus by 79 %"),
        ("mit", {"limits.max_sample_age_s": 1.5e-3}, "problem", "limits.max_sample_age_s", "after a lost answer"),
        ("mit", {"motor_driver.position_range_rad": 95.5}, "note", "motor_driver.position_range_rad", "of its stretch"),
        (
            "mit",
            {"motor_driver.torque_range_N_m": 18.0},
            "problem",
            "motor_driver.torque_range_N_m",
            "resolution of 8.79",
        ),
        ("mit", {"motor_driver.torque_range_N_m": 0.5}, "note", "motor_driver.torque_range_N_m", "resolution of 0.244"),
        ("mit", {"motor_driver.kp_range_N_m_per_rad": 500.0}, "problem", "motor_driver.kp_N_m_per_rad", "sent as 0:"),
        ("mit", {"motor_driver.kd_range_N_m_s_per_rad": 5.0}, "problem", "motor_driver.kd_N_m_s_per_rad", "sent as 0:"),
        ("mit", {"motor_driver.kp_range_N_m_per_rad": 60.0}, "note", "motor_driver.kp_N_m_per_rad", "sent as 0.044"),
        ("mit", {"motor_driver.kp_N_m_per_rad": 0.11}, "problem", "motor_driver.kp_N_m_per_rad", "and oscillates"),
        ("mit", {"motor_driver.kp_N_m_per_rad": 0.06}, "note", "motor_driver.kp_N_m_per_rad", "gain margin of 2"),
        ("mit", {"motor_driver.mit_variant": "cubemars"}, "note", "motor_driver.watchdog_s", "documents no time-out"),
        ("mit", {"motor_driver.watchdog_s": 0.0}, "problem", "motor_driver.watchdog_s", "nothing stops the motor"),
        ("moteus", {"bench.transport": "classic"}, "problem", "bench.transport", "only CAN FD"),
        ("moteus", {"bench.bitrate_bit_per_s": 500_000}, "problem", "bench.bitrate_bit_per_s", "fixed value 1000000"),
        ("moteus", {"bench.data_bitrate_bit_per_s": 2_000_000}, "problem", "bench.data_bitrate_bit_per_s", "5000000"),
        ("moteus", {"limits.max_sample_age_s": 1.2e-3}, "problem", "limits.max_sample_age_s", "one tick before"),
        ("moteus", {"bench.latency_s": 4e-4}, "note", "bench.host_period_s", "of a reference and its answer"),
        ("moteus", {"bench.host_period_s": 4e-4}, "note", "bench.bitrate_bit_per_s", "load the bus by 72 %"),
        ("moteus", {"motor_driver.current_limit_A": 0.1}, "note", "motor_driver.current_limit_A", "saturates"),
        ("moteus", {"motor_driver.watchdog_s": 0.0}, "problem", "motor_driver.watchdog_s", "nothing stops the motor"),
        ("dynamixel", {"limits.max_sample_age_s": 1.2e-3}, "problem", "limits.max_sample_age_s", "one tick before"),
        ("dynamixel", {"encoder.counts_per_rev": "ideal"}, "note", "encoder.counts_per_rev", "X series has 4096"),
        (
            "dynamixel",
            {},
            "note",
            "encoder.counts_per_rev",
            "resolution of the angle is 3.1 µm at the wire, 6 % of its stretch",
        ),
        ("dynamixel", {"motor_driver.current_limit_A": 0.1}, "note", "motor_driver.current_limit_A", "saturates"),
        ("dynamixel", {"motor_driver.watchdog_s": 0.0}, "problem", "motor_driver.watchdog_s", "nothing stops"),
        (
            "dynamixel",
            {"motor_driver.encoder_zero_rev": 0.9},
            "note",
            "motor_driver.encoder_zero_rev",
            "the limits are 0.82 to 1.15 turns of the servo",
        ),
        (
            "dynamixel",
            {"motor.torque_constant_N_m_per_A": 1.78},  # an XM430-W350 at its horn
            "note",
            "motor.torque_constant_N_m_per_A",
            "resolution of the current is 2.69 mA, 3.4 mN m at the jaw, 168 % of a load of 2 mN m",
        ),
        (
            "dynamixel",
            {"motor_driver.baudrate_bit_per_s": 57_600},
            "problem",
            "motor_driver.baudrate_bit_per_s",
            "load the bus by 1007 %",
        ),
        (
            "dynamixel",
            {"motor_driver.baudrate_bit_per_s": 900_000},
            "note",
            "motor_driver.baudrate_bit_per_s",
            "load the bus by 64 %",
        ),
        ("vesc", {"motor_driver.watchdog_s": 1.0}, "problem", "motor_driver.watchdog_s", "waits 0.9 s at most"),
        ("vesc", {"limits.max_sample_age_s": 3e-3}, "problem", "limits.max_sample_age_s", "one tick before"),
        ("vesc", {"limits.position_max_rad": 6.0}, "problem", "limits", "which wraps at each"),
        ("vesc", {"limits.speed_max_rad_per_s": 400.0}, "problem", "limits.speed_max_rad_per_s", "nearly half a turn"),
        ("vesc", {"motor.torque_constant_N_m_per_A": 0.02}, "note", "motor.torque_constant_N_m_per_A", "7 % of it"),
        (
            "vesc",
            {"motor.torque_constant_N_m_per_A": 0.5},
            "note",
            "motor.torque_constant_N_m_per_A",
            "the load is not visible",
        ),
        ("vesc", {"bench.host_period_s": 1e-3}, "note", "bench.bitrate_bit_per_s", "load the bus by 86 %"),
        ("vesc", {"bench.bitrate_bit_per_s": 400_000}, "problem", "bench.bitrate_bit_per_s", "lower the rates"),
    ],
)
def test_what_does_not_go_together_is_found(
    profile: str, change: dict[str, object], level: str, key: str, said: str
) -> None:
    found = [(finding.level, finding.key) for finding in findings(RIGS[profile].with_changes(change))]
    assert (level, key) in found
    assert any(said in f.text for f in findings(RIGS[profile].with_changes(change)) if f.key == key)


def test_the_example_of_a_dynamixel_has_one_note_that_its_encoder_is_coarse() -> None:
    (finding,) = findings(RIGS["dynamixel"])
    assert (finding.level, finding.key) == ("note", "encoder.counts_per_rev")


def test_a_torque_that_stays_where_none_is_asked_for_is_told() -> None:
    found = findings(RIGS["mit"].with_changes({"motor_driver.torque_range_N_m": 2.0}))
    assert any("no code is exactly zero: 0.486 mN m remain on the pulley" in finding.text for finding in found)


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


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("speed_max_rad_per_s", 1e-12, "to compensate a load of 2 mN m; raise it"),
        ("acceleration_max_rad_per_s2", 1e-12, "to compensate a load of 2 mN m; raise it"),
        ("jerk_max_rad_per_s3", 1e-12, "to compensate a load of 2 mN m; raise it"),
        ("window_travel_max_rad", 1e-12, "to compensate a load of 2 mN m; raise it"),
        ("tension_max_N", 1e-12, "so that the gate latches; raise it"),
        ("current_max_A", 1e-12, "so that the gate latches; raise it"),
        ("position_max_rad", -0.5 + 1e-12, "above position_min_rad, and the compensation of a load"),
    ],
)
def test_limits_within_which_nothing_moves_are_problems(key: str, value: float, said: str) -> None:
    rig = load_rig(CONFIGS / "realistic.yaml").with_changes({f"limits.{key}": value})
    (found,) = findings(rig)
    assert (found.level, found.key) == ("problem", f"limits.{key}")
    assert said in found.text


def test_the_way_that_is_asked_for_is_the_one_of_the_compensation() -> None:
    """2 mN m on a jaw pulley of 1.4 mm stretch a wire of 26 kN/m by 54.9 µm: 27.5 mrad on 2 mm, in 2.5 s."""
    rig = load_rig(CONFIGS / "realistic.yaml")
    for speed, levels in ((0.0109, ["note"]), (0.0111, [])):
        found = findings(rig.with_changes({"limits.speed_max_rad_per_s": speed}))
        assert [each.level for each in found] == levels
    (found_of_current,) = findings(rig.with_changes({"limits.current_max_A": 0.01}))
    assert found_of_current.level == "note", "who grips less may want that"
