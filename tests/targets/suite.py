"""The conformance suite as a user has it: the command, its certificate, and what is asked of that here."""

import json
import math
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from tests.targets.record import ROOT, TargetRecord
from tests.targets.setting import TORQUE_FREE_RUNS
from tests.targets.torque_free import TIMEOUT_US

ENVIRONMENT: Final = {**os.environ, "PYTHONPATH": f"{ROOT}:{os.environ.get('PYTHONPATH', '')}"}
LIMIT_S: Final = 550.0
# Ahead of what else runs here, where that is allowed.
AHEAD: Final = ("nice", "-n", "-15")
# A drive goes ahead of everything: one that is not woken is late, and a suite that was woken takes that for its fault.
DRIVE_AHEAD: Final = ("sh", "-c", 'chrt --rr --pid 1 $$ 2>/dev/null; exec nice -n -15 "$@"', "drive")


def judge(record: TargetRecord, out: Path, *arguments: str) -> dict[str, Any]:
    """Run the whole suite, motion allowed, and keep its certificate."""
    command = [*AHEAD, sys.executable, "-m", "hil_forceps.cli.main", "conformance", "--allow-motion", "--out", str(out)]
    done = subprocess.run(
        [*command, *arguments], cwd=ROOT, env=ENVIRONMENT, capture_output=True, text=True, check=False, timeout=LIMIT_S
    )
    assert done.returncode in (0, 1), done.stdout + done.stderr
    record.suite_results(out)
    certificate: dict[str, Any] = json.loads((out / "certificate.json").read_text(encoding="utf-8"))
    return certificate


def measure_torque_free(record: TargetRecord, out: Path, *arguments: str) -> None:
    """Measure the time to no torque over a line, keep it, and judge it."""
    path = out / "torque_free.json"
    out.mkdir(parents=True, exist_ok=True)
    command = [*AHEAD, sys.executable, "-m", "tests.targets.torque_free", "--runs", str(TORQUE_FREE_RUNS)]
    done = subprocess.run(
        [*command, "--out", str(path), *arguments],
        cwd=ROOT, env=ENVIRONMENT, capture_output=True, text=True, check=False, timeout=LIMIT_S,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    result = json.loads(path.read_text(encoding="utf-8"))
    record.torque_free(result)
    check_torque_free(result)


def check_torque_free(result: Mapping[str, Any]) -> None:
    """No time is longer than allowed; in real time nine of ten: a busy machine keeps a sample waiting, too."""
    times_ms = result["times_ms"]
    assert len(times_ms) == TORQUE_FREE_RUNS
    share = 1.0 if result["virtual"] else 0.9
    assert times_ms[math.ceil(share * len(times_ms)) - 1] <= result["within_ms"], times_ms
    assert times_ms[0] >= 0.9 * TIMEOUT_US / 1e3  # it was the watchdog, and not something else


def check(certificate: dict[str, Any], applicable: int, least_share: float = 0.7) -> None:
    """Nothing failed and most has passed: a busy machine may keep a check from telling, and fails nobody."""
    failed = {row["id"]: row["evidence"] for row in certificate["requirements"] if row["verdict"] == "fail"}
    assert failed == {}, f"failed: {failed}"
    verdicts = certificate["verdicts"]
    assert verdicts["pass"] + verdicts["inconclusive"] == applicable, f"not {applicable} judged: {verdicts}"
    assert verdicts["pass"] >= least_share * applicable, [
        (row["id"], row["evidence"]) for row in certificate["requirements"] if row["verdict"] == "inconclusive"
    ]
