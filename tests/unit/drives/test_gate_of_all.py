"""No profile gets round the gate: what arrives at the drive lies within the rig's limits, whatever is asked for."""

from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from hil_forceps.cli import main as cli
from hil_forceps.cli.commands.runs import run_checks
from hil_forceps.drives.registry import PROFILES
from hil_forceps.rig import load_rig
from hil_forceps.rig.sections import ProfileName
from virtual_bus.drives.mit import SimulatedMit
from virtual_bus.drives.registry import SIMULATED_DRIVES
from virtual_bus.plant.forceps import SimulatedForceps

CONFIGS = Path(__file__).parents[3] / "configs" / "drives"
LOW_RAD, HIGH_RAD = 0.9, 1.2  # the jaw's motion wants 1.10 down to 0.71


def commanded(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Watch the forceps, and return the motor angles in rad that its drive will be led to."""
    seen: list[float] = []
    sample = SimulatedForceps.sample

    def watched(
        self: SimulatedForceps, now_ns: int, until_ns: int, reference_raw: int | None
    ) -> tuple[int, int, int, int]:
        if reference_raw is not None:
            seen.append(reference_raw / 2**24 * 2.0 * np.pi)
        return sample(self, now_ns, until_ns, reference_raw)

    monkeypatch.setattr(SimulatedForceps, "sample", watched)
    reference_rad = SimulatedMit.reference_rad

    def watched_reference(self: SimulatedMit) -> float | None:
        """Of a drive that closes its own loop, with gains from the bus."""
        found = reference_rad(self)
        if found is not None:
            seen.append(found)
        return found

    monkeypatch.setattr(SimulatedMit, "reference_rad", watched_reference)
    return seen


def profiles() -> list[str]:
    return [name for name in get_args(ProfileName) if name != "native"]


def test_every_profile_is_there() -> None:
    assert sorted(profiles()) == sorted(PROFILES) == sorted(SIMULATED_DRIVES)
    for name in profiles():
        assert (CONFIGS / f"{name}.yaml").is_file()


@pytest.mark.parametrize("profile", profiles())
def test_nothing_beyond_the_limits_arrives(
    profile: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (CONFIGS / f"{profile}.yaml").read_text()
    limited = text.replace("position_min_rad: -0.5", f"position_min_rad: {LOW_RAD}")
    limited = limited.replace("position_max_rad: 1.6", f"position_max_rad: {HIGH_RAD}")
    assert limited.count(str(LOW_RAD)) >= 1
    rig = tmp_path / "rig.yaml"
    rig.write_text(limited)
    seen = commanded(monkeypatch)
    # Such a trajectory is refused before anything moves; here the gate is to hold alone.
    monkeypatch.setattr(run_checks, "check_trajectory", lambda *_: None)
    arguments = ["run", "--rig", str(rig), "--interface", "virtual_forceps", "--channel", str(tmp_path)]
    with pytest.raises(SystemExit):
        cli.main([*arguments, "--option", f"rig={rig}", "--duration", "2", "--out", str(tmp_path / "out")])
    assert len(seen) > 1000
    count = 2.0 * np.pi / (load_rig(rig).encoder.counts_per_rev or 2**24)
    assert LOW_RAD - count <= min(seen)
    assert max(seen) <= HIGH_RAD + count
    assert min(seen) < LOW_RAD + 0.01  # it was asked for more
    assert "note: the gate limited " in capsys.readouterr().err
