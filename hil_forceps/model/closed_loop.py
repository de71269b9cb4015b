"""The simulation of the closed loop with every effect of the catalogue.

The simulated world (another package) integrates the same equations with another method; a test compares the two.
Rows are as in a log: values at the instant of the row, so the current is the one commanded a sample earlier.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.model import drive_law
from hil_forceps.model.composition import Physics, encoder_rad, motor_viscosity_N_m_s_per_rad, wound_m
from hil_forceps.model.current import CurrentStep, current_over, current_step
from hil_forceps.model.drive_law import DriveState, drive_sample, law_current, law_vector, quantise
from hil_forceps.model.kernel import inlined, run_kernel
from hil_forceps.model.linear.gains import PIECES, SHORT, SIZE, TAUT, VISCOSITY, Gains, fill_all, fill_multiples
from hil_forceps.model.parameters import Vector
from hil_forceps.model.physics import Kind, State, dead_zone, followed, kind_of, paid_angle, torque_constant, wire
from hil_forceps.model.sensors import late, late_load
from hil_forceps.model.step.motion import Drive
from hil_forceps.model.step.refinement import refined_step
from hil_forceps.model.step.single_step import plain_step
from hil_forceps.model.step.whole_step import decays, suits, whole_step

__all__ = ["Channels", "DriveState", "Inputs", "Start", "State", "law_current", "law_vector", "rest", "simulate"]

_MAX_VISCOSITY_CHANGE_SHARE = 0.02  # of D_m: beyond, the linear plant is recomputed
_CHANNELS = 8
_REST_ITERATIONS = 50


_NO_ERROR: Vector = np.empty(0)


class Inputs(NamedTuple):
    """Inputs of a run. `tau_w_N_m` as recorded; its skew is corrected for the plant."""

    time_s: Vector  # n, equally spaced
    reference_rad: Vector  # n, held until the next row, or one for each sample of the drive
    tau_w_N_m: Vector  # n, linear in between
    edge_rows: NDArray[np.int64]  # m, increasing: between row k and k + 1 the load jumps ...
    edge_fractions: Vector  # m: ... at this fraction of the interval, instead of a ramp
    # As many as references, or none: error of the angle that the drive reads, its rounding as it happened. The loop
    # turns it into currents that move the motor, which changes the friction. It is not in the recorded angle.
    encoder_error_rad: Vector = _NO_ERROR
    # As many as references, or none: added to the current after the amplifier's limit.
    added_A: Vector = _NO_ERROR


class Start(NamedTuple):
    """State at the first row."""

    plant: State
    drive: DriveState


class Channels(NamedTuple):
    """A run as simulated, n each: the first four as sensors record them, the others true."""

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

    Creep, hysteresis and play are 0. The drive has the angle without quantisation and holds `current_A`.
    """
    p = Physics(*theta.tolist())
    return Start(
        rest_state(p, theta_m_rad, tension_N, current_A), DriveState(0.0, encoder_rad(p, theta_m_rad), 0.0, current_A)
    )


@inlined
def rest_state(p: Physics, theta_m_rad: float, tension_N: float, current_A: float) -> State:
    """Return the plant of `rest`."""
    stretch = tension_N / p.k
    for _ in range(_REST_ITERATIONS):  # the cubic's one real root by Newton's method
        square = p.wire_hardening_beta_per_m2 * stretch * stretch
        stretch -= (stretch * (1.0 + square) - tension_N / p.k) / (1.0 + 3.0 * square)
    if tension_N != 0.0:
        stretch += math.copysign(p.wire_slack_half_width_m, tension_N)
    theta_j = paid_angle(p, wound_m(p, theta_m_rad) - p.wire_permanent_stretch_stretch_m - stretch)
    return State(theta_m_rad, 0.0, theta_j, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, current_A)


class Counts(NamedTuple):
    """Division of a row."""

    steps: int  # of the plant in a sample of the drive
    substeps: int  # of the plant in a row
    step_s: float


class StepConstants(NamedTuple):
    """Constants of all steps of one length."""

    inertia: tuple[float, float]  # I/h of motor and jaw
    kept: tuple[float, float]  # share of the creep that is left after a step, and after a piece of it


@inlined
def _load(first: float, last: float, step: int, steps: int, edge: float) -> tuple[float, float]:
    """Return mean and slope of the load over a step of a row; `edge` < 0: a ramp, else where in the row it jumps."""
    if edge < 0.0:
        rise = (last - first) / steps
        return first + rise * (step + 0.5), rise
    share = max(0.0, min(1.0, edge * steps - step))
    return first * share + last * (1.0 - share), 6.0 * (last - first) * share * (1.0 - share)


