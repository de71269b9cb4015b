"""What the model says that was measured where the measured motion drives it.

Motor torque (or current) is predicted and, where the load was measured, the jaw's angle; without the load the measured
jaw angle drives the simulation, too.

The noise of what drives is in the residual, so whatever depends on how the model answers to it would depend on the
residual: counting alone made a jaw's inertia come out at an eighth. So the motion without its noise drives, and what
the noise does besides is an offset, taken anew with each better model.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from hil_forceps.diagnosis.course import Course
from hil_forceps.diagnosis.driven.rows import DrivenRows, still_rad_per_s
from hil_forceps.model import driven
from hil_forceps.model.composition import Physics
from hil_forceps.model.driven import Inputs
from hil_forceps.model.smoothing import Smooth, smooth

Vector = NDArray[np.float64]

BANDWIDTH_SHARE = 0.45  # of the frequency of steps: rows are smoothed already, this only differentiates
LONGEST_STEP_S = 0.51e-3  # the jaw's inertia comes half a step late
MOST_STEPS = 100_000  # of all runs together; steps are longer beyond


class DrivenModel(NamedTuple):
    """A run ready to be simulated, on a grid of steps."""

    rows: DrivenRows
    substeps: int  # of a row
    measured: Inputs
    smoothed: Inputs  # the same without noise
    motion: Smooth  # of the motor without noise, as an encoder without error shows it

    def simulated(self, theta: Vector, *, smoothed: bool) -> driven.Channels:
        """Return what the model says at each row; sensors' zeros are none of its."""
        rows = self.rows.rows
        bandwidth = BANDWIDTH_SHARE * self.substeps / rows.period_s
        still = still_rad_per_s(rows.reference_rad, rows.period_s)
        given, motion = (self.smoothed, self.motion) if smoothed else (self.measured, None)
        fine = driven.simulate(theta, given, bandwidth_Hz=bandwidth, still_rad_per_s=still, motion=motion)
        return driven.Channels(*(values[:: self.substeps] for values in fine))

    def channels(self, shown: driven.Channels) -> dict[str, Vector]:
        """Return the channels that are compared."""
        names = {"tau_m_N_m": shown.motor_torque_N_m, "current_A": shown.current_A, "theta_j_rad": shown.theta_j_rad}
        return {name: names[name] for name in self.rows.rows.channels}

    def course(self, shown: driven.Channels) -> Course:
        """Return what the run went through, without noise."""
        rows, smoothed = self.rows.rows, self.rows.smoothed
        load = smoothed.tau_w_N_m if smoothed.tau_w_N_m is not None else np.zeros(rows.time_s.size)
        return Course(
            smoothed.motor_rad,
            np.gradient(smoothed.motor_rad, rows.period_s),
            shown.theta_j_rad,
            np.gradient(shown.theta_j_rad, rows.period_s),
            shown.elongation_m,
            shown.tension_N,
            load,
            shown.current_A,
            rows.time_s,
            rows.period_s,
        )

    def static_answer(self, p: Physics, place: str, unit: Vector) -> dict[str, Vector]:
        """Return what a torque [N m] or a wire's force [N] that helps, or an error of a sensor, does to the channels.

        As at rest: with the motor held to its motion the wire's mode lies far above what is compared.
        """
        channel = self.rows.torque_channel
        per_N_m = 1.0 if channel == "tau_m_N_m" else 1.0 / p.K_t
        known_load = self.rows.theta_j_rad is None
        found: dict[str, Vector] = {}
        if place == "motor":
            found = {channel: -per_N_m * unit}
        elif place == "wire":
            found = {"theta_j_rad": unit / (p.k * p.r_j)} if known_load else {channel: p.r_m * per_N_m * unit}
        elif place == "jaw" and known_load:
            found = {channel: -p.r_m / p.r_j * per_N_m * unit, "theta_j_rad": unit / (p.k * p.r_j**2)}
        elif place == "theta_m_rad":
            turned = -p.r_m / p.r_j * unit
            found = {"theta_j_rad": turned} if known_load else {channel: -p.k * p.r_m**2 * per_N_m * unit}
        elif place == "theta_j_rad" and not known_load:
            found = {channel: p.k * p.r_m * p.r_j * per_N_m * unit}
        elif place in self.rows.rows.channels:
            found = {place: unit}
        return found


def driven_models(runs: Sequence[DrivenRows]) -> list[DrivenModel]:
    """Return runs ready to be simulated: steps fine enough between rows, their motion by cubic splines."""
    count = sum(run.rows.time_s.size for run in runs)
    wanted = max(int(np.ceil(run.rows.period_s / LONGEST_STEP_S)) for run in runs)
    substeps = max(1, min(wanted, MOST_STEPS // count))
    found = []
    for run in runs:
        rows, without = run.rows, run.smoothed
        given = (
            (rows.reference_rad, rows.tau_w_N_m, run.theta_j_rad),
            (without.motor_rad, without.tau_w_N_m, without.theta_j_rad),
        )
        measured, smoothed = (_inputs(rows.time_s, rows.period_s, substeps, *columns) for columns in given)
        step_s = rows.period_s / substeps
        motion = smooth(smoothed.theta_m_rad, step_s, BANDWIDTH_SHARE / step_s)
        found.append(DrivenModel(run, substeps, measured, smoothed, motion))
    return found


def _inputs(
    time_s: Vector, period_s: float, substeps: int, motor: Vector, load: Vector | None, jaw: Vector | None
) -> Inputs:
    fine = np.arange((time_s.size - 1) * substeps + 1, dtype=np.float64) * (period_s / substeps)

    def between(values: Vector | None) -> Vector | None:
        return None if values is None else np.asarray(CubicSpline(time_s, values)(fine))

    return Inputs(fine, np.asarray(CubicSpline(time_s, motor)(fine)), between(load), between(jaw))
