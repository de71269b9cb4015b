"""Runs without the bus: samples go directly to estimator, compensation and gate.

For sample times that are too short for CAN. The simulated world is loaded by entry point, as drives are, so that the
none.
"""

import time
from collections.abc import Callable
from importlib.metadata import entry_points
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from hil_forceps.bench.assembly import Rigs, gate_for
from hil_forceps.bench.direct.run_ahead import CURRENT, REQUESTED, THETA_M, Ahead, CompiledWorld, Law
from hil_forceps.bench.matrix import RunSpec
from hil_forceps.bench.metrics import judge
from hil_forceps.bench.summary import RunRecord
from hil_forceps.control.compensator import motor_reference_rad
from hil_forceps.control.trajectories import PAPER_TRAJECTORY
from hil_forceps.estimation.interface import Compiled, Sample
from hil_forceps.estimation.registry import make_estimator
from hil_forceps.report.traces import RunTraces
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError

GROUP = "hil_forceps.world"
WORLD = "simulated"
STOP_CHECK_SAMPLES = 1000


class World(Protocol):
    """A forceps with its position loop, stepped one sample at a time."""

    def sample(self) -> tuple[int, float, float, float, float]:
        """Latch all sensors now: time [ns], θ_m [rad], current [A], θ_j [rad], τ_w [N m]."""

    def advance(self, reference_rad: float) -> None:
        """Advance by one sample with this reference of the motor angle."""

    def compiled(self) -> CompiledWorld | None:
        """Return the world in its initial state for a compiled loop; None if there is no compiled version."""


class DirectRun(NamedTuple):
    """Result, one row per sample: time, τ_w, τ̂_w, θ_j, θ_j^ref, x, x̂; and why the run ended."""

    rows: NDArray[np.float64]
    ending: str


def execute_direct(
    spec: RunSpec, rigs: Rigs, seed: int, stop_requested: Callable[[], bool]
) -> tuple[RunRecord, RunTraces]:
    """Run `spec` at its sample time without protocol and bus; UserError if no world is installed."""
    world = _world_factory()(rigs.plant, spec.simulation, seed)
    began = time.perf_counter()
    run = run_direct(world, spec, rigs, stop_requested, ahead=True)
    wall_s = time.perf_counter() - began
    time_s, tau_w, tau_w_est, theta_j, theta_j_ref, x, x_est = run.rows.T
    of = (spec.algorithm, spec.compensated, spec.simulation, spec.sample_time_s)
    traces = RunTraces(time_s, tau_w, tau_w_est, theta_j, theta_j_ref, x, x_est, *of)
    simulated_s = float(traces.time_s[-1])
    timing = {"real_time_factor": simulated_s / wall_s, "simulated_s": simulated_s, "wall_s": wall_s}
    return RunRecord(spec, judge(traces), 0, 0, run.ending, timing), traces


def _world_factory() -> Callable[[Rig, int, int], World]:
    found = {point.name: point for point in entry_points(group=GROUP)}
    if WORLD not in found:
        raise UserError(
            f"the simulated world '{WORLD}' is not installed (entry point group {GROUP}); run `make install`"
        )
    factory: Callable[[Rig, int, int], World] = found[WORLD].load()
    return factory


