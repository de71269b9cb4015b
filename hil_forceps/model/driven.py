"""The simulation of a rig whose drive isn't known: the measured motion of the motor is its input.

If the load is known, the jaw follows through the wire, and the motor's torque results from its balance. If the jaw's
angle is measured instead, the tension results from the angles, and the load from the jaw's balance. The jaw is stepped
by backward Euler. With the motor's motion prescribed, little else damps the wire's mode, and frequencies above the
bandwidth of the smoothed motion are of no interest here.
"""

from typing import NamedTuple

import numpy as np

from hil_forceps.model.composition import (
    Physics,
    jaw_load_N_m,
    motor_drag_N_m,
    motor_friction_N_m,
    motor_torque_N_m,
    motor_viscosity_N_m_s_per_rad,
    relative_torque,
)
from hil_forceps.model.kernel import run_kernel, subroutine
from hil_forceps.model.parameters import Vector
from hil_forceps.model.physics import (
    dead_zone,
    followed,
    grip_N_m,
    grips,
    jaw_level_N_m,
    lost_after,
    paid_angle,
    rub_N_m,
    sided_friction_N_m,
    slid,
    slide,
    torque_constant,
    wire,
)
from hil_forceps.model.sensors import late
from hil_forceps.model.smoothing import Smooth, smooth

_OUTPUT_ROWS = 6
_NEWTON_ITERATIONS = 12
DEFAULT_BANDWIDTH_HZ = 30.0


class Inputs(NamedTuple):
    """Columns of a run as recorded, n each; one of `tau_w_N_m` and `theta_j_rad` may be None."""

    time_s: Vector  # equally spaced
    theta_m_rad: Vector
    tau_w_N_m: Vector | None
    theta_j_rad: Vector | None


class Start(NamedTuple):
    """Memories of wire and friction at the first row."""

    creep_m: float = 0.0
    loop: float = 0.0
    presliding: float = 0.0
    loaded: float = 0.0
    gripped: float = 0.0
    lost_rad: float = 0.0


class Channels(NamedTuple):
    """A run as simulated, n each; the first four as sensors record them, the last two true."""

    current_A: Vector
    theta_j_rad: Vector
    tau_w_N_m: Vector
    motor_torque_N_m: Vector
    tension_N: Vector
    elongation_m: Vector


_RELAXED = Start()


class _Columns(NamedTuple):
    motor: Smooth
    jaw: Smooth
    tau_w_N_m: Vector


@subroutine
def _slip(
    p: Physics,
    theta_p: float,
    omega_p: float,
    before: tuple[float, float],
    load: float,
    h: float,
    memory: tuple[float, float, float, float],
) -> float:
    """Return the jaw's speed at the end of a step, by Newton's method; `load` includes dry friction."""
    theta, speed = before
    creep, loop0, wound0, gripped0 = memory
    end = speed
    for _ in range(_NEWTON_ITERATIONS):
        angle = theta + h * end
        w = wire(p, theta_p, omega_p, angle, end, creep, loop0)
        pull, slope = w.tension_N, 0.0
        if p.wire_hysteresis_force_N != 0.0:
            way = w.elongation_m - wound0
            loop = slide(loop0, way, p.wire_hysteresis_stretch_m)
            pull += p.wire_hysteresis_force_N * (loop - loop0)
            slope += p.wire_hysteresis_force_N * (1.0 - (loop if way > 0.0 else -loop)) / p.wire_hysteresis_stretch_m
        if not w.slack:
            stretch = dead_zone(w.elongation_m - p.wire_permanent_stretch_stretch_m - creep, p.wire_slack_half_width_m)
            slope += (
                p.k * (1.0 + 3.0 * p.wire_hardening_beta_per_m2 * stretch * stretch)
                + p.wire_damping_damping_N_s_per_m / h
            )
        gap = p.I_j * (end - speed) / h - w.lever_m * pull + jaw_load_N_m(p, angle) + load
        gap += p.jaw_viscous_friction_viscosity_N_m_s_per_rad * end
        stiffness = w.lever_m * w.lever_m * slope + p.jaw_coupling_stiffness_N_m_per_rad
        if grips(p):
            way = h * end
            gripped = slide(gripped0, way, p.jaw_presliding_angle_rad)
            gap += grip_N_m(p, gripped, pull)
            stiffness += grip_N_m(p, 1.0 - (gripped if way > 0.0 else -gripped), pull) / p.jaw_presliding_angle_rad
            stiffness -= p.jaw_presliding_mu * p.r_j * gripped * (1.0 if pull > 0.0 else -1.0) * w.lever_m * slope
        change = gap / (p.I_j / h + p.jaw_viscous_friction_viscosity_N_m_s_per_rad + stiffness * h)
        end -= change
        if abs(change) < 1e-12 * (1.0 + abs(end)):
            break
    return end


