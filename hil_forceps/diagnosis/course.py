"""What a run went through inside, as the model simulates it."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]


class Course(NamedTuple):
    """What a run went through, as the model simulates it."""

    theta_m: Vector
    omega_m: Vector
    theta_j: Vector
    omega_j: Vector
    stretch_m: Vector
    tension_N: Vector
    load_N_m: Vector
    current_A: Vector
    time_s: Vector
    period_s: float
