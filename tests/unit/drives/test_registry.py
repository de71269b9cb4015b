"""From a rig to its drive's profile: the published time until nothing leads the motor any more."""

from pathlib import Path

import pytest

from hil_forceps.drives.registry import torque_free_within_s
from hil_forceps.rig import load_rig

CONFIGS = Path(__file__).parents[3] / "configs"


@pytest.mark.parametrize(
    ("path", "within_s"),
    [
        ("realistic.yaml", 0.021),  # protocol.md, "Timing and its margins"
        ("drives/odrive.yaml", 0.101),
        ("drives/cia402.yaml", 0.101),
        ("drives/moteus.yaml", 0.101),
        ("drives/mit.yaml", 0.029),  # its watchdog's 25 ms, repeats for 3 ms
        ("drives/dynamixel.yaml", 0.151),  # fed for half the watchdog's time
        ("drives/vesc.yaml", 0.112),  # looked at every 10 ms; a period of 2 ms
    ],
)
def test_without_references_nothing_leads_the_motor_in_time(path: str, within_s: float) -> None:
    assert torque_free_within_s(load_rig(CONFIGS / path)) == pytest.approx(within_s)


def test_without_a_watchdog_there_is_no_such_time() -> None:
    odrive, mit = (load_rig(CONFIGS / "drives" / f"{name}.yaml") for name in ("odrive", "mit"))
    assert torque_free_within_s(odrive.with_changes({"motor_driver.watchdog_s": 0.0})) is None
    assert torque_free_within_s(mit.with_changes({"motor_driver.mit_variant": "cubemars"})) is None