@subroutine
def _jaw_speed(
    p: Physics,
    theta_p: float,
    omega_p: float,
    before: tuple[float, float],
    load: float,
    h: float,
    memory: tuple[float, float, float, float],
) -> float:
    """Return the jaw's speed at the end of a step; 0 where dry friction holds it."""
    level = jaw_level_N_m(p, before[0])
    forward = _slip(p, theta_p, omega_p, before, load + level, h, memory)
    if forward > 0.0 or level == 0.0:
        return forward
    return min(0.0, _slip(p, theta_p, omega_p, before, load - level, h, memory))


@run_kernel
def _driven(p: Physics, c: _Columns, row_s: float, still: float, known_load: bool, start: Start, out: Vector) -> None:
    rows = c.motor.angle_rad.shape[0]
    creep, loop, presliding, loaded, gripped, lost = start
    kept = np.exp(-row_s / p.wire_creep_time_constant_s)
    theta_j, omega_j = c.jaw.angle_rad[0], c.jaw.speed_rad_per_s[0]
    wound0, way_j = 0.0, 0.0
    for n in range(rows):
        theta_m, omega_m = c.motor.angle_rad[n], c.motor.speed_rad_per_s[n]
        time_s = n * row_s
        if n > 0:
            way = theta_m - c.motor.angle_rad[n - 1]
            lost = lost_after(p, lost, way)
            presliding, loaded = slid(p, presliding, loaded, way)
        theta_p, omega_p = theta_m - lost, followed(p, lost, omega_m)
        if not known_load:
            theta_j, omega_j = c.jaw.angle_rad[n], c.jaw.speed_rad_per_s[n]
            way_j = theta_j - c.jaw.angle_rad[n - 1] if n > 0 else 0.0
        elif n > 0:
            memory = (creep, loop, wound0, gripped)
            omega_j = _jaw_speed(p, theta_p, omega_p, (theta_j, omega_j), c.tau_w_N_m[n], row_s, memory)
            way_j = row_s * omega_j
            theta_j += way_j
        if grips(p):
            gripped = slide(gripped, way_j, p.jaw_presliding_angle_rad)
        w = wire(p, theta_p, omega_p, theta_j, omega_j, creep, loop)
        if n > 0 and p.wire_hysteresis_force_N != 0.0:
            loop = slide(loop, w.elongation_m - wound0, p.wire_hysteresis_stretch_m)
            w = wire(p, theta_p, omega_p, theta_j, omega_j, creep, loop)
        wound0 = w.elongation_m
        constant = torque_constant(p, time_s)
        level = motor_friction_N_m(p, omega_m, w.tension_N) + sided_friction_N_m(p, omega_m)
        sign = max(-1.0, min(1.0, omega_m / still)) if still > 0.0 else np.sign(omega_m)
        torque = (
            p.I_m * c.motor.acceleration_rad_per_s2[n]
            + motor_viscosity_N_m_s_per_rad(p, time_s) * omega_m
            + level * sign
        )
        torque += rub_N_m(p, presliding, loaded, w.tension_N)
        torque += w.radius_m * w.tension_N - motor_torque_N_m(p, theta_m) + motor_drag_N_m(p, omega_m)
        out[0, n] = torque / (constant * (1.0 + relative_torque(p, theta_m)))
        out[1, n] = theta_j
        out[2, n] = c.tau_w_N_m[n]
        if not known_load:
            friction = jaw_level_N_m(p, theta_j) * np.sign(omega_j) + grip_N_m(p, gripped, w.tension_N)
            inertia = p.I_j * c.jaw.acceleration_rad_per_s2[n]
            friction += p.jaw_viscous_friction_viscosity_N_m_s_per_rad * omega_j
            out[2, n] = w.lever_m * w.tension_N - friction - jaw_load_N_m(p, theta_j) - inertia
        out[3, n] = torque
        out[4, n] = w.tension_N
        out[5, n] = w.elongation_m
        if p.wire_creep_share != 0.0:
            creep = kept * creep + (1.0 - kept) * p.wire_creep_share * w.tension_N / p.k


