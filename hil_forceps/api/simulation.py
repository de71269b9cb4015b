"""`simulate`: the rig's simulation of a measured run or of a motion of the jaw."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hil_forceps.api.arguments import check_duration, check_motion, kind, load_trajectory
from hil_forceps.api.runs import RigSource, as_rig
from hil_forceps.control.compensator import motor_reference_rad
from hil_forceps.control.trajectories import Trajectory
from hil_forceps.data.pandas_frame import to_pandas
from hil_forceps.data.run import Column, Run
from hil_forceps.identification.simulation import SUBSTEPS, simulate_beside
from hil_forceps.model import closed_loop
from hil_forceps.model.closed_loop import law_vector
from hil_forceps.model.parameters import vector
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """Result of a simulation: columns over `time_s`, named as those of a run.

    `measured` has the same channels of the measured run at the same times; it is empty for a motion.
    """

    name: str
    is_closed_loop: bool  # else the measured motion is its input
    columns: Mapping[str, Column]
    measured: Mapping[str, Column] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __getitem__(self, column: str) -> Column:
        """Return a simulated column, or `time_s`; KeyError if it was not simulated."""
        if column not in self.columns:
            raise KeyError(f"{column}: was not simulated; there are {', '.join(self.columns)}")
        return self.columns[column]

    def __repr__(self) -> str:
        how = "in closed loop" if self.is_closed_loop else "driven by the measured motion"
        return f"<Simulation {self.name!r} {how}: {len(self.columns['time_s'])} rows; {', '.join(self.columns)}>"

    def rmse(self, channel: str) -> float:
        """Return the root mean square of simulated less measured, in the column's unit."""
        return float(np.sqrt(np.mean(np.square(self._error(channel)))))

    def scatter(self, channel: str) -> float:
        """Return the same without the mean error, for sensors with an unknown zero."""
        return float(np.std(self._error(channel)))

    def to_run(self) -> Run:
        """Return the columns as a run, as if they had been measured; UserError if a required column is missing.

        Only a simulated motion has all of them.
        """
        if "theta_m_rad" not in self.columns:
            raise UserError(
                f"{self.name}: the measured motion was the input, so that the angle is not a result; use the run's "
                "angle"
            )
        return Run(self.name, dict(self.columns), self.notes)

    def to_pandas(self) -> Any:
        """Return the columns as a pandas DataFrame; UserError if pandas is not installed."""
        return to_pandas(self.columns)

    def _error(self, channel: str) -> Column:
        if channel not in self.measured:
            there = ", ".join(self.measured) or "none: a motion was simulated, not a run"
            raise KeyError(f"{channel} was not measured and simulated; there are {there}")
        return self.columns[channel] - self.measured[channel]


def simulate(
    rig: RigSource, like: Run | Trajectory, *, load_N_m: Trajectory | float = 0.0, duration_s: float | None = None
) -> Simulation:
    """Simulate a rig with its values, without noise.

    `like` a run: with its reference and load (or with its measured motion as input, if the rig has no `drive` or the
    run no reference), for a comparison of each channel. `like` a trajectory of the jaw [rad]: from rest, with the
    drive's law, uncompensated, under `load_N_m` on the jaw, a number or a trajectory of torques, for `duration_s`, by
    default to the trajectory's end. UserError if the rig or the run lacks required values; ValueError for a duration
    that isn't positive, and for a load or a duration together with a run.
    """
    known = as_rig(rig)
    load_trajectory("load_N_m", load_N_m)
    check_duration("duration_s", duration_s)
    if isinstance(like, Trajectory):
        check_motion("like", like)
        return _along(known, like, load_N_m, like.times_s[-1] if duration_s is None else duration_s)
    if not isinstance(like, Run):
        raise TypeError(f"like: must be a Run or a Trajectory, not {kind(like)}; hf.read_runs makes runs of tables")
    if duration_s is not None or load_N_m != 0.0:
        raise ValueError("load_N_m and duration_s: a run brings its load and duration; leave them out")
    result = simulate_beside(like, known)
    columns = {"time_s": result.time_s, **result.simulated}
    return Simulation(result.name, result.is_closed_loop, columns, result.measured, result.notes)


def _along(rig: Rig, trajectory: Trajectory, load_N_m: Trajectory | float, duration_s: float) -> Simulation:
    law, plant, theta = rig.require_drive(), rig.plant(), vector(rig)
    if not duration_s > 0.0:
        raise ValueError(f"duration_s: a simulation can't last {duration_s} s; give one above 0")
    time_s: Column = np.arange(round(duration_s / law.sample_time_s) + 1, dtype=np.float64) * law.sample_time_s
    reference = np.array([motor_reference_rad(trajectory(t), 0.0, plant) for t in time_s.tolist()])
    if isinstance(load_N_m, Trajectory):
        load = np.array([load_N_m(t) for t in time_s.tolist()])
    else:
        load = np.full(time_s.size, load_N_m)
    start = closed_loop.rest(theta, float(reference[0]), float(load[0]) / plant.jaw_pulley_radius_m)
    inputs = closed_loop.Inputs(time_s, reference, load, np.empty(0, np.int64), np.empty(0))
    out = closed_loop.simulate(theta, law_vector(law), rig.encoder.quantum_rad, inputs, start, SUBSTEPS)
    columns = {
        "time_s": time_s,
        "theta_m_ref_rad": reference,
        "theta_m_rad": out.theta_m_rad,
        "current_A": out.current_A,
        "theta_j_rad": out.theta_j_rad,
        "tau_w_N_m": load,
    }
    if wild := [name for name, values in columns.items() if not np.all(np.isfinite(values))]:
        raise UserError(f"the simulation diverges in {wild[0]}; check the values of the rig and its section drive")
    return Simulation("simulation", True, columns)
