"""The mind's own simulation of the closed loop, with every effect of the catalogue.

The simulated world (another package) integrates the same equations with another method; a test compares the two.
Rows are what a log has: all as it is at the instant of the row, so the current is the one commanded a sample earlier.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.model import drive_law
from hil_forceps.model.current import current_over, current_step
from hil_forceps.model.drive_law import DriveState, drive_sample, law_current, law_vector, quantise
from hil_forceps.model.gains import SIZE, SLACK, TAUT, Gains, fill_gains
from hil_forceps.model.kernel import kernel
from hil_forceps.model.parameters import Vector
from hil_forceps.model.physics import Physics, State, dead_zone, encoder_rad, wire, wound_m
from hil_forceps.model.sensors import late, late_load
from hil_forceps.model.step import Drift, Torques, full_step, plain_step

__all__ = ["Channels", "DriveState", "Inputs", "Start", "State", "law_current", "law_vector", "rest", "simulate"]

_DRIFT_STEP = 0.02  # of D_m: further away, the linear plant is made anew
_ROWS = 8


class Inputs(NamedTuple):
    """What a run was driven with. `tau_w_N_m` is as recorded: a skewed channel is set right for the plant."""

    time_s: Vector  # n, equally spaced
    reference_rad: Vector  # n; held until the next row
    tau_w_N_m: Vector  # n, linear in between
    edge_rows: NDArray[np.int64]  # m, increasing: between row k and k + 1 the load jumps ...
    edge_fractions: Vector  # m: ... at this fraction of the interval, instead of a ramp


class Start(NamedTuple):
    """State at the first row."""

    plant: State
    drive: DriveState


class Channels(NamedTuple):
    """A run as simulated, n each: the first four as the sensors give them, the rest as it is."""

    theta_m_rad: Vector
    current_A: Vector
    theta_j_rad: Vector
    tau_w_N_m: Vector
    tension_N: Vector
    elongation_m: Vector
    omega_m_rad_per_s: Vector
    omega_j_rad_per_s: Vector


def rest(theta: Vector, theta_m_rad: float, tension_N: float = 0.0, current_A: float = 0.0) -> Start:
    """Return the start of a forceps at rest with the motor at `theta_m_rad` (true) and `tension_N` in the wire.

    Creep and hysteresis are relaxed; the drive has the angle as it is, no quantisation, and holds `current_A`.
    """
    p = Physics(*theta.tolist())
    stretch = tension_N / p.k
    for _ in range(50):  # the cubic's one real root by Newton's method
        slope = 1.0 + 3.0 * p.hardening * stretch * stretch
        stretch -= (stretch + p.hardening * stretch**3 - tension_N / p.k) / slope
    if tension_N != 0.0:
        stretch += math.copysign(p.slack, tension_N)
    theta_j = (wound_m(p, theta_m_rad) - p.zero_stretch - stretch) / p.r_j
    plant = State(theta_m_rad, 0.0, theta_j, 0.0, 0.0, 0.0, 0.0, current_A)
    return Start(plant, DriveState(0.0, encoder_rad(p, theta_m_rad), 0.0, current_A))


@kernel
def _state_dependent(p: Physics) -> bool:
    """Whether anything beyond the linear plant with constant friction is on."""
    motor = abs(p.stribeck_rise) + abs(p.presliding_level) + abs(p.load_mu) + abs(p.viscous_change)
    motor += abs(p.cogging_sine) + abs(p.cogging_cosine) + abs(p.ripple_sine) + abs(p.ripple_cosine)
    jaw = abs(p.jaw_slope) + abs(p.jaw_curvature) + abs(p.gravity_sine) + abs(p.gravity_cosine)
    of_wire = abs(p.slack) + abs(p.hardening) + abs(p.loop_force) + abs(p.creep_share) + abs(p.zero_stretch)
    of_wire += abs(p.pulley_sine) + abs(p.pulley_cosine) + abs(p.pitch)
    return motor + jaw + of_wire != 0.0


@kernel
def _load(first: float, last: float, step: int, steps: int, edge: float) -> tuple[float, float]:
    """Return mean and slope of the load over a step of a row; `edge` < 0: a ramp, else where in the row it jumps."""
    if edge < 0.0:
        rise = (last - first) / steps
        return first + rise * (step + 0.5), rise
    share = max(0.0, min(1.0, edge * steps - step))
    return first * share + last * (1.0 - share), 6.0 * (last - first) * share * (1.0 - share)


@kernel
def _rollout(
    p: Physics,
    law: Vector,
    quantum_rad: float,
    row_s: float,
    inputs: Inputs,
    plant: State,
    drive: DriveState,
    substeps: int,
    samples: int,
) -> Gains:
    rows = inputs.reference_rad.shape[0]
    steps = substeps // samples
    step_s = row_s / substeps
    out = np.empty((_ROWS, rows))
    full = _state_dependent(p)
    gains = np.empty((2, SIZE))
    viscosity = p.D_m
    fill_gains(gains[TAUT], p.r_m, p.r_j, p.I_m, p.I_j, viscosity, p.k, p.damping, step_s)
    fill_gains(gains[SLACK], p.r_m, p.r_j, p.I_m, p.I_j, viscosity, 0.0, 0.0, step_s)
    c = current_step(step_s, steps, p.delay, p.lag)
    commands = np.full(c.whole_samples + 2, plant.current_A)
    places = commands.shape[0]
    place = 0
    creep_kept = math.exp(-step_s / p.creep_time)
    constant_fade, constant_kept = math.exp(-0.5 * step_s / p.constant_time), math.exp(-step_s / p.constant_time)
    viscous_fade, viscous_kept = math.exp(-0.5 * step_s / p.viscous_time), math.exp(-step_s / p.viscous_time)
    edge_at, edges = 0, inputs.edge_rows.shape[0]
    for row in range(rows):
        w = wire(
            p,
            plant.theta_m_rad,
            plant.omega_m_rad_per_s,
            plant.theta_j_rad,
            plant.omega_j_rad_per_s,
            plant.creep_m,
            plant.loop,
        )
        out[0, row] = encoder_rad(p, plant.theta_m_rad)
        out[1, row] = plant.current_A
        out[2, row] = plant.theta_j_rad
        out[3, row] = inputs.tau_w_N_m[row]
        out[4, row] = w.tension_N
        out[5, row] = w.elongation_m
        out[6, row] = plant.omega_m_rad_per_s
        out[7, row] = plant.omega_j_rad_per_s
        if row == rows - 1:
            break
        first, last = inputs.tau_w_N_m[row], inputs.tau_w_N_m[row + 1]
        edge = -1.0
        while edge_at < edges and inputs.edge_rows[edge_at] < row:
            edge_at += 1
        if edge_at < edges and inputs.edge_rows[edge_at] == row:
            edge = inputs.edge_fractions[edge_at]
        for sample in range(samples):
            angle = quantise(encoder_rad(p, plant.theta_m_rad), quantum_rad)
            drive = drive_sample(law, drive, inputs.reference_rad[row], angle)
            place = place + 1 if place + 1 < places else 0
            commands[place] = max(-p.limit, min(p.limit, dead_zone(drive.current_A, p.deadband)))
            new = commands[place - c.whole_samples if place >= c.whole_samples else place - c.whole_samples + places]
            before = place - c.whole_samples - 1
            old = commands[before if before >= 0 else before + places]
            for step in range(steps):
                mean, slope, end = current_over(c, step, plant.current_A, old, new)
                constant = p.K_t * (1.0 + p.constant_change * (1.0 - constant_fade))
                load, load_slope = _load(first, last, sample * steps + step, substeps, edge)
                u = Torques(constant * mean, constant * slope, -load, -load_slope)
                if full:
                    wanted = p.D_m * (1.0 + p.viscous_change * (1.0 - viscous_fade))
                    if abs(wanted - viscosity) > _DRIFT_STEP * p.D_m:
                        viscosity = wanted
                        fill_gains(gains[TAUT], p.r_m, p.r_j, p.I_m, p.I_j, viscosity, p.k, p.damping, step_s)
                        fill_gains(gains[SLACK], p.r_m, p.r_j, p.I_m, p.I_j, viscosity, 0.0, 0.0, step_s)
                    drift = Drift(constant, wanted - viscosity)
                    plant = full_step(p, gains, step_s, plant, u, drift, (mean, slope, end), creep_kept)
                else:
                    plant = plain_step(p, gains, step_s, plant, u, end)
                constant_fade *= constant_kept
                viscous_fade *= viscous_kept
    return out


def simulate(
    theta: Vector,
    law: Vector,
    quantum_rad: float,
    inputs: Inputs,
    start: Start,
    substeps: int = 4,
    drive_samples_per_row: int = 1,
) -> Channels:
    """Simulate a run. The GIL is released for all of it but a few tens of µs.

    `theta`: `parameters.NAMES`. `law`: `law_vector`. `quantum_rad`: of the encoder, 0 for none. `substeps` of the plant
    a row, a multiple of `drive_samples_per_row`. ValueError when shapes or counts don't fit.
    """
    rows = inputs.time_s.shape[0]
    if rows < 2 or any(column.shape != (rows,) for column in (inputs.reference_rad, inputs.tau_w_N_m)):
        raise ValueError("time_s, reference_rad and tau_w_N_m must have the same length, 2 at least")
    if inputs.edge_rows.shape != inputs.edge_fractions.shape:
        raise ValueError("edge_rows and edge_fractions must have the same length")
    if drive_samples_per_row < 1 or substeps < 1 or substeps % drive_samples_per_row:
        raise ValueError(f"{substeps} substeps are no multiple of {drive_samples_per_row} samples of the drive")
    row_s = float(inputs.time_s[-1] - inputs.time_s[0]) / (rows - 1)
    sample_s = row_s / drive_samples_per_row
    if not math.isclose(law[drive_law.SAMPLE_TIME], sample_s, rel_tol=1e-3):
        raise ValueError(f"the law's sample time is {law[drive_law.SAMPLE_TIME]} s, the rows make it {sample_s} s")
    p = Physics(*theta.tolist())
    recorded = inputs.tau_w_N_m
    if p.skew_tau_w != 0.0:
        tau_w, edge_rows, fractions = late_load(
            inputs.tau_w_N_m, inputs.edge_rows, inputs.edge_fractions, -p.skew_tau_w / row_s
        )
        inputs = inputs._replace(tau_w_N_m=tau_w, edge_rows=edge_rows, edge_fractions=fractions)
    out = _rollout(p, law, quantum_rad, row_s, inputs, start.plant, start.drive, substeps, drive_samples_per_row)
    theta_m = late(out[0], p.skew_theta_m / row_s)
    if quantum_rad > 0.0:
        theta_m = np.floor(theta_m / quantum_rad + 0.5) * quantum_rad
    current = (1.0 + p.current_gain) * late(out[1], p.skew_current / row_s, linear=True) + p.current_offset
    theta_j = late(out[2], p.skew_theta_j / row_s)
    return Channels(theta_m, current, theta_j, recorded, *out[4:])
