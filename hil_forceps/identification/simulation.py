"""The plain simulation beside a run: the rig as it is, driven as the run was; nothing is fitted but where it starts."""

from typing import Literal, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from hil_forceps.data.run import GAP_IN_INTERVALS, WHOLE_MULTIPLE, Column, Run
from hil_forceps.model import closed_loop, driven
from hil_forceps.model.closed_loop import DriveState, law_vector
from hil_forceps.model.drive_law import law_current
from hil_forceps.model.parameters import index, vector
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.schema import Rig
from hil_forceps.rig.sections import DriveLaw

SUBSTEPS = 4  # of the plant in a sample of the drive
Reference = Literal["held", "straight", "smooth"]  # how a reference goes on between rows: no rig says
REFERENCES: tuple[Reference, ...] = ("held", "straight", "smooth")
_COMPARED = ("theta_m_rad", "current_A", "tau_m_N_m", "theta_j_rad", "tau_w_N_m")


class Beside(NamedTuple):
    """Measured and simulated channels over one time axis, by column name; errors are simulated less measured."""

    name: str
    is_closed_loop: bool
    time_s: Column
    measured: dict[str, Column]
    simulated: dict[str, Column]
    notes: tuple[str, ...]

    def rmse(self, channel: str) -> float:
        """Root mean square of the error, NaN-free; the simulation's unit is the column's."""
        return float(np.sqrt(np.mean(np.square(self.simulated[channel] - self.measured[channel]))))

    def scatter(self, channel: str) -> float:
        """The same with the mean error taken out: what is left when a sensor's zero is unknown."""
        return float(np.std(self.simulated[channel] - self.measured[channel]))


def simulate_beside(run: Run, rig: Rig) -> Beside:
    """Simulate `run` with `rig`: in closed loop when the rig has a drive and the run a reference, else driven.

    Rows are put on an even time axis first (linear in between). A load that was not measured is taken as none in
    closed loop. UserError when the plant is not known, or the run lacks what the simulation needs.
    """
    theta = vector(rig)
    law = rig.drive
    if law is not None and "theta_m_ref_rad" in run.columns:
        return _closed(run, rig, law, theta)
    return _driven(run, theta, "the rig has no drive" if law is None else "theta_m_ref_rad was not recorded")


def _even(run: Run, interval_s: float) -> tuple[dict[str, Column], list[str]]:
    """Return the columns at even times, and notes on what that took."""
    time_s = run.columns["time_s"]
    count = round(float(time_s[-1] - time_s[0]) / interval_s) + 1
    even = time_s[0] + interval_s * np.arange(count)
    notes = []
    missing = float(np.max(np.diff(time_s))) / interval_s
    if missing > GAP_IN_INTERVALS:
        notes.append(f"gaps are interpolated linearly; the longest is {missing * interval_s:.4g} s")
    if count == len(time_s) and np.max(np.abs(even - time_s)) < 1e-3 * interval_s:
        return {**run.columns, "time_s": even}, notes
    others = {name: np.interp(even, time_s, values) for name, values in run.columns.items() if name != "time_s"}
    return {"time_s": even, **others}, notes


def _closed(run: Run, rig: Rig, law: DriveLaw, theta: Column) -> Beside:
    usual = (run.columns["time_s"][-1] - run.columns["time_s"][0]) / (len(run) - 1)
    ratio = run.sample_time_s / law.sample_time_s
    samples = max(round(ratio), 1)
    interval_s = law.sample_time_s * samples
    if ratio > 1.0 and abs(ratio - samples) > WHOLE_MULTIPLE * samples:
        told = f"rows are {run.sample_time_s:.6g} s apart, no whole multiple of the drive's {law.sample_time_s:.6g} s"
        raise UserError(f"run {run.name}: {told}; correct drive.sample_time_s, or remove `drive` from the rig")
    # An instrument's clock is off by some ppm: an even axis at the run's own pace, unless rows are missing.
    own = float(usual) if abs(float(usual) / interval_s - 1.0) < WHOLE_MULTIPLE else interval_s
    columns, notes = _even(run, own)
    rows = len(columns["time_s"])
    load = columns.get("tau_w_N_m", np.zeros(rows))
    if "tau_w_N_m" not in columns:
        notes.append("tau_w_N_m was not measured: simulated without load")
    nothing = (np.empty(0, np.int64), np.empty(0))
    inputs = closed_loop.Inputs(columns["time_s"], columns["theta_m_ref_rad"], load, *nothing)
    numbers = law_vector(law)
    start = _start(columns, theta, law_vector(law.model_copy(update={"sample_time_s": interval_s})), law)
    quantum = rig.encoder.quantum_rad
    courses = {r: between_rows(inputs.reference_rad, samples, r) for r in REFERENCES[: None if samples > 1 else 1]}
    outs = {
        name: closed_loop.simulate(
            theta, numbers, quantum, inputs._replace(reference_rad=course), start, SUBSTEPS * samples, samples
        )
        for name, course in courses.items()
    }
    best = min(outs, key=lambda name: float(np.std(outs[name].theta_m_rad - columns["theta_m_rad"])))
    out = outs[best]
    if best != "held":
        notes.append(f"between rows the reference is interpolated ({best}): held until the next row, it fits worse")
    constant = rig.plant().torque_constant_N_m_per_A
    simulated = {
        "theta_m_rad": out.theta_m_rad,
        "current_A": out.current_A,
        "tau_m_N_m": constant * out.current_A,
        "theta_j_rad": out.theta_j_rad,
    }
    return _result(run, True, columns, simulated, notes)