def motor_angle_rad(theta: Vector, theta_enc_rad: Vector, row_s: float) -> Vector:
    """Return the true motor angle from the recorded one: skew, scale and eccentricity of the encoder removed."""
    p = Physics(*theta.tolist())
    rows = -p.channel_skew_theta_m_s / row_s
    beyond = int(np.ceil(abs(rows))) + 2
    # Extrapolated: values held beyond the ends would stop the motion there.
    recorded = late(np.pad(theta_enc_rad, beyond, mode="reflect", reflect_type="odd"), rows)[beyond:-beyond]
    angle = recorded / (1.0 + p.encoder_scale_relative_error)
    for _ in range(8):  # the slope of the error is far below 1: each iteration multiplies what is left by it
        error = p.encoder_eccentricity_sine_rad * np.sin(angle) + p.encoder_eccentricity_cosine_rad * np.cos(angle)
        angle = (recorded - error) / (1.0 + p.encoder_scale_relative_error)
    return angle


def _side_by_side(motion: Smooth) -> Smooth:
    return Smooth._make(map(np.ascontiguousarray, motion))


@run_kernel
def _resting_jaw(p: Physics, theta_m: float, tau_w_N_m: float) -> float:
    """Return the jaw's angle in balance with the load, without memory of the wire."""
    theta_j = paid_angle(p, p.r_m * theta_m)
    step_s = 1.0  # so long that inertia does not matter
    state = (0.0, 0.0, wire(p, theta_m, 0.0, theta_j, 0.0, 0.0, 0.0).elongation_m, 0.0)
    for _ in range(5):
        theta_j += step_s * _slip(p, theta_m, 0.0, (theta_j, 0.0), tau_w_N_m, step_s, state)
    return theta_j


def simulate(
    theta: Vector,
    inputs: Inputs,
    start: Start = _RELAXED,
    *,
    bandwidth_Hz: float = DEFAULT_BANDWIDTH_HZ,
    still_rad_per_s: float = 0.0,
    motion: Smooth | None = None,
) -> Channels:
    """Predict current, motor torque, and the jaw's angle or the load, from the measured motion of the motor.

    `theta`: `parameters.NAMES`. Angles are smoothed to `bandwidth_Hz` (`smoothing`). Below `still_rad_per_s` the
    motor's dry friction is linear in speed, because at rest the motion does not determine it. `motion`: the smoothed
    recorded angle, if there already; used where the encoder has no error. ValueError when neither load nor jaw angle
    is there, or shapes don't fit.
    """
    rows = inputs.time_s.shape[0]
    columns = (inputs.theta_m_rad, inputs.tau_w_N_m, inputs.theta_j_rad)
    if any(column is not None and column.shape != (rows,) for column in columns):
        raise ValueError("all columns must have the length of time_s")
    p = Physics(*theta.tolist())
    row_s = float(inputs.time_s[-1] - inputs.time_s[0]) / (rows - 1)
    exact = (
        p.channel_skew_theta_m_s
        == p.encoder_scale_relative_error
        == p.encoder_eccentricity_sine_rad
        == p.encoder_eccentricity_cosine_rad
        == 0.0
    )
    if exact and motion is not None:
        motor = motion
    else:
        motor = smooth(motor_angle_rad(theta, inputs.theta_m_rad, row_s), row_s, bandwidth_Hz)
    if inputs.tau_w_N_m is not None:
        load = late(inputs.tau_w_N_m, -p.channel_skew_tau_w_s / row_s, linear=True)
        ratio = p.r_m / p.r_j
        first = _resting_jaw(p, float(motor.angle_rad[0]), float(load[0]))
        jaw = Smooth(np.array([first]), motor.speed_rad_per_s[:1] * ratio, np.zeros(1))
    elif inputs.theta_j_rad is not None:
        load = np.zeros(rows)
        jaw = smooth(late(inputs.theta_j_rad, -p.channel_skew_theta_j_s / row_s), row_s, bandwidth_Hz)
    else:
        raise ValueError("neither tau_w_N_m nor theta_j_rad is there: one of them must be known")
    seen = _Columns(_side_by_side(motor), _side_by_side(jaw), np.ascontiguousarray(load))
    out = np.empty((_OUTPUT_ROWS, rows))
    _driven(p, seen, row_s, still_rad_per_s, inputs.tau_w_N_m is not None, start, out)
    current = (1.0 + p.current_gain_relative_error) * late(
        out[0], p.channel_skew_current_s / row_s, linear=True
    ) + p.current_offset_offset_A
    theta_j = late(out[1], p.channel_skew_theta_j_s / row_s)
    tau_w = late(out[2], p.channel_skew_tau_w_s / row_s, linear=True) if inputs.tau_w_N_m is None else inputs.tau_w_N_m
    return Channels(
        current, theta_j, tau_w, late(out[3], p.channel_skew_current_s / row_s, linear=True), out[4], out[5]
    )