@inlined
def record(out: Vector, row: int, p: Physics, x: State, tau_w_N_m: float) -> None:
    """Write the true values of a row, before errors of the sensors."""
    speed = followed(p, x.lost_rad, x.omega_m_rad_per_s)
    w = wire(p, x.theta_m_rad - x.lost_rad, speed, x.theta_j_rad, x.omega_j_rad_per_s, x.creep_m, x.loop)
    out[0, row] = encoder_rad(p, x.theta_m_rad)
    out[1, row] = x.current_A
    out[2, row] = x.theta_j_rad
    out[3, row] = tau_w_N_m
    out[4, row] = w.tension_N
    out[5, row] = w.elongation_m
    out[6, row] = x.omega_m_rad_per_s
    out[7, row] = x.omega_j_rad_per_s


@inlined
def _behind(commands: Vector, place: int, samples: int) -> float:
    """Return the command that came `samples` samples before the one at `place` of the ring."""
    at = place - samples
    value: float = commands[at if at >= 0 else at + commands.shape[0]]
    return value


@inlined
def amplified(p: Physics, commanded_A: float) -> float:
    """Return the amplifier's current for a command: dead band, then limit."""
    beyond = dead_zone(commanded_A, p.amplifier_deadband_half_width_A)
    return max(-p.current_saturation_limit_A, min(p.current_saturation_limit_A, beyond))


@inlined
def _commanded(
    p: Physics, law: Vector, quantum_rad: float, inputs: Inputs, at: int, theta_m_rad: float, drive: DriveState
) -> tuple[DriveState, float]:
    """Return the drive after its sample, and the amplifier's current."""
    angle = quantise(encoder_rad(p, theta_m_rad), quantum_rad)
    if at < inputs.encoder_error_rad.shape[0]:
        angle += inputs.encoder_error_rad[at]
    drive = drive_sample(law, drive, inputs.reference_rad[at], angle)
    current = amplified(p, drive.current_A)
    if at < inputs.added_A.shape[0]:
        current += inputs.added_A[at]
    return drive, current


@inlined
def _steady(p: Physics, current: float, load: tuple[float, float], time_s: float) -> Drive:
    """Return the inputs for a steady current and a load without a jump."""
    return Drive(current, 0.0, current, torque_constant(p, time_s), motor_viscosity_N_m_s_per_rad(p, time_s), *load)


@inlined
def step_constants(p: Physics, step_s: float) -> StepConstants:
    """Return the constants of all steps of one length."""
    creep_s = p.wire_creep_time_constant_s
    kept = (math.exp(-step_s / creep_s), math.exp(-step_s / PIECES / creep_s))
    return StepConstants((p.I_m / step_s, p.I_j / step_s), kept)


