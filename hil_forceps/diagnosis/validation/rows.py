"""Rows of a run as validation, figures and estimates take them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.data.even_rows import MIN_ROWS
from hil_forceps.rig.errors import UserError

Vector = NDArray[np.float64]


class Rows(NamedTuple):
    """A run on equally spaced rows; n each."""

    name: str
    period_s: float
    time_s: Vector
    reference_rad: Vector  # what the motor follows; of a driven run its angle as measured
    channels: dict[str, Vector]  # that are compared
    tau_w_N_m: Vector | None  # the load's course
    weights: Vector  # 1 where a row counts, else 0
    driven: bool = False  # by the motion as measured


def require_rows(name: str, rows: int) -> None:
    """UserError where a run has too few rows to be diagnosed."""
    if rows < MIN_ROWS:
        raise UserError(f"{name}: {rows} rows are too few to diagnose; at least {MIN_ROWS} are needed")
