"""Settings out of a recording: what a recording says that nobody wrote is refused in one line."""

import json
from pathlib import Path

import numpy as np
import pytest

from hil_forceps.bench.assembly import Settings, metadata, settings_of
from hil_forceps.control.trajectories import PAPER_TRAJECTORY
from hil_forceps.data.recording.reader import Recording
from hil_forceps.rig import load_rig
from hil_forceps.rig.errors import UserError

ROOT = Path(__file__).parents[3]
SETTINGS = Settings("kalman", True, 1e-3, PAPER_TRAJECTORY)
METADATA = metadata(load_rig(ROOT / "configs" / "paper.yaml"), SETTINGS, {})
TRAJECTORY = {"times_s": [0.0, 1.0], "angles_rad": [0.0, 1.0]}


def recording(settings: str) -> Recording:
    empty = np.zeros(0, dtype=[("state", "u1")])
    return Recording("r", {**METADATA, "settings": settings}, {}, empty, empty, empty, np.zeros(0, np.uint8), ())


def test_what_was_written_comes_back() -> None:
    assert settings_of(recording(METADATA["settings"]))[1] == SETTINGS


@pytest.mark.parametrize(
    "change",
    [
        {"sample_time_s": float("nan")},
        {"sample_time_s": -1.0},
        {"sample_time_s": "1"},
        {"sample_time_s": None},
        {"algorithm": ["kalman"]},
        {"compensated": 3},
        {"same_clock": "no"},
        {"trajectory": [1, 2]},
        {"trajectory": {"times_s": [0.0]}},
        {"trajectory": {**TRAJECTORY, "more": [1.0]}},
        {"trajectory": {**TRAJECTORY, "times_s": "01"}},
        {"trajectory": {**TRAJECTORY, "times_s": [1.0, 1.0]}},
        {"trajectory": {**TRAJECTORY, "times_s": [[0.0], [1.0]]}},
        {"unknown": 1},
    ],
)
def test_settings_that_make_no_sense_are_refused(change: dict[str, object]) -> None:
    values = {**SETTINGS._asdict(), "trajectory": TRAJECTORY}
    with pytest.raises(UserError, match="r: its rig and settings can't be read"):
        settings_of(recording(json.dumps({**values, **change})))


@pytest.mark.parametrize("text", ["", "[]", "[" * 100_000, '{"algorithm": 1, "algorithm": 2}', "null", "9" * 5000])
def test_settings_that_are_no_json_are_refused(text: str) -> None:
    with pytest.raises(UserError, match="r: its rig and settings can't be read"):
        settings_of(recording(text))