@inlined
def over_sample(
    p: Physics,
    kind: Kind,
    gains: Gains,
    whole: Gains,
    keeps: Vector,
    c: CurrentStep,
    counts: Counts,
    constants: StepConstants,
    x: State,
    commands: tuple[float, float],
    load_N_m: tuple[float, float, float],
    row: int,
    sample: int,
) -> State:
    """Return the plant's state a sample of the drive on.

    `gains` (`fill_all`) is recomputed in place where the motor's viscosity has drifted. `whole` and `keeps`
    (`fill_multiples`, `decays`) have a row for each step of the sample, or none where steps are never joined.
    `commands`: the delayed ones before and after the arrival. `load_N_m`: at both ends of the row, and the fraction of
    the row at which the load jumps (`_load`).
    """
    old, new = commands
    first, last, edge = load_N_m
    steps, substeps, step_s = counts.steps, counts.substeps, counts.step_s
    span, done = whole.shape[0] if edge < 0.0 else 0, 0  # steps that are tried as one, and steps that are done
    while done < steps:
        if span > 0 and done % span == 0:
            even = _load(first, last, (sample * steps + done) // span, substeps // span, -1.0)
            time_s = (row * substeps + sample * steps + done + 0.5 * span) * step_s
            moves, x = whole_step(p, kind, whole, keeps, span, x, _steady(p, new, even, time_s), 0.0)
            if moves:
                done += span
                continue
            if done == 0 and span == steps:  # try halves
                span = span // 2 if not kind.plain and steps % 4 == 0 else 0
                continue
        into, done = done, done + 1
        step = sample * steps + into
        mean, slope, ends = current_over(c, into, x.current_A, old, new)
        load, load_slope = _load(first, last, step, substeps, edge)
        time_s = (row * substeps + step + 0.5) * step_s
        constant, viscosity = torque_constant(p, time_s), motor_viscosity_N_m_s_per_rad(p, time_s)
        d = Drive(mean, slope, ends, constant, viscosity, load, load_slope)
        if not kind.plain:
            if abs(viscosity - gains[TAUT, VISCOSITY]) > _MAX_VISCOSITY_CHANGE_SHARE * p.D_m:
                fill_all(gains, p, viscosity, step_s)
            x = refined_step(p, kind, gains, constants.inertia, constants.kept, x, d)
        else:
            x = plain_step(p, gains, constants.inertia, x, d)
    return x


@run_kernel
def _rollout(
    p: Physics,
    law: Vector,
    quantum_rad: float,
    row_s: float,
    inputs: Inputs,
    edges: Vector,
    start: Start,
    substeps: int,
    samples: int,
    out: Vector,
) -> None:
    """Fill `out` (channels × rows); `edges`: for each row the fraction at which the load jumps, −1 where it doesn't."""
    rows, steps, step_s = inputs.tau_w_N_m.shape[0], substeps // samples, row_s / substeps
    told = inputs.reference_rad.shape[0] // rows  # references per row
    x, drive = start
    kind = kind_of(p)
    gains = np.empty((SHORT + 2, SIZE))
    fill_all(gains, p, motor_viscosity_N_m_s_per_rad(p, 0.0), step_s)
    # Over several steps of a sample: while motor and jaw keep moving, these are taken as one.
    wholly = steps if suits(p, kind, steps) else 0
    whole = np.empty((wholly, SIZE))
    fill_multiples(whole, p, motor_viscosity_N_m_s_per_rad(p, 0.0), step_s)
    keeps = decays(p, wholly, step_s)
    counts, constants = Counts(steps, substeps, step_s), step_constants(p, step_s)
    c = current_step(step_s, steps, p.actuation_delay_delay_s, p.electrical_lag_time_constant_s)
    commands = np.full(c.whole_samples + 2, x.current_A)
    place = 0
    for row in range(rows):
        record(out, row, p, x, inputs.tau_w_N_m[row])
        if row == rows - 1:
            break
        first, last = inputs.tau_w_N_m[row], inputs.tau_w_N_m[row + 1]
        for sample in range(samples):
            at = row if told == 1 else row * samples + sample
            drive, current = _commanded(p, law, quantum_rad, inputs, at, x.theta_m_rad, drive)
            place = place + 1 if place + 1 < commands.shape[0] else 0
            commands[place] = current
            old, new = _behind(commands, place, c.whole_samples + 1), _behind(commands, place, c.whole_samples)
            load = (first, last, edges[row])
            x = over_sample(p, kind, gains, whole, keeps, c, counts, constants, x, (old, new), load, row, sample)


def simulate(
    theta: Vector,
    law: Vector,
    quantum_rad: float,
    inputs: Inputs,
    start: Start,
    substeps: int = 4,
    drive_samples_per_row: int = 1,
) -> Channels:
    """Simulate a run; the GIL is released but for a few tens of µs.

    `theta`: `parameters.NAMES`. `law`: `law_vector`. `quantum_rad`: of the encoder, 0 for none. `substeps` of the plant
    a row, a multiple of `drive_samples_per_row`. ValueError when shapes or counts don't fit.
    """
    rows = inputs.time_s.shape[0]
    references = inputs.reference_rad.shape
    if rows < 2 or references not in {(rows,), (rows * drive_samples_per_row,)} or inputs.tau_w_N_m.shape != (rows,):
        raise ValueError("time_s, reference_rad and tau_w_N_m must have the same length, 2 at least")
    if inputs.encoder_error_rad.shape not in {(0,), references}:
        raise ValueError("encoder_error_rad must have the same length as reference_rad, or none")
    if inputs.added_A.shape not in {(0,), references}:
        raise ValueError("added_A must have the same length as reference_rad, or none")
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
    if p.channel_skew_tau_w_s != 0.0:
        tau_w, edge_rows, fractions = late_load(
            inputs.tau_w_N_m, inputs.edge_rows, inputs.edge_fractions, -p.channel_skew_tau_w_s / row_s
        )
        inputs = inputs._replace(tau_w_N_m=tau_w, edge_rows=edge_rows, edge_fractions=fractions)
    edges, out = np.full(rows, -1.0), np.empty((_CHANNELS, rows))
    edges[inputs.edge_rows] = inputs.edge_fractions
    inputs = Inputs._make(map(np.ascontiguousarray, inputs))
    _rollout(p, law, quantum_rad, row_s, inputs, edges, start, substeps, drive_samples_per_row, out)
    theta_m = late(out[0], p.channel_skew_theta_m_s / row_s)
    if quantum_rad > 0.0:
        theta_m = np.floor(theta_m / quantum_rad + 0.5) * quantum_rad
    current = (1.0 + p.current_gain_relative_error) * late(
        out[1], p.channel_skew_current_s / row_s, linear=True
    ) + p.current_offset_offset_A
    theta_j = late(out[2], p.channel_skew_theta_j_s / row_s)
    return Channels(theta_m, current, theta_j, recorded, *out[4:])