def _start(columns: dict[str, Column], theta: Column, row_law: Column, law: DriveLaw) -> closed_loop.Start:
    """Return the state at the first row: as measured where it was, the wire in balance with the load."""
    jaw_radius = float(theta[index("forceps.jaw_pulley_radius_m")])
    load = float(columns["tau_w_N_m"][0]) if "tau_w_N_m" in columns else 0.0
    angle = columns["theta_m_rad"]
    current = float(columns["current_A"][0]) if "current_A" in columns else 0.0
    start = closed_loop.rest(theta, float(angle[0]), load / jaw_radius, current)
    rows = min(20, len(angle))  # that tell speed and integral at the first of them
    speed = float(np.polyfit(columns["time_s"][:rows] - columns["time_s"][0], angle[:rows], 1)[0])
    ratio = float(theta[index("forceps.motor_pulley_radius_m")]) / jaw_radius
    plant = start.plant._replace(omega_m_rad_per_s=speed, omega_j_rad_per_s=speed * ratio)
    drive = DriveState(0.0, float(angle[0]), speed, current)
    if "current_A" in columns and law.ki_A_per_rad_s > 0.0:
        # What the law lacks of the first currents stands in its integral.
        wanted = law_current(row_law, columns["theta_m_ref_rad"][: rows - 1], angle[: rows - 1], drive)
        lacking = float(np.mean(columns["current_A"][1:rows] - wanted))
        limit = law.current_limit_A
        drive = drive._replace(integral_rad_s=max(-limit, min(limit, lacking)) / law.ki_A_per_rad_s)
    return closed_loop.Start(plant, drive)


def _driven(run: Run, theta: Column, why: str) -> Beside:
    interval_s = float(run.columns["time_s"][-1] - run.columns["time_s"][0]) / (len(run) - 1)
    columns, notes = _even(run, interval_s)
    load, jaw = columns.get("tau_w_N_m"), columns.get("theta_j_rad")
    if load is None and jaw is None:
        load = np.zeros(len(columns["time_s"]))
        notes.append("neither tau_w_N_m nor theta_j_rad was measured: simulated without load")
    inputs = driven.Inputs(columns["time_s"], columns["theta_m_rad"], load, jaw)
    out = driven.simulate(theta, inputs)
    simulated = {"current_A": out.current_A, "tau_m_N_m": out.motor_torque_N_m}
    if load is not None:
        simulated["theta_j_rad"] = out.theta_j_rad
    else:
        simulated["tau_w_N_m"] = out.tau_w_N_m
    return _result(run, False, columns, simulated, [f"{why}: the measured motion drives the simulation", *notes])


def _result(
    run: Run, is_closed: bool, columns: dict[str, Column], simulated: dict[str, Column], notes: list[str]
) -> Beside:
    compared = [name for name in _COMPARED if name in simulated and name in columns]
    for name in compared:
        if not np.all(np.isfinite(simulated[name])):
            raise UserError(f"run {run.name}: the simulation diverges in {name}; check the rig's values and its drive")
    measured = {name: columns[name] for name in compared}
    return Beside(
        run.name, is_closed, columns["time_s"], measured, {name: simulated[name] for name in compared}, tuple(notes)
    )


def between_rows(values: Column, samples: int, reference: Reference) -> Column:
    """Return a reference, or an angle, at each sample of the drive, from that of rows; the last row's is held."""
    if samples == 1:
        return values
    if reference == "held":
        return np.repeat(values, samples)
    rows = np.arange(values.size)
    at = np.minimum(np.arange(values.size * samples) / samples, rows[-1])
    return np.asarray(np.interp(at, rows, values) if reference == "straight" else CubicSpline(rows, values)(at))