def run_direct(
    world: World, spec: RunSpec, rigs: Rigs, stop_requested: Callable[[], bool], *, ahead: bool
) -> DirectRun:
    """Step `world` through the run; end at the first reference that the gate denies, or on request.

    `ahead`: use the compiled loop of `run_ahead` if world and estimator allow; the results are the same.
    """
    estimator = make_estimator(spec.algorithm, rigs.estimator, spec.sample_time_s, over_wire=False)
    compiled = world.compiled() if ahead else None
    if compiled is not None and estimator.compiled is not None:
        run = _run_ahead(compiled, estimator.compiled, spec, rigs, stop_requested)
        if run is not None:
            return run
    believed, gate, trajectory = rigs.estimator.plant(), gate_for(rigs.plant, spec.sample_time_s), PAPER_TRAJECTORY
    r_m, r_j = rigs.plant.plant().motor_pulley_radius_m, rigs.plant.plant().jaw_pulley_radius_m
    torque_per_A = believed.torque_constant_N_m_per_A
    samples = round(spec.duration_s / spec.sample_time_s) + 1  # both ends, as in the service
    rows = np.empty((samples, 7))
    state = None
    for row in range(samples):
        now_ns, theta_m_rad, current_A, theta_j_rad, tau_w = world.sample()
        sample = Sample(now_ns, theta_m_rad, torque_per_A * current_A)
        state = estimator.start(sample) if state is None else estimator.step(state, sample)
        tau_w_est, x_est = estimator.estimate(state)
        t_s = now_ns * 1e-9
        theta_j_ref_rad = trajectory(t_s)
        rows[row] = (t_s, tau_w, tau_w_est, theta_j_rad, theta_j_ref_rad, r_m * theta_m_rad - r_j * theta_j_rad, x_est)
        wanted_rad = motor_reference_rad(theta_j_ref_rad, x_est if spec.compensated else 0.0, believed)
        gate.see(now_ns, now_ns, theta_m_rad, current_A)
        if row == 0:
            gate.open(now_ns)
        passed_rad, verdict = gate.step(wanted_rad, now_ns)
        if passed_rad is None:
            return DirectRun(rows[: row + 1], f"the gate denied the reference at {t_s:.4f} s: {verdict.name}")
        if row % STOP_CHECK_SAMPLES == 0 and stop_requested():
            return DirectRun(rows[: row + 1], "stopped on request")
        world.advance(passed_rad)
    return DirectRun(rows, "completed")


def _run_ahead(
    world: CompiledWorld, estimator: Compiled, spec: RunSpec, rigs: Rigs, stop_requested: Callable[[], bool]
) -> DirectRun | None:
    """Run ahead of the gate; None if the gate changes so many references that this is slower."""
    gate, period_ns = gate_for(rigs.plant, spec.sample_time_s), round(spec.sample_time_s * 1e9)
    samples = round(spec.duration_s / spec.sample_time_s) + 1  # both ends, as in the service
    time_s = np.asarray(period_ns * np.arange(samples) * 1e-9, dtype=np.float64)
    theta_j_ref = PAPER_TRAJECTORY.angles(time_s)
    ahead = Ahead(world, estimator, Law(rigs.estimator.plant(), spec.compensated), period_ns, theta_j_ref)
    table = np.empty((samples, 7))
    done, passed_rad, ending = 0, 0.0, "completed"
    while done < samples and ending == "completed":
        block = ahead.block(done, passed_rad)
        theta_m_rad, current_A, wanted_rad = block[:, [THETA_M, CURRENT, REQUESTED]].T.copy()
        kept = 0
        while kept < len(block):
            row = done + kept
            until = kept + 1 + -row % STOP_CHECK_SAMPLES
            followed = gate.follow(period_ns, theta_m_rad[kept:until], current_A[kept:until], wanted_rad[kept:until])
            if followed:
                kept += followed
                passed_rad = float(wanted_rad[kept - 1])
            else:
                now_ns, wanted = row * period_ns, float(wanted_rad[kept])
                kept += 1
                gate.see(now_ns, now_ns, float(theta_m_rad[kept - 1]), float(current_A[kept - 1]))
                if row == 0:
                    gate.open(now_ns)
                passed, verdict = gate.step(wanted, now_ns)
                if passed is None:
                    ending = f"the gate denied the reference at {float(time_s[row]):.4f} s: {verdict.name}"
                    break
                passed_rad = passed
                if passed != wanted:
                    break
            if (done + kept - 1) % STOP_CHECK_SAMPLES == 0 and stop_requested():
                ending = "stopped on request"
                break
        table[done : done + kept] = block[:kept]
        ahead.keep(kept, len(block))
        done += kept
        if not ahead.pays(done):
            return None
    plant, (tau_w, tau_w_est, theta_j, theta_m, _, x_est, _) = rigs.plant.plant(), table[:done].T
    x = plant.motor_pulley_radius_m * theta_m - plant.jaw_pulley_radius_m * theta_j
    columns = (time_s[:done], tau_w, tau_w_est, theta_j, theta_j_ref[:done], x, x_est)
    return DirectRun(np.column_stack(columns), ending)
