"""What a run of a target leaves behind, and the targets that there are: one folder each.

tools/targets/target_table.py reads them.

A folder holds `outcome.json`, and as far as the target came `certificate.json` and `junit.xml` of the conformance
suite, `loop.json` of simulation 2 and `torque_free.json` with times to no torque. A target is run in parts, by tests of
their own; the worst part is the target's state.
HIL_FORCEPS_TARGETS_DIR is where the folders are, build/targets otherwise. HIL_FORCEPS_EXPECT_TARGETS is `all`, or names
the targets that may not be missing here.
"""

import fcntl
import json
import os
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Any, Final, NamedTuple, NoReturn

import numpy as np
import pytest

ROOT: Final = Path(__file__).resolve().parents[2]
HISTOGRAM_EDGES_US: Final = (0, 10, 20, 50, 100, 200, 500, 1_000, 2_000, 5_000, 10_000, 20_000, 50_000, 100_000)
LOOP_KEYS: Final = frozenset(
    ("algorithm", "duration_s", "rmse_N_m", "in_process_rmse_N_m", "latency_us", "samples", "setpoints", "lost")
)


class Part(StrEnum):
    """What is run on a target."""

    CONFORMANCE = "conformance"
    LOOP = "loop"
    TIMEOUTS = "timeouts"
    TORQUE_FREE = "time to no torque"


class State(StrEnum):
    """How it went, best first."""

    RAN = "ran"
    NOT_AVAILABLE = "not available"
    FAILED = "failed"


class Target(NamedTuple):
    """One target, and the parts without which it has not been run."""

    title: str
    parts: tuple[Part, ...] = (Part.CONFORMANCE, Part.LOOP, Part.TORQUE_FREE)


TARGETS: Final = {
    "python-virtual-time": Target("Python drive, virtual time"),
    "python-pty": Target("Python drive as a process, pseudo terminal", (Part.CONFORMANCE, Part.TORQUE_FREE)),
    "python-udp-multicast": Target(
        "Python drive as a process, UDP multicast, FD", (Part.CONFORMANCE, Part.TORQUE_FREE)
    ),
    "c-process-pty": Target("C firmware as a process, pseudo terminal"),
    "c-process-udp": Target("C firmware as a process, UDP"),
    "qemu-mps2-uart": Target("C firmware on a Cortex-M4F, QEMU mps2-an386, UART"),
    "unicorn-bxcan": Target("C firmware for an STM32F405, Unicorn, bxCAN"),
    "socketcan-vcan-classic": Target("C firmware over SocketCAN, vcan, classic"),
    "socketcan-vcan-fd": Target("C firmware over SocketCAN, vcan, FD"),
    "socketcan-slcan": Target("C firmware over SocketCAN, slcan on a pseudo terminal"),
    "socketcan-time-travel": Target("Watchdog and time-outs on the kernel's CAN in virtual time", (Part.TIMEOUTS,)),
}


def targets_root() -> Path:
    """Return the folder that holds a folder for each target."""
    return Path(os.environ.get("HIL_FORCEPS_TARGETS_DIR") or ROOT / "build" / "targets")


def is_expected(target: str) -> bool:
    """Tell whether this machine is one on which the target may not be missing."""
    named = os.environ.get("HIL_FORCEPS_EXPECT_TARGETS", "").split()
    return "all" in named or target in named


class TargetRecord:
    """Writes down one part of one target. Raises ValueError for a target or a result that nobody would look for."""

    def __init__(self, target: str, part: Part) -> None:
        if target not in TARGETS:
            raise ValueError(f"{target}: no such target")
        self.target, self.part = target, part
        self.folder = targets_root() / target
        self.folder.mkdir(parents=True, exist_ok=True)
        self._begin_s = time.monotonic()
        self.finish(State.FAILED, "did not come to its end")

    def certificate(self, certificate: Mapping[str, Any]) -> None:
        """Keep the certificate of the conformance suite."""
        if "requirements" not in certificate or "verdicts" not in certificate:
            raise ValueError("a certificate has requirements and verdicts")
        _write(self.folder / "certificate.json", certificate)

    def suite_results(self, folder: Path) -> None:
        """Keep certificate.json and junit.xml that `hil-forceps conformance --out folder` wrote."""
        self.certificate(json.loads((folder / "certificate.json").read_text(encoding="utf-8")))
        shutil.copyfile(folder / "junit.xml", self.folder / "junit.xml")

    def loop(self, result: Mapping[str, Any]) -> None:
        """Keep the figures of the closed loop; LOOP_KEYS have to be there, `latency_us` as of `latency_figures`."""
        missing = LOOP_KEYS - result.keys()
        if missing:
            raise ValueError(f"a loop without {', '.join(sorted(missing))}")
        _write(self.folder / "loop.json", result)

    def torque_free(self, result: Mapping[str, Any]) -> None:
        """Keep the times to no torque."""
        if len(result["times_ms"]) == 0:
            raise ValueError("no times")
        _write(self.folder / "torque_free.json", result)

    def finish(self, state: State, reason: str = "") -> None:
        """Say how this part went."""
        with _alone(self.folder):  # parts may end in processes of their own
            self._finish(state, reason)

    def _finish(self, state: State, reason: str) -> None:
        path = self.folder / "outcome.json"
        parts = json.loads(path.read_text(encoding="utf-8"))["parts"] if path.exists() else {}
        seconds = round(time.monotonic() - self._begin_s, 1)
        parts[self.part] = {"state": state, "reason": reason, "seconds": seconds}
        worst = max(parts.values(), key=lambda part: list(State).index(State(part["state"])))
        outcome = {
            "target": self.target,
            "title": TARGETS[self.target].title,
            "state": worst["state"],
            "reason": worst["reason"],
            "seconds": round(sum(part["seconds"] for part in parts.values()), 1),
            "parts": parts,
        }
        _write(path, outcome)

    def not_available(self, reason: str) -> NoReturn:
        """End the test: a failure where the target is expected, else a skip that the table shows."""
        if is_expected(self.target):
            pytest.fail(f"{self.target} not available: {reason}")
        self.finish(State.NOT_AVAILABLE, reason)
        pytest.skip(f"{self.target} not available: {reason}")


@contextmanager
def recorded(target: str, part: Part) -> Iterator[TargetRecord]:
    """Write down a part of a target: `ran` when the block ends, `failed` with the reason when it raises."""
    record = TargetRecord(target, part)
    try:
        yield record
    except pytest.skip.Exception:
        raise
    except BaseException as error:
        record.finish(State.FAILED, (str(error) or type(error).__name__).splitlines()[0][:300])
        raise
    record.finish(State.RAN)


def latency_figures(latencies_us: Sequence[float]) -> dict[str, Any]:
    """Return count, percentiles (us) and a histogram of latencies (us); ValueError when there are none."""
    if len(latencies_us) == 0:
        raise ValueError("no latencies")
    values = np.asarray(latencies_us, dtype=np.float64)
    p50, p90, p99 = (float(v) for v in np.percentile(values, (50, 90, 99)))
    edges = [*HISTOGRAM_EDGES_US, float("inf")]
    counts = np.histogram(values, np.asarray(edges))[0]
    return {
        "count": len(values),
        "p50": round(p50, 1),
        "p90": round(p90, 1),
        "p99": round(p99, 1),
        "max": round(float(values.max()), 1),
        "histogram": {"edges_us": list(HISTOGRAM_EDGES_US), "counts": [int(n) for n in counts]},
    }


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Keep other processes out of a folder while the body runs."""
    with (folder / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _write(path: Path, content: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
