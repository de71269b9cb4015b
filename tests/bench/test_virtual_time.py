"""How fast virtual time runs: whole runs of the bench, as `hil-forceps bench` makes them, in processor time.

Processor time of this process (user), not the wall clock: on a busy machine the latter measures the others. Where the
time goes is seen by a run with a stopwatch around each stage; the stopwatch costs time itself, so only the shares of
that run count.
"""

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hil_forceps.bench.execute import execute, rig_for
from hil_forceps.bench.matrix import RunSpec
from hil_forceps.bridge.logs.bus_log import BusLog
from hil_forceps.data.recording.writer import Recorder
from hil_forceps.rig import Rig, load_rig
from virtual_bus.drive import SimulatedDrive
from virtual_bus.interface import VirtualForcepsBus

CONFIGS = Path(__file__).parents[2] / "configs"
SIMULATED_S = 20.0
REQUIRED_FACTOR = 20.0
ROUNDS = 3
DIRECT_S = 1.0e-4

# What belongs to which stage; all else is the host: service, protocol, pipeline, and reading the recording for metrics.
STAGES: dict[str, tuple[tuple[type, tuple[str, ...]], ...]] = {
    "world": ((SimulatedDrive, ("wake", "receive")),),
    "medium": ((VirtualForcepsBus, ("advance_until_ns", "send_frame", "receive_frames")),),
    "recording": ((Recorder, ("sample", "reference", "bench", "close")), (BusLog, ("add", "close"))),
}


class Stopwatch:
    """Splits time among stages that call each other: only the innermost runs."""

    def __init__(self) -> None:
        self.ns = dict.fromkeys((*STAGES, "host"), 0)
        self._stage = "host"
        self._since = time.perf_counter_ns()

    def enter(self, stage: str) -> str:
        """Go to a stage; return the one before."""
        now, before = time.perf_counter_ns(), self._stage
        self.ns[before] += now - self._since
        self._stage, self._since = stage, now
        return before

    def around(self, method: Callable[..., Any], stage: str) -> Callable[..., Any]:
        def timed(*arguments: Any) -> Any:
            before = self.enter(stage)
            try:
                return method(*arguments)
            finally:
                self.enter(before)

        return timed


def user_s(work: Callable[[], object]) -> float:
    before = os.times().user
    work()
    return os.times().user - before


def say(capsys: pytest.CaptureFixture[str], text: str) -> None:
    with capsys.disabled():
        sys.stdout.write(f"\n{text}\n")


def spec_of(rig: Rig, algorithm: str, on_bus: bool) -> RunSpec:
    return RunSpec(2, algorithm, True, rig.bench.host_period_s if on_bus else DIRECT_S, on_bus)


@pytest.mark.parametrize("algorithm", ["improved", "kalman"])
@pytest.mark.parametrize("config", ["paper", "realistic"])
def test_virtual_time_over_the_bus(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    config: str,
    algorithm: str,
) -> None:
    rig = load_rig(CONFIGS / f"{config}.yaml")
    spec = spec_of(rig, algorithm, on_bus=True)
    executed = execute(spec, rig, 0, tmp_path)  # compiles what isn't compiled yet
    ticks = round(SIMULATED_S / rig.bench.host_period_s)
    assert executed.record.frames_sent > ticks
    least_s = min(user_s(lambda: execute(spec, rig, 0, tmp_path)) for _ in range(ROUNDS))

    watch = Stopwatch()
    for stage, members in STAGES.items():
        for owner, names in members:
            for name in names:
                monkeypatch.setattr(owner, name, watch.around(getattr(owner, name), stage))
    execute(spec, rig, 0, tmp_path)
    watch.enter("host")
    total_ns = sum(watch.ns.values())
    assert min(watch.ns.values()) > 0
    shares = ", ".join(f"{name} {100.0 * ns / total_ns:.0f} %" for name, ns in watch.ns.items())
    say(
        capsys,
        f"virtual time over the bus, {config}, {algorithm}: {least_s / ticks * 1e6:.1f} µs of processor time per tick, "
        f"{SIMULATED_S / least_s:.1f} times real time (wanted: at least {REQUIRED_FACTOR:.0f}); {shares}",
    )


@pytest.mark.parametrize("algorithm", ["improved", "kalman"])
def test_virtual_time_without_the_bus(tmp_path: Path, capsys: pytest.CaptureFixture[str], algorithm: str) -> None:
    rig = load_rig(CONFIGS / "paper.yaml")
    spec = spec_of(rig, algorithm, on_bus=False)
    assert rig_for(spec, rig).require_drive().sample_time_s == DIRECT_S
    execute(spec, rig, 0, tmp_path)
    least_s = min(user_s(lambda: execute(spec, rig, 0, tmp_path)) for _ in range(ROUNDS))
    ticks = round(SIMULATED_S / DIRECT_S)
    say(
        capsys,
        f"without the bus at {DIRECT_S * 1e3:g} ms, {algorithm}: {least_s / ticks * 1e6:.1f} µs of processor time per "
        f"tick, {SIMULATED_S / least_s:.1f} times real time",
    )
