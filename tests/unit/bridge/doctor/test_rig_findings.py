"""What `doctor` says of a rig's own settings, and what to do about each."""

from pathlib import Path

from hil_forceps.bridge.doctor.check import Verdict
from hil_forceps.bridge.doctor.rig import checks
from hil_forceps.rig import load_rig

CONFIGS = Path(__file__).parents[4] / "configs"


def test_counts_that_a_servo_has_are_not_to_be_changed_in_the_rig() -> None:
    (found,) = checks(load_rig(CONFIGS / "drives" / "dynamixel.yaml"))
    assert (found.id, found.verdict) == ("rig.encoder.counts_per_rev", Verdict.WARN)
    assert "none, if this is the encoder's resolution" in found.remedy
    assert "change encoder" not in found.remedy


def test_a_setting_of_the_rig_is() -> None:
    rig = load_rig(CONFIGS / "realistic.yaml").with_changes({"limits.speed_max_rad_per_s": 1e-12})
    (found,) = checks(rig)
    assert (found.id, found.verdict) == ("rig.limits.speed_max_rad_per_s", Verdict.FAIL)
    assert found.remedy == "change limits.speed_max_rad_per_s in the rig file"
