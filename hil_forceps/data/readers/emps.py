"""Reader for EMPS, an electro-mechanical positioning system measured by Janot, Gautier and Brunot.

The data are others' (nonlinearbenchmark.org); `DATA_EMPS.mat` and `DATA_EMPS_PULSES.mat` as published: `qm` position
[m], `qg` reference [m], `vir` control signal [V], `gtau` force per volt, `t` time, `kp` and `kv` gains of the loop.

The axis is linear and a run is rotary: it is written at a radius of 5 mm. An angle is the path over that radius and a
torque the force times it, which is of the size of a small screw's and within the ranges of a rig. Nothing but the axis
itself is moved, so the load on it is known: none.
"""

from pathlib import Path

import numpy as np

from hil_forceps.data.readers.format import Format
from hil_forceps.data.readers.mat_file import parse_mat
from hil_forceps.data.run import Column, Run, bad_row
from hil_forceps.data.time_order import drop_repeats
from hil_forceps.rig.errors import UserError

MAX_FILE_BYTES = 64 << 20  # a file as published has 0.7 MB
SERIES = ("t", "qm", "qg", "vir")
RADIUS_M = 5.0e-3
SCALARS = ("gtau", "kp", "kv")


def read_emps(path: str | Path) -> Run:
    """Read one file: θ_m and its reference are path over `RADIUS_M`, τ_m is the force times that radius, τ_w is 0.

    Raises UserError when the file can't be read, is none of MATLAB's, or lacks a variable of EMPS.
    """
    path = Path(path)
    variables = _load(path)
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


def _load(path: Path) -> dict[str, Column]:
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise UserError(f"{path}: larger than {MAX_FILE_BYTES >> 20} MiB; not a file of EMPS")
        found = parse_mat(path.read_bytes(), frozenset((*SERIES, *SCALARS)))
    except OSError as error:
        raise UserError(f"{path}: {error.strerror or error}") from error
    except ValueError as error:
        raise UserError(f"{path}: not a sound MATLAB file of version 5 to 7: {error}; get it again") from error
    missing = [name for name in (*SERIES, *SCALARS) if name not in found]
    if missing:
        told = f"no numbers {', '.join(missing)} in it"
        raise UserError(f"{path}: not a file of EMPS: {told}; save a run of your own as CSV")
    for name, values in found.items():
        if name in SCALARS and len(values) != 1:
            raise UserError(f"{path}: {name} is no single number: not a file of EMPS")
        row = bad_row(values, increasing=False)
        if row is not None:
            raise UserError(f"{path}: {name}: sample {row + 1} is not a finite number")
    _check_lengths(path, found)
    return found


def _check_lengths(path: Path, variables: dict[str, Column]) -> None:
    lengths = {name: len(variables[name]) for name in SERIES}
    if len(set(lengths.values())) > 1 or lengths["t"] < 2:
        told = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise UserError(f"{path}: samples: {told}; they must be as many of each, and 2 at least")


FORMAT = Format("MATLAB 5", (".mat",), lambda request: [read_emps(request.path)], magic=(b"MATLAB 5.0 MAT-file",))
