"""Runs of an axis that one motor moves: angles and torques of a run as path and force at the rig's radius."""

from collections.abc import Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from hil_forceps.data.readers.read_run import read_run
from hil_forceps.data.readers.tables.mapping import ColumnMap
from hil_forceps.data.run import GAP_IN_INTERVALS, Run
from hil_forceps.identification.axis.force_terms import Vector
from hil_forceps.identification.axis.inverse_model import Rows, decimated
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError

MIN_DURATION_S = 4.0  # shorter runs have no blocks to leave out
_START_SAMPLES = 40  # the speed at the start is that of a cubic through so many samples


class AxisRun(NamedTuple):
    """One run, arrays [samples]."""

    name: str
    time_s: Vector
    position_m: Vector
    reference_m: Vector | None
    force_N: Vector
    sample_time_s: float
    start: tuple[float, float]  # position m and speed m/s at the first sample
    rows: Rows

    @property
    def row_time_s(self) -> Vector:
        """Time of the decimated rows [rows]."""
        here = self.time_s[len(self.time_s) - len(self.rows.motion.position_m) :]
        factor = self.rows.factor
        return here[(len(here) - 1) % factor :: factor]

    def row(self, values: Vector) -> Vector:
        """Decimate a signal of the run as the force is [rows]."""
        return decimated(values[len(values) - len(self.rows.motion.position_m) :], self.rows.factor)


def read_axis(sources: Sequence[Path], rig: Rig, mapping: ColumnMap = MappingProxyType({})) -> list[AxisRun]:
    """Read every run of an axis; UserError for one that has a jaw, a load, no torque, gaps, or is too short."""
    radius_m = rig.forceps.motor_pulley_radius_m.value
    if radius_m is None:
        raise UserError("forceps.motor_pulley_radius_m: its value isn't known and is needed here; give a value")
    runs = [run for source in sources for run in read_run(source, mapping=mapping)]
    problems = [f"run {run.name}: {problem}" for run in runs if (problem := _problem(run))]
    if problems:
        raise UserError(problems)
    return [to_axis(run, radius_m) for run in runs]


def _problem(run: Run) -> str:
    columns = run.columns
    if "theta_j_rad" in columns:
        return "has a jaw's angle; more than one source is for an axis alone; give one source"
    if "tau_m_N_m" not in columns:
        return "has no tau_m_N_m, the torque that moves the axis"
    if np.any(columns.get("tau_w_N_m", np.zeros(1)) != 0.0):
        return "carries a load (tau_w_N_m); this comparison is for an axis that moves only itself"
    if np.max(np.diff(columns["time_s"])) > GAP_IN_INTERVALS * run.sample_time_s:
        return "has gaps in time; differences of the position need every sample"
    if columns["time_s"][-1] - columns["time_s"][0] < MIN_DURATION_S:
        return f"lasts less than {MIN_DURATION_S:g} s"
    return ""


def to_axis(run: Run, radius_m: float) -> AxisRun:
    """Write a run as path and force at a radius."""
    columns = run.columns
    position, force = columns["theta_m_rad"] * radius_m, columns["tau_m_N_m"] / radius_m
    reference = columns["theta_m_ref_rad"] * radius_m if "theta_m_ref_rad" in columns else None
    time_s = columns["time_s"]
    sample_time_s = float(time_s[-1] - time_s[0]) / (len(time_s) - 1)  # stamps jitter; without gaps the mean is exact
    first = slice(0, _START_SAMPLES)
    speed = float(np.polyfit(time_s[first] - time_s[0], position[first], 3)[2])
    rows = Rows(position, force, sample_time_s)
    return AxisRun(run.name, time_s, position, reference, force, sample_time_s, (float(position[0]), speed), rows)
