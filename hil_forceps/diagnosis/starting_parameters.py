"""Parameters that the first fit begins with: the rig's, but for two kinds of runs.

Where a drive counts between rows, the counts hang on them. With a torque constant or a friction that is some tenths
off, no course of counts fits the currents. Which references a drive follows is told wrongly then, and the fit ends in a
wrong minimum. A fit driven by the motion needs neither counts nor references. What moves slowly tells friction, torque
constant and wire; inertias don't show there.

Where no load cell tells the jaw's dry friction from a load, the friction is in the load, and the plant has none.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil_forceps.data.even_rows import EvenRun
from hil_forceps.diagnosis.driven.identification import fit_driven
from hil_forceps.diagnosis.preparation.command import samples_in_a_row
from hil_forceps.model import parameters
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError

Vector = NDArray[np.float64]

_JAW_FRICTION = "forceps.jaw_coulomb_N_m"
_BY_TORQUE = (
    "forceps.motor_viscous_N_m_s_per_rad",
    "forceps.motor_coulomb_N_m",
    _JAW_FRICTION,
    "motor.torque_constant_N_m_per_A",
)
_BY_JAW = ("forceps.jaw_pulley_radius_m", "forceps.wire_stiffness_N_per_m")  # if a sensor shows its angle


def starting_parameters(runs: Sequence[EvenRun], rig: Rig) -> Vector:
    """Return the parameters that the first fit begins with."""
    return with_friction_in_the_load(_as_slow_motion_tells(runs, rig), runs)


def _as_slow_motion_tells(runs: Sequence[EvenRun], rig: Rig) -> Vector:
    """Return the rig's parameters; those that slow motion tells by a fit to it, if the drive samples between rows."""
    theta = parameters.vector(rig)
    if all(samples_in_a_row(even.run, rig) <= 1 for even in runs):
        return theta
    try:
        found, _ = fit_driven([even.run for even in runs], rig)
    except UserError:  # too little motion
        return theta
    jaw_measured = all("theta_j_rad" in even.run.columns for even in runs)
    shown = _BY_TORQUE + (_BY_JAW if jaw_measured else ())
    for free, value in zip(found.free, found.values, strict=True):
        if free.name in shown:
            theta[free.place] = value
    return theta


def with_friction_in_the_load(theta: Vector, runs: Sequence[EvenRun]) -> Vector:
    """Return parameters without dry friction of the jaw where no run has a load cell: a load does all that it does."""
    loads = [even.run.columns["tau_w_N_m"] for even in runs if "tau_w_N_m" in even.run.columns]
    if any(np.isfinite(load).any() for load in loads):
        return theta
    changed = theta.copy()
    changed[parameters.index(_JAW_FRICTION)] = 0.0
    return changed
