"""What a tick of each drive profile takes, beside the project's own protocol in the same run: 1.5 times at most."""

import statistics
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from firmware_protocol.frames import Frame
from hil_forceps.bench.assembly import Settings, make_pipeline
from hil_forceps.bench.session import service_config, stamps_are_host_time
from hil_forceps.bridge.axis import Axis
from hil_forceps.bridge.clocks import VirtualClock
from hil_forceps.bridge.links.can_link import VirtualTimeLink
from hil_forceps.bridge.ports import SendResult
from hil_forceps.bridge.service import Service
from hil_forceps.control.trajectories import PAPER_TRAJECTORY
from hil_forceps.drives.registry import machine_for, sample_period_s
from hil_forceps.rig import load_rig
from virtual_bus.interface import VirtualForcepsBus

CONFIGS = Path(__file__).parents[2] / "configs"
RIGS = {"native": CONFIGS / "realistic.yaml", **{p.stem: p for p in sorted((CONFIGS / "drives").glob("*.yaml"))}}
DURATION_S, ROUNDS, SKIPPED_TICKS = 6.0, 3, 500
MOST = 1.5


class TimedAxis(Axis):
    """Counts the time of its own work: what the link takes is left out, for lines differ."""

    def __init__(self, *arguments: object, **keywords: object) -> None:
        super().__init__(*arguments, **keywords)  # type: ignore[arg-type]
        self.ticks_ns: list[int] = []
        self._received_ns = 0

    def receive(self, received: Sequence[tuple[int, Frame]]) -> None:
        began_ns = time.perf_counter_ns()
        super().receive(received)
        self._received_ns = time.perf_counter_ns() - began_ns

    def tick(self, now_ns: int, send: Callable[[Frame], SendResult], clock_ns: Callable[[], int]) -> None:
        sending_ns = 0

        def timed(frame: Frame) -> SendResult:
            nonlocal sending_ns
            began_ns = time.perf_counter_ns()
            result = send(frame)
            sending_ns += time.perf_counter_ns() - began_ns
            return result

        began_ns = time.perf_counter_ns()
        super().tick(now_ns, timed, clock_ns)
        self.ticks_ns.append(self._received_ns + time.perf_counter_ns() - began_ns - sending_ns)


def median_tick_ns(path: Path) -> float:
    rig = load_rig(path)
    bus = VirtualForcepsBus(f"ticks {path}", rig=rig, simulation=2)
    clock, config = VirtualClock(bus), service_config(rig, DURATION_S)
    settings = Settings("kalman", True, sample_period_s(rig), PAPER_TRAJECTORY, stamps_are_host_time(rig))
    axis = TimedAxis(machine_for(rig), make_pipeline(rig, settings), config)
    (result,) = Service(VirtualTimeLink(bus), clock, [axis], config).run()
    bus.shutdown()
    assert result.ok, result.message
    return statistics.median(axis.ticks_ns[SKIPPED_TICKS:])


def test_profile_ticks(capsys: pytest.CaptureFixture[str]) -> None:
    ratios: dict[str, list[float]] = {name: [] for name in RIGS}
    for _ in range(ROUNDS):
        ticks = {name: median_tick_ns(path) for name, path in RIGS.items()}
        for name, took_ns in ticks.items():
            ratios[name].append(took_ns / ticks["native"])
    best = {name: min(found) for name, found in ratios.items()}
    with capsys.disabled():
        sys.stdout.write("\ntick over the native one: " + ", ".join(f"{n} {r:.2f}" for n, r in best.items()) + "\n")
    assert max(best.values()) <= MOST
