"""Reader for EMPS, an electro-mechanical positioning system measured by Janot, Gautier and Brunot.

The data are others' (nonlinearbenchmark.org); `DATA_EMPS.mat` and `DATA_EMPS_PULSES.mat` as published: `qm` position
[m], `qg` reference [m], `vir` control signal [V], `gtau` force per volt, `t` time, `kp` and `kv` gains of the loop.

The axis is linear and a run is rotary. At a radius of exactly 1 m an angle in rad is the path in m and a torque in
N m the force in N, so the numbers stay what was measured and every equation of a motor's balance holds unchanged.
"""

from pathlib import Path

from hil_forceps.rig.errors import UserError
from hil_forceps.runs.mat_file import parse_mat
from hil_forceps.runs.table import Column, Run, bad_row
from hil_forceps.runs.time_order import drop_repeats

MAX_FILE_BYTES = 64 << 20  # a file as published has 0.7 MB
SERIES = ("t", "qm", "qg", "vir")
SCALARS = ("gtau", "kp", "kv")


def read_emps(path: str | Path) -> Run:
    """Read one file: θ_m and its reference are path over a radius of 1 m, τ_m is the force times that radius.

    Raises UserError when the file can't be read, is none of MATLAB's, or lacks a variable of EMPS.
    """
    path = Path(path)
    variables = _load(path)
    columns = {
        "time_s": variables["t"],
        "theta_m_ref_rad": variables["qg"],
        "theta_m_rad": variables["qm"],
        "tau_m_N_m": variables["gtau"] * variables["vir"],
    }
    columns, more = drop_repeats(columns, str(path), lambda row: f"{path}: sample {row + 1}")
    notes = (
        "linear axis, written at a radius of 1 m: 1 rad is 1 m of path, 1 N m is 1 N of force",
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
