"""An estimator in the closed loop without a bus: our own plant, the drive's law and (10), in one compiled loop.

At each sample the drive latches encoder and current, and runs its law with the reference that it has. The estimator
gets the sample, and the reference computed from it arrives before the next sample. A bus that delivers in time would
only add the rounding of the protocol, which is `over_wire`.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.estimation.interface import ELONGATION, TAU_W, Estimator
from hil_forceps.estimation.kernel import kernel
from hil_forceps.estimation.kernel_function import KernelFunction
from hil_forceps.estimation.wire import WIRE_ANGLE_RAD, WIRE_CURRENT_A
from hil_forceps.model.linear_loop import (
    DRIVE_CURRENT,
    DriveParameters,
    Loop,
    drive_step,
    interval,
    make_loop,
    quantise,
)
from hil_forceps.rig.plant import PlantParameters
from hil_forceps.rig.schema import Rig

Vector = NDArray[np.float64]
_COLUMNS = 8


class DirectRun(NamedTuple):
    """A run of the loop, one entry per sample; states at the sample's instant."""

    time_s: Vector
    theta_m_rad: Vector  # as the estimator got it
    current_A: Vector  # as the estimator got it
    theta_j_rad: Vector
    elongation_m: Vector
    tau_w_N_m: Vector
    tau_w_estimate_N_m: Vector
    elongation_estimate_m: Vector


@kernel
def _run(
    loop: Loop,
    plant: PlantParameters,
    start: KernelFunction,
    step: KernelFunction,
    constants: Vector,
    jaw_reference_rad: Vector,
    tau_w_N_m: Vector,
    current_noise_A: Vector,
    quanta: tuple[float, float],
    believed_N_m_per_A: float,
    compensated: bool,
) -> NDArray[np.float64]:
    samples, steps = jaw_reference_rad.shape[0], loop.steps_per_sample
    r_m, r_j = plant.motor_pulley_radius_m, plant.jaw_pulley_radius_m
    period_s = loop.drive[0]
    out = np.empty((_COLUMNS, samples))
    plant_state = np.array([r_j / r_m * jaw_reference_rad[0], 0.0, jaw_reference_rad[0], 0.0])
    drive = np.zeros(5)
    reference = plant_state[0]
    state = np.empty(0)
    for n in range(samples):
        angle = quantise(plant_state[0], loop.encoder_quantum_rad)
        seen_angle = quantise(angle, quanta[0])
        seen_current = quantise(drive[DRIVE_CURRENT] + current_noise_A[n], quanta[1])
        drive = drive_step(drive, reference, angle, loop.drive)
        time_ns = round(n * period_s * 1e9)
        torque = believed_N_m_per_A * seen_current
        if n == 0:
            state = start(constants, time_ns, seen_angle, torque)
        else:
            state = step(state, constants, time_ns, seen_angle, torque)
        elongation = state[ELONGATION] if compensated else 0.0
        # Not finite: nothing is sent, and the drive keeps its reference.
        if math.isfinite(elongation):
            reference = quantise((r_j * jaw_reference_rad[n] + elongation) / r_m, quanta[0])
        out[0, n] = n * period_s
        out[1, n] = seen_angle
        out[2, n] = seen_current
        out[3, n] = plant_state[2]
        out[4, n] = r_m * plant_state[0] - r_j * plant_state[2]
        out[5, n] = tau_w_N_m[n * steps]
        out[6, n] = state[TAU_W]
        out[7, n] = state[ELONGATION]
        plant_state = interval(plant_state, drive[DRIVE_CURRENT], tau_w_N_m[n * steps : (n + 1) * steps], loop)
    return out


def run_direct(
    rig: Rig,
    estimator: Estimator,
    jaw_reference_rad: Vector,
    tau_w_N_m: Vector,
    *,
    compensated: bool = True,
    over_wire: bool = False,
    torque_constant_N_m_per_A: float | None = None,
    seed: int = 0,
) -> DirectRun:
    """Run the loop from rest at the first reference, at the drive's own sample time.

    `jaw_reference_rad` (n): θ_j^ref at each sample. `tau_w_N_m` (n·m): load over each of the m plant steps of a sample
    (`plant_steps`). `torque_constant_N_m_per_A`: for the torque of a sample's current; None: the plant's own.
    ValueError when these don't fit or the estimator isn't one of ours; UserError when the rig has no drive or doesn't
    know a value.
    """
    if estimator.compiled is None:
        raise ValueError(f"estimator {estimator.id!r} has no kernels to run in a compiled loop")
    samples, steps = jaw_reference_rad.size, plant_steps(rig)
    if samples < 1 or tau_w_N_m.shape != (samples * steps,):
        raise ValueError(f"tau_w_N_m must have {samples} × {steps} values, got {tau_w_N_m.shape}")
    law = rig.require_drive()
    drive = DriveParameters(
        law.sample_time_s,
        law.kp_A_per_rad,
        law.ki_A_per_rad_s,
        law.kd_A_s_per_rad,
        law.derivative_cutoff_Hz,
        law.current_limit_A,
        law.cascade_time_s,
    )
    loop = make_loop(rig.plant(), drive, rig.encoder.counts_per_rev, law.sample_time_s / steps)
    noise = np.random.default_rng(seed).standard_normal(samples) * rig.noise.current_A
    quanta = (WIRE_ANGLE_RAD, WIRE_CURRENT_A) if over_wire else (0.0, 0.0)
    plant = rig.plant()
    believed = plant.torque_constant_N_m_per_A if torque_constant_N_m_per_A is None else torque_constant_N_m_per_A
    return DirectRun(
        *_run(loop, plant, *estimator.compiled, jaw_reference_rad, tau_w_N_m, noise, quanta, believed, compensated)
    )


def plant_steps(rig: Rig) -> int:
    """Return the number of plant steps in a sample of the drive, so that none is longer than the bench's."""
    return max(1, math.ceil(rig.require_drive().sample_time_s / rig.bench.plant_step_s * (1.0 - 1e-9)))
