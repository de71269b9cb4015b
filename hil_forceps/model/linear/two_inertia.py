"""The paper's plant as a linear system: motor pulley and jaw, joined by an elastic wire.

State (4): θ_m [rad], ω_m [rad/s], θ_j [rad], ω_j [rad/s].
Inputs (2): net motor torque τ_m − τ_Fm − τ_int [N m]; load on the jaw τ_w + τ_Fj [N m].
Coulomb friction is an input here, because its sign isn't linear; τ_int is taken as zero (the paper gives no value).
"""

import math

import numpy as np
from numpy.typing import NDArray

from hil_forceps.model.kernel import kernel, returning_arrays, subroutine
from hil_forceps.rig.plant import PlantParameters

Matrix = NDArray[np.float64]

# For an argument with a norm of 1/2 the first omitted term is below 2**-54 of the result.
_TAYLOR_TERMS = 14
_MAX_TAYLOR_NORM = 0.5


def continuous(plant: PlantParameters) -> tuple[Matrix, Matrix]:
    """Return A (4×4) and B (4×2) of ẋ = A x + B u, from (1), (2), (3)."""
    r_m, r_j = plant.motor_pulley_radius_m, plant.jaw_pulley_radius_m
    I_m, I_j = plant.motor_inertia_kg_m2, plant.jaw_inertia_kg_m2
    k, D_m = plant.wire_stiffness_N_per_m, plant.motor_viscous_N_m_s_per_rad
    a = np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [-k * r_m * r_m / I_m, -D_m / I_m, k * r_m * r_j / I_m, 0.0],
            [0.0, 0.0, 0.0, 1.0],
            [k * r_m * r_j / I_j, 0.0, -k * r_j * r_j / I_j, 0.0],
        ]
    )
    b = np.array([[0.0, 0.0], [1.0 / I_m, 0.0], [0.0, 0.0], [0.0, -1.0 / I_j]])
    return a, b


@returning_arrays
def multiply(left: Matrix, right: Matrix) -> Matrix:
    """Return the product of two small matrices (plain loops: no BLAS call, the same bits everywhere)."""
    rows, inner, columns = left.shape[0], left.shape[1], right.shape[1]
    product = np.zeros((rows, columns))
    for i in range(rows):
        for m in range(inner):
            factor = left[i, m]
            if factor != 0.0:
                for j in range(columns):
                    product[i, j] += factor * right[m, j]
    return product


@subroutine
def halvings(matrix: Matrix) -> int:
    """Return how often to halve `matrix` so that `taylor_exponential` is exact to rounding (0 if it isn't finite)."""
    norm = 0.0
    for i in range(matrix.shape[0]):
        row = 0.0
        for j in range(matrix.shape[1]):
            row += abs(matrix[i, j])
        norm = max(norm, row)
    count = 0
    while norm > _MAX_TAYLOR_NORM and norm < math.inf:
        norm *= 0.5
        count += 1
    return count


@returning_arrays
def taylor_exponential(matrix: Matrix) -> Matrix:
    """Return exp(matrix) for a matrix whose norm is at most 1/2 (Horner form of the Taylor series)."""
    n = matrix.shape[0]
    total = np.eye(n)
    for term in range(_TAYLOR_TERMS, 0, -1):
        total = multiply(matrix, total)
        for i in range(n):
            for j in range(n):
                total[i, j] /= term
            total[i, i] += 1.0
    return total


@kernel
def expm(matrix: Matrix) -> Matrix:
    """Return the exponential of a square matrix by scaling and squaring.

    Accurate to about 1e-13 of the norm of the result when rows and columns are of like magnitude (balance first);
    NaN in, NaN out.
    """
    count = halvings(matrix)
    result = taylor_exponential(matrix * 0.5**count)
    for _ in range(count):
        result = multiply(result, result)
    return result


def discretise(plant: PlantParameters, dt_s: float) -> tuple[Matrix, Matrix]:
    """Return Φ (4×4) and Γ (4×2) of x⁺ = Φ x + Γ u, exact for inputs held over `dt_s`.

    Raise ValueError when `dt_s` is negative or not finite.
    """
    if not (math.isfinite(dt_s) and dt_s >= 0.0):
        raise ValueError(f"dt_s must be finite and not negative, got {dt_s!r}")
    a, b = continuous(plant)
    # In units of the wire mode's radian all entries are near 1; raw SI entries span fourteen decades.
    mode = wire_mode_rad_per_s(plant)
    state_units = np.array([1.0, mode, 1.0, mode])
    input_units = np.array([mode * mode * plant.motor_inertia_kg_m2, mode * mode * plant.jaw_inertia_kg_m2])
    units = np.concatenate((state_units, input_units))
    joint = np.zeros((6, 6))
    joint[:4, :4] = a
    joint[:4, 4:] = b
    exponential = expm(joint * dt_s / units[:, None] * units[None, :])
    exponential = exponential * units[:, None] / units[None, :]
    return exponential[:4, :4].copy(), exponential[:4, 4:].copy()


def wire_mode_rad_per_s(plant: PlantParameters) -> float:
    """Return √A, the undamped angular frequency of the wire: left side of (6)."""
    return math.sqrt(wire_mode_squared(plant))


def wire_mode_squared(plant: PlantParameters) -> float:
    """Return A = k (r_m²/I_m + r_j²/I_j) [1/s²] of (9) and (13)."""
    return plant.wire_stiffness_N_per_m * (
        plant.motor_pulley_radius_m**2 / plant.motor_inertia_kg_m2
        + plant.jaw_pulley_radius_m**2 / plant.jaw_inertia_kg_m2
    )


def total_inertia_kg_m2(plant: PlantParameters) -> float:
    """Return I = I_m + (r_m²/r_j²) I_j of (5): inertia at the motor with a rigid wire."""
    ratio = plant.motor_pulley_radius_m / plant.jaw_pulley_radius_m
    return plant.motor_inertia_kg_m2 + ratio * ratio * plant.jaw_inertia_kg_m2


def poles_per_s(plant: PlantParameters) -> NDArray[np.complex128]:
    """Return the four poles of the plant [1/s], fastest first."""
    poles = np.linalg.eigvals(continuous(plant)[0]).astype(np.complex128)
    return poles[np.argsort(-np.abs(poles), kind="stable")]


def steady_elongation_m(plant: PlantParameters, tau_w_N_m: float) -> float:
    """Return the wire's stretch when the jaw holds `tau_w_N_m` at rest: (2) with nothing moving."""
    return tau_w_N_m / (plant.jaw_pulley_radius_m * plant.wire_stiffness_N_per_m)


def steady_jaw_error_rad(plant: PlantParameters, tau_w_N_m: float) -> float:
    """Return the jaw's error (negative: it lags) when it holds `tau_w_N_m` without compensation: (3)."""
    return -steady_elongation_m(plant, tau_w_N_m) / plant.jaw_pulley_radius_m


def steady_current_A(plant: PlantParameters, tau_w_N_m: float) -> float:
    """Return the motor current that holds `tau_w_N_m` at rest without friction: (1) with nothing moving."""
    ratio = plant.motor_pulley_radius_m / plant.jaw_pulley_radius_m
    return ratio * tau_w_N_m / plant.torque_constant_N_m_per_A
