"""Simulation 2 of the paper with a firmware in the loop, beside the same run in process."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from hil_forceps.bench.execute import Executed, run_on
from hil_forceps.bench.matrix import RunSpec
from hil_forceps.bridge.clocks import VirtualClock
from hil_forceps.bridge.links.adapters import Connection
from hil_forceps.bridge.links.can_link import VirtualTimeLink
from hil_forceps.bridge.ports import Link
from hil_forceps.rig import load_rig
from tests.targets.lockstep import LockstepWorld, PlantLine
from tests.targets.record import ROOT, TargetRecord, latency_figures
from tests.targets.setting import rmse_N_m, setting
from virtual_bus.drive import SimulatedDrive, drive_config_of, forceps_of
from virtual_bus.interface import VirtualForcepsBus
from virtual_bus.plant.forceps import SimulatedForceps

RIG: Final = load_rig(ROOT / "configs" / "paper.yaml")
SEED: Final = 1
SPEC: Final = RunSpec(2, "kalman", True, RIG.bench.host_period_s, True, setting().duration_s)
LATENCY: Final = "wall clock, from a sample asked of the firmware, with the setpoint before it, to its frames decoded"
JAW_TOLERANCE_RAD: Final = 1.0e-4  # measured 1.7e-5; a gain of the position loop that is a tenth off makes 1e-2
RMSE_TOLERANCE: Final = 0.01  # single precision in the firmware, and frames that take no time: 0.0003 measured


def drive_arguments() -> list[str]:
    """Return the settings that the rig wants of the process hfp-drive."""
    law, config = RIG.require_drive(), drive_config_of(RIG, RIG.bench.node_id, fd=False)
    loop = {name: getattr(law, name) for name in type(law).model_fields}
    drive = {name: getattr(config, name) for name in type(config).__dataclass_fields__ if name != "fd"}
    return [word for name, value in {**loop, **drive}.items() for word in (f"--{name}", f"{value!r}")]


@cache
def in_process() -> Executed:
    """Run it with the Python drive on the virtual bus, once."""
    bus = VirtualForcepsBus("in process", nodes=[SimulatedDrive(RIG, setting().load, seed=SEED)])
    with TemporaryDirectory() as folder:
        return run_on(Connection(VirtualTimeLink(bus), VirtualClock(bus), True, ()), SPEC, RIG, SEED, Path(folder))


def figures_of(executed: Executed, latency: str, latencies_us: Sequence[float]) -> dict[str, Any]:
    """Return what `TargetRecord.loop` takes; `latency` says what the latencies are."""
    counters = executed.record.timing["counters"]
    return {
        "simulation": SPEC.simulation,
        "algorithm": SPEC.algorithm,
        "duration_s": SPEC.duration_s,
        "rmse_N_m": rmse_N_m(executed),
        "in_process_rmse_N_m": rmse_N_m(in_process()),
        "jaw_difference_rad": _jaw_difference_rad(executed),
        "latency": latency,
        "latency_us": latency_figures(latencies_us),
        "samples": counters["host"]["samples"],
        "setpoints": counters["host"]["setpoints_sent"],
        "lost": executed.record.frames_lost,
        "wall_s": round(executed.record.timing["wall_s"], 1),
        "ending": executed.record.ending,
    }


def _jaw_difference_rad(executed: Executed) -> float:
    """Return by how much the jaw was elsewhere than in process, at worst; what was recorded by both counts."""
    jaw, direct = executed.traces.theta_j_true, in_process().traces.theta_j_true
    size = min(jaw.size, direct.size)
    return float(np.max(np.abs(jaw[:size] - direct[:size]), initial=0.0))


def ages_us(executed: Executed) -> list[float]:
    """Return from the service's histogram how old each sample was when its setpoint left."""
    return [edge_us for edge_us, count in executed.record.timing["loop"]["age"]["bins"] for _ in range(count)]


def close_loop(record: TargetRecord, link: Link, line: PlantLine, folder: Path, fd: bool = False) -> dict[str, Any]:
    """Run the service against the firmware behind `link` with its plant behind `line`; keep and return the figures."""
    rig = RIG.with_changes({"bench.transport": "fd"}) if fd else RIG
    forceps = forceps_of(RIG, setting().load, SEED)
    assert isinstance(forceps, SimulatedForceps)  # the paper's rig has no effects
    period_ns = round(RIG.require_drive().sample_time_s * 1e9)
    world = LockstepWorld(link, line, forceps, RIG.bench.node_id, period_ns)
    executed = run_on(Connection(world, world, True, ()), SPEC, rig, SEED, folder)
    figures = figures_of(executed, LATENCY, world.exchange_us)
    record.loop(figures)
    return figures


def check_loop(figures: dict[str, Any]) -> None:
    """The firmware does what the Python drive does: every frame there, and the same error of the estimate."""
    periods = round(SPEC.duration_s / SPEC.sample_time_s)
    ratio = figures["rmse_N_m"] / figures["in_process_rmse_N_m"]
    assert (figures["ending"], figures["lost"]) == ("completed", 0), (
        f"ended: {figures['ending']}, {figures['lost']} lost"
    )
    assert periods <= figures["setpoints"] <= figures["samples"] <= periods + 100, f"counts: {figures}"
    assert abs(ratio - 1.0) < RMSE_TOLERANCE, f"RMSE is {ratio} times that in process"


def check_same_motion(figures: dict[str, Any]) -> None:
    """The jaw goes where it goes in process: the firmware's position loop, which the estimate hardly depends on."""
    jaw_rad = figures["jaw_difference_rad"]
    assert jaw_rad < JAW_TOLERANCE_RAD, f"the jaw is {jaw_rad} rad elsewhere"
