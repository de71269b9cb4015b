"""No profile gets round the gate: what arrives at the drive lies within the rig's limits, whatever is asked for."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil_forceps.cli import main as cli
from hil_forceps.rig import load_rig
from hil_forceps.rig.sections import MotorDriver
from virtual_bus.drives.cia402 import SimulatedCia402
from virtual_bus.drives.odrive import SimulatedODrive

CONFIGS = Path(__file__).parents[3] / "configs" / "drives"
LOW_RAD, HIGH_RAD = 0.9, 1.2  # the jaw's motion wants 1.10 down to 0.12


def commanded(profile: str, monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Watch a simulated drive, and return the motor angles that it will be sent, in rad."""
    seen: list[float] = []
    if profile == "odrive":
        reference = SimulatedODrive._reference_raw

        def of_odrive(self: SimulatedODrive) -> int:
            raw = reference(self)
            seen.append(raw / 2**24 * 2.0 * np.pi)
            return raw

        monkeypatch.setattr(SimulatedODrive, "_reference_raw", of_odrive)
    else:
        follow = SimulatedCia402._follow

        def of_cia402(self: SimulatedCia402, now_ns: int) -> None:
            follow(self, now_ns)
            if self.control & 0x0F == 0x0F:
                seen.append((self._to - self._zero_counts) / self._counts_per_rev * 2.0 * np.pi)

        monkeypatch.setattr(SimulatedCia402, "_follow", of_cia402)
    return seen


def profiles() -> list[str]:
    field: Any = MotorDriver.model_fields["profile"].annotation
    return [name for name in field.__args__ if name != "native"]


@pytest.mark.parametrize("profile", profiles())
def test_nothing_beyond_the_limits_arrives(profile: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (CONFIGS / f"{profile}.yaml").read_text()
    limited = text.replace("position_min_rad: -0.5", f"position_min_rad: {LOW_RAD}")
    limited = limited.replace("position_max_rad: 1.6", f"position_max_rad: {HIGH_RAD}")
    assert limited.count(str(LOW_RAD)) >= 1
    rig = tmp_path / "rig.yaml"
    rig.write_text(limited)
    seen = commanded(profile, monkeypatch)
    arguments = ["run", "--rig", str(rig), "--interface", "virtual_forceps", "--channel", str(tmp_path)]
    with pytest.raises(SystemExit):
        cli.main([*arguments, "--option", f"rig={rig}", "--duration", "5", "--out", str(tmp_path / "out")])
    assert len(seen) > 1000
    count = 2.0 * np.pi / (load_rig(rig).encoder.counts_per_rev or 2**24)
    assert LOW_RAD - count <= min(seen)
    assert max(seen) <= HIGH_RAD + count
    assert min(seen) < LOW_RAD + 0.01  # it was asked for more
