"""Starting values where a rig says little: ratio, stiffness, friction and K_t by least squares, before any simulation.

    θ_j = (r_m/r_j) θ_m − τ_w/(k r_j²) − F sgn ω + zero
    τ_m = I α + D ω + C sgn ω + (r_m/r_j) τ_w + zero

One zero for all runs: what differs between runs, the level of the load above all, tells most.
Only for the fit to begin near its end: nothing of it is reported.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.driven.rows import DrivenRows, angle_balance
from hil_forceps.diagnosis.inference.parameters import known
from hil_forceps.model import parameters
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

WIDEST_SD = 10.0  # of the starting value
NARROWEST_SD = 0.5

R_M, R_J = "forceps.motor_pulley_radius_m", "forceps.jaw_pulley_radius_m"
K_T = "motor.torque_constant_N_m_per_A"


class Guess(NamedTuple):
    """What the balances say; NaN where they don't."""

    ratio: float
    give_rad_per_N_m: float  # 1/(k r_j²)
    inertia: float
    viscous: float
    coulomb: float
    lever: float  # motor torque (or current) over the load's


def completed(records: Sequence[DrivenRows], rig: Rig) -> Rig:
    """Return the rig with a starting value for all that it doesn't know; UserError where nothing bounds it."""
    names = [name for name in parameters.PLANT_NAMES if known(rig, name).value is None]
    if not names:
        return rig
    if unbounded := [name for name in names if known(rig, name).minimum is None]:
        raise UserError([f"{n}: has neither a value nor bounds; give {{min, max}}" for n in unbounded])
    values = {name: _value(rig, name) for name in parameters.PLANT_NAMES}
    values |= {name: value for name, value in _guessed(guess(records), rig, records).items() if name in names}
    changes: dict[str, object] = {}
    for name in names:
        bounds = known(rig, name)
        low, high = float(bounds.minimum or 0.0), float(bounds.maximum or 0.0)
        value = min(max(values[name], low), high)
        sd = min(max((high - low) / math.sqrt(12.0), NARROWEST_SD * value), WIDEST_SD * value)
        changes[name] = {"value": value, "sd": sd, "min": low, "max": high}
    return rig.with_changes(changes)


def guess(records: Sequence[DrivenRows]) -> Guess:
    """Return what least squares on the balances say."""
    columns, jaw = angle_balance(records)
    angles = _least_squares(columns, jaw)[:2] if jaw.size else (math.nan, math.nan)
    return Guess(*map(float, (*angles, *_least_squares(*_torque_balance(records)))))


def _value(rig: Rig, name: str) -> float:
    """Return a parameter's value, or the middle of its bounds in powers of ten."""
    told = known(rig, name)
    if told.value is not None:
        return told.value
    low, high = float(told.minimum or 0.0), float(told.maximum or 0.0)
    return math.sqrt(low * high) if low > 0.0 else 0.1 * high


def _guessed(found: Guess, rig: Rig, records: Sequence[DrivenRows]) -> dict[str, float]:
    """Return the plant's values that the balances tell, given those that are known."""
    known_r_m = known(rig, R_M).value
    r_j = _value(rig, R_J)
    if known_r_m is not None and known(rig, R_J).value is None and found.ratio > 0.0:
        r_j = known_r_m / found.ratio
    values = {R_J: r_j}
    if found.ratio > 0.0:
        values[R_M] = found.ratio * r_j
    if found.give_rad_per_N_m > 0.0:
        values["forceps.wire_stiffness_N_per_m"] = 1.0 / (found.give_rad_per_N_m * r_j * r_j)
    constant = 1.0
    if records[0].torque_channel == "current_A":
        constant = _value(rig, K_T)
        if known(rig, K_T).value is None and found.lever > 0.0 and found.ratio > 0.0:
            constant = found.ratio / found.lever
            values[K_T] = constant
    told = {
        "forceps.motor_inertia_kg_m2": found.inertia,
        "forceps.motor_viscous_N_m_s_per_rad": found.viscous,
        "forceps.motor_coulomb_N_m": found.coulomb,
    }
    values |= {name: constant * value for name, value in told.items() if value > 0.0}
    return values


def _torque_balance(records: Sequence[DrivenRows]) -> tuple[Matrix, Vector]:
    """Return α, ω, sgn ω and τ_w (n × 4) and the motor's torque or current (n) of all rows that count."""
    rows, right = [], []
    for record in records:
        omega = np.gradient(record.rows.reference_rad, record.rows.period_s)
        alpha = np.gradient(omega, record.rows.period_s)
        load = record.rows.tau_w_N_m if record.rows.tau_w_N_m is not None else np.zeros(omega.size)
        columns = np.column_stack((alpha, omega, np.sign(omega), load))
        here = record.rows.weights > 0.0
        rows.append(columns[here])
        right.append(record.rows.channels[record.torque_channel][here])
    return np.concatenate(rows), np.concatenate(right)


def _least_squares(columns: Matrix, right: Vector) -> Vector:
    """Solve with one zero of all runs and columns scaled to one; NaN for a column that is constant.

    Levels of load that differ from run to run tell more than what varies within.
    """
    centred = columns - columns.mean(axis=0)
    norms = np.sqrt(np.sum(centred**2, axis=0))
    good = norms > 1e-12 * max(float(norms.max(initial=0.0)), 1e-30)
    found = np.full(columns.shape[1], math.nan)
    scaled = centred[:, good] / norms[good]
    found[good] = np.linalg.lstsq(scaled, right - right.mean(), rcond=1e-8)[0] / norms[good]
    return found
