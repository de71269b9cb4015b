"""`drive` and `run` as two processes over UDP multicast, where the drive speaks a maker's protocol of a CAN bus.

Counts are asserted, never times. The host is at 50 Hz, for these tests don't run alone.
"""

import json
import re
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hil_forceps.data.recording.reader import read_recording
from tests.system.conftest import ROOT, make_wire

pytestmark = [pytest.mark.realtime, pytest.mark.slow]

ATTEMPTS = 3  # a machine that stalls for longer than a watchdog meets it, and that is no fault of the bench
PATIENT = {
    "host_period_s": "2.0e-2",
    "host_phase_s": "0.0",
    "feedback_period_s": "2.0e-2",
    "current_period_s": "2.0e-2",
    "max_sample_age_s": "0.2",
    "watchdog_s": "0.4",
    "speed_max_rad_per_s": "10.0",
}


def patient(profile: str, folder: Path) -> Path:
    """Return a maker's example with a slow host; keys that it hasn't stay away."""
    text = (ROOT / "configs" / "drives" / f"{profile}.yaml").read_text()
    for key, value in PATIENT.items():
        text = re.sub(rf"^( +{key}:) +\S+", rf"\1 {value}", text, flags=re.M)
    path = folder / f"{profile}.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("profile", ["odrive", "cia402", "moteus", "mit", "vesc"])
def test_a_run_against_the_process_of_a_makers_drive(
    profile: str, drive: Callable[..., Any], run: Callable[..., Any], tmp_path: Path
) -> None:
    rig, wire = patient(profile, tmp_path), make_wire("udp_multicast", tmp_path)
    for attempt in range(ATTEMPTS):
        out = tmp_path / f"out{attempt}"
        other = drive(wire, rig=rig)
        ended = run(wire, out, "--duration", "1.5", rig=rig).end()
        told = other.end(signal.SIGTERM).told
        if ended.code == 0:
            break
    assert ended.code == 0, ended.err
    result = json.loads((out / "run.json").read_text())
    assert (result["reason"], result["drive_disabled"]) == ("completed", True)
    recording = read_recording(out / "run.mcap")
    assert recording.notes == ()
    assert len(recording.samples) == result["counters"]["pipeline"]["samples"] > 50
    # What was sent is what was heard; on this interface each end hears itself, too.
    assert told["received"]["packets"] == result["counters"]["service"]["frames_sent"]
    assert result["counters"]["service"]["frames_received"] <= told["sent"]["packets"]
    assert told["own_frames_heard"] == told["sent"]["packets"]
    assert told["drive"]["not_understood"] == 0
