"""`hil-forceps replay` with a recording: references computed again from its samples, compared with the recorded."""

import json
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np

from hil_forceps.bench.assembly import make_pipeline, settings_of
from hil_forceps.bridge.pipeline import VERDICT_NAMES
from hil_forceps.bridge.replay import Difference, RecordedReference, Replay, replay
from hil_forceps.cli.kernels import ready_kernels
from hil_forceps.cli.terminal.notes import note
from hil_forceps.data.recording.format import RECOVERY_NAME
from hil_forceps.data.recording.reader import Recording, read_recording
from hil_forceps.data.recording.writer import Outcome
from hil_forceps.rig.errors import UserError

EXIT_DIFFERENT: Final = 1
_NOT_SENT: Final = {
    Outcome.QUEUE_FULL: "not sent, send queue full",
    Outcome.BUS_DOWN: "not sent, bus down",
    Outcome.NOT_ALLOWED: "before the drive accepted references",
}


def replay_recording(path: Path, algorithm: str | None, *, as_json: bool) -> int:
    """Compare and print; exit code 1 if something differs, or if a part of the recording is missing."""
    recording = read_recording(path)
    for each in recording.notes:
        note(f"{path}: {each}")
    rig, settings = settings_of(recording)
    is_same = algorithm is None or algorithm == settings.algorithm
    if algorithm is not None:
        settings = settings._replace(algorithm=algorithm)
    ready_kernels(rig, settings.sample_time_s)
    outside = RecordedReference() if settings.trajectory is None else None
    result = replay(recording, make_pipeline(rig, settings, outside), outside)
    if not len(recording.samples):
        raise UserError(
            f"{path}: contains no samples: the drive did not answer, or the recording was cut off; see hil-forceps "
            f"explain {path}"
        )
    is_identical = result.first_difference is None and not recording.gaps
    if as_json:
        content = _data(path, recording, result, settings.algorithm, is_same=is_same)
        sys.stdout.write(json.dumps(content, indent=2) + "\n")
    elif is_same:
        sys.stdout.write(f"{path}: {_told(path, recording, result.first_difference)}\n")
    else:
        sys.stdout.write(
            f"{path}: {len(recording.samples)} samples estimated with {settings.algorithm}; "
            f"τ_w differs from the recorded estimate by {_rms_N_m(recording, result) * 1e3:.4f} mN m RMS\n"
        )
    return 0 if is_identical or not is_same else EXIT_DIFFERENT


def _told(path: Path, recording: Recording, difference: Difference | None) -> str:
    count = f"{len(recording.references)} references from {len(recording.samples)} samples"
    if not recording.gaps:
        return f"differs: {difference}" if difference is not None else f"{count}, all identical; {_sent(recording)}"
    there = "all identical" if difference is None else f"different: {difference}"
    remedy = "" if RECOVERY_NAME in recording.metadata else f"; hil-forceps recover {path} lists what is missing"
    return f"incomplete: {count}, {there}; {'; '.join(recording.gaps)}{remedy}"


def _sent(recording: Recording) -> str:
    """Say how many of the ticks' references were sent (the number that `run` prints), and why the others were not."""
    sent, others = _counts(recording)
    return ", ".join([f"{sent} of them were sent", *(f"{count} {why}" for why, count in others.items())])


def _counts(recording: Recording) -> tuple[int, dict[str, int]]:
    """Return how many references were sent, and for each reason how many were not."""
    references = recording.references
    found = {}
    for outcome, why in _NOT_SENT.items():
        if count := int(np.count_nonzero(references["outcome"] == outcome)):
            found[why] = count
    unsent = references["verdict"][references["outcome"] == Outcome.NONE]
    for verdict, number in zip(*np.unique(unsent, return_counts=True), strict=True):
        found[VERDICT_NAMES.get(int(verdict), f"verdict {verdict}").lower().replace("_", " ")] = int(number)
    return int(np.count_nonzero(references["outcome"] == Outcome.SENT)), found


def _rms_N_m(recording: Recording, result: Replay) -> float:
    difference = result.samples["tau_w_estimate_N_m"] - recording.samples["tau_w_estimate_N_m"]
    return float(np.sqrt(np.nanmean(np.square(difference))))


def _data(path: Path, recording: Recording, result: Replay, algorithm: str, *, is_same: bool) -> dict[str, Any]:
    sent, others = _counts(recording)
    content: dict[str, Any] = {
        "recording": str(path),
        "algorithm": algorithm,
        "samples": len(recording.samples),
        "references": len(recording.references),
        "sent": sent,
        "not_sent": others,
        "missing_or_damaged": list(recording.gaps),
        "notes": list(recording.notes),
    }
    if not is_same:
        rms_N_m = _rms_N_m(recording, result)
        return {**content, "tau_w_difference_rms_N_m": rms_N_m if np.isfinite(rms_N_m) else None}
    difference = result.first_difference
    told = None if difference is None else {**difference._asdict(), **_values(difference)}
    return {**content, "identical": difference is None and not recording.gaps, "first_difference": told}


def _values(difference: Difference) -> dict[str, str]:
    """Return the two values as texts, with all digits; they may not be finite, which JSON can't express."""
    return {"recorded": repr(difference.recorded), "replayed": repr(difference.replayed)}
