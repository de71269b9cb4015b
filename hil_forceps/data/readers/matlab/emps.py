"""Reader for EMPS, an electro-mechanical positioning system measured by Janot, Gautier and Brunot.

The data are others' (nonlinearbenchmark.org); `DATA_EMPS.mat` and `DATA_EMPS_PULSES.mat` as published: `qm` position
[m], `qg` reference [m], `vir` control signal [V], `gtau` force per volt, `t` time, `kp` and `kv` gains of the loop.

The axis is linear and a run is rotary: it is written at a radius of 5 mm. An angle is the path over that radius and a
torque the force times it, which is of the size of a small screw's and within the ranges of a rig. Nothing but the axis
itself is moved, so the load on it is known: none.
"""

from collections.abc import Collection
from pathlib import Path

import numpy as np

from hil_forceps.data.run import Column, Run, bad_row
from hil_forceps.data.time_order import drop_repeats
from hil_forceps.rig.errors import UserError

SERIES = ("t", "qm", "qg", "vir")
RADIUS_M = 5.0e-3
SCALARS = ("gtau", "kp", "kv")
MIN_KNOWN_NAMES = 5  # of these seven: then a file is of EMPS, and what lacks is told


def is_emps(names: Collection[str]) -> bool:
    """Tell by its variables whether a file is one of EMPS, whole or not."""
    return sum(name in names for name in (*SERIES, *SCALARS)) >= MIN_KNOWN_NAMES


def to_run(path: Path, found: dict[str, Column]) -> Run:
    """Make the run: θ_m and its reference are path over `RADIUS_M`, τ_m is the force times that radius, τ_w is 0.

    Raises UserError when a variable of EMPS is missing or of another size.
    """
    variables = _checked(path, {name: values.reshape(-1, order="F") for name, values in found.items()})
    columns = {
        "time_s": variables["t"],
        "theta_m_ref_rad": variables["qg"] / RADIUS_M,
        "theta_m_rad": variables["qm"] / RADIUS_M,
        "tau_m_N_m": RADIUS_M * variables["gtau"] * variables["vir"],
        "tau_w_N_m": np.zeros(len(variables["t"])),
    }
    columns, more = drop_repeats(columns, str(path), lambda row: f"{path}: sample {row + 1}")
    notes = (
        f"linear axis, written at a radius of {RADIUS_M * 1e3:g} mm: angles are path over it, torques force times it",
        "nothing but the axis itself is moved: tau_w_N_m is 0",
        f"force is vir times gtau, {variables['gtau'][0]:.9g} N/V",
        f"gains of its position and velocity loop: kp {variables['kp'][0]:g} 1/s, kv {variables['kv'][0]:g} V s/m",
    )
    return Run(path.stem, columns, (*notes, *more))


def _checked(path: Path, variables: dict[str, Column]) -> dict[str, Column]:
    found = {name: variables[name] for name in (*SERIES, *SCALARS) if name in variables}
    missing = [name for name in (*SERIES, *SCALARS) if name not in found]
    if missing:
        told = f"the numbers {', '.join(missing)} are missing"
        raise UserError(f"{path}: not an EMPS file: {told}; download it again")
    for name, values in found.items():
        if name in SCALARS and len(values) != 1:
            raise UserError(f"{path}: {name} is not a single number, so this is not an EMPS file")
        row = bad_row(values, increasing=False)
        if row is not None:
            raise UserError(f"{path}: {name}: sample {row + 1} is not a finite number")
    _check_lengths(path, found)
    return found


def _check_lengths(path: Path, variables: dict[str, Column]) -> None:
    lengths = {name: len(variables[name]) for name in SERIES}
    if len(set(lengths.values())) > 1 or lengths["t"] < 2:
        told = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise UserError(f"{path}: samples: {told}; each must have the same number, at least 2")
