"""One run of the bench: the service against the simulated drive, in virtual time, over the bus."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from hil_forceps.bench.assembly import Settings, rigs_for
from hil_forceps.bench.direct.runs import execute_direct
from hil_forceps.bench.matrix import RunSpec
from hil_forceps.bench.metrics import judge
from hil_forceps.bench.session import Plan, run_session, service_config
from hil_forceps.bench.summary import RunRecord
from hil_forceps.bench.traces import traces_of
from hil_forceps.bridge.links.adapters import Connection, LinkSpec, open_link
from hil_forceps.bridge.results import ServiceResult
from hil_forceps.control.trajectories import PAPER_TRAJECTORY
from hil_forceps.data.recording.reader import read_recording
from hil_forceps.drives.registry import machine_for, sample_period_s
from hil_forceps.live.view import View
from hil_forceps.report.traces import RunTraces
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError


class Executed(NamedTuple):
    """A finished run."""

    record: RunRecord
    traces: RunTraces


def rig_for(spec: RunSpec, rig: Rig) -> Rig:
    """Return the rig for this run: runs without the bus have their own rate and no delays."""
    if spec.on_bus:
        return rig
    period_s = spec.sample_time_s
    return rig.with_changes(
        {
            "drive.sample_time_s": period_s,
            "bench.host_period_s": period_s,
            "bench.host_phase_s": period_s / 2.0,
            "bench.latency_s": 0.0,
            "bench.latency_jitter_s": 0.0,
            "bench.drive_clock_ppm": 0.0,
            "bench.feedback_divider": 1,
            "bench.plant_step_s": min(rig.bench.plant_step_s, period_s),
        }
    )


def never() -> bool:
    """Return False: no stop is requested."""
    return False


def execute(
    spec: RunSpec,
    rig: Rig,
    seed: int,
    out: Path,
    stop_requested: Callable[[], bool] = never,
    estimator_rig: Rig | None = None,
) -> Executed:
    """Run `spec` in virtual time; `estimator_rig`: if the spec names one. UserError if its files can't be written.

    A run on the bus writes `out`/NAME.mcap and `out`/NAME.log; a run without the bus writes no files.
    """
    rig = rig_for(spec, rig)
    if not spec.on_bus:
        return Executed(*execute_direct(spec, rigs_for(spec, rig, estimator_rig), seed, stop_requested))
    link = LinkSpec(
        interface="virtual_forceps",
        channel=spec.name,
        fd=rig.bench.transport == "fd",
        bitrate_bit_per_s=rig.bench.bitrate_bit_per_s,
        data_bitrate_bit_per_s=rig.bench.data_bitrate_bit_per_s,
        options={"rig": rig, "simulation": spec.simulation, "seed": seed},
    )
    return run_on(open_link(link), spec, rig, seed, out, stop_requested, estimator_rig)


def run_on(
    connection: Connection,
    spec: RunSpec,
    rig: Rig,
    seed: int,
    out: Path,
    stop_requested: Callable[[], bool] = never,
    estimator_rig: Rig | None = None,
    view: View | None = None,
) -> Executed:
    """Run the service on an open link, with recording and bus log, and compute the metrics of the recording."""
    same_clock = connection.virtual_time and rig.bench.drive_clock_ppm == 0.0
    settings = Settings(spec.algorithm, spec.compensated, sample_period_s(rig), PAPER_TRAJECTORY, same_clock)
    plan = Plan(
        rigs_for(spec, rig, estimator_rig).estimator,
        settings,
        machine_for(rig),
        service_config(rig, spec.duration_s),
        recording=out / f"{spec.name}.mcap",
        bus_log=out / f"{spec.name}.log",
        about={"simulation": str(spec.simulation), "seed": str(seed)},
    )
    session = run_session(connection, plan, stop_requested, view=view)
    if session.failures:
        raise UserError([f"{out}: {failure}" for failure in session.failures])
    traces = traces_of(read_recording(plan.recording), spec, rig.plant(), PAPER_TRAJECTORY)
    return Executed(_record(spec, traces, session.service, session.wall_s), traces)


def _record(spec: RunSpec, traces: RunTraces, result: ServiceResult, wall_s: float) -> RunRecord:
    simulated_s = float(traces.time_s[-1]) if traces.time_s.size else 0.0
    counters = result.counters
    timing: dict[str, Any] = {
        "real_time_factor": simulated_s / wall_s,
        "simulated_s": simulated_s,
        "wall_s": wall_s,
        "loop": dict(result.timing),
        "counters": {name: dict(values) for name, values in counters.items()},
    }
    return RunRecord(
        spec,
        judge(traces),
        frames_sent=counters["service"]["frames_sent"],
        frames_lost=counters["host"]["lost_feedback"] + counters["host"]["lost_setpoints"],
        ending=result.message or result.reason.value,
        timing=timing,
    )
