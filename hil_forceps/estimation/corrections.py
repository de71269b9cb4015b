"""Corrections of an estimator's samples and estimates for known effects.

The estimators work on the paper's plant. Before them, sample by sample, the encoder's errors are removed from the
angle, and it is converted to the wire that an uneven pulley winds, behind the play. Errors of the current sensor,
drift, ripple, cogging and the friction beyond the paper's are removed from the motor's torque. After them, the jaw's
weight, its coupling and its friction beyond the paper's are removed from the load, the lever of the jaw is applied, and
the elongation follows from the tension by the wire's own law (hardening, dead zone, hysteresis, creep, moved zero).

The resulting elongation is the one that (10) needs: r_j θ_j^ref + x̂ is r_m times the angle that the encoder shows. A
current that lags or comes late was not constant over the interval before its sample. Its mean follows from the currents
at both ends, if every hold is sampled. Not corrected here: damping of the wire (in the Kalman filter's own model), dead
band and saturation (the current is measured after them), and skewed channels (a property of the record).
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba.np.unsafe import ndarray as fixed
from numpy.typing import NDArray

from hil_forceps.estimation.interface import ELONGATION, TAU_W, Estimate, Estimator, Sample, State
from hil_forceps.estimation.kernel import inlined, kernel
from hil_forceps.estimation.kernel_function import KernelFunction
from hil_forceps.model.composition import (
    Physics,
    encoder_rad,
    jaw_load_N_m,
    lever_m,
    motor_drag_N_m,
    motor_friction_N_m,
    motor_torque_N_m,
    motor_viscosity_N_m_s_per_rad,
    radius_m,
    relative_torque,
    wound_m,
)
from hil_forceps.model.parameters import vector
from hil_forceps.model.physics import (
    grip_N_m,
    jaw_level_N_m,
    lost_after,
    paid_angle,
    rub_N_m,
    sided_friction_N_m,
    slide,
    torque_constant,
)
from hil_forceps.rig.catalogue import EFFECTS
from hil_forceps.rig.schema import Rig

Vector = NDArray[np.float64]
Stamps = NDArray[np.int64]

IGNORED = frozenset(entry.id for entry in EFFECTS if not entry.corrected)
_HOLD_TOLERANCE_SHARE = 0.25  # of a hold of the drive, by which an interval may differ from it
_SLOW_LAG_KEPT_SHARE = 0.9  # of a current over a hold: above, it is nearly linear over the hold
_NEWTON_ITERATIONS = 8  # of Newton's method, and of a fixed point that gains a factor of 10 in each at least


class Memory(NamedTuple):
    """Memory of the corrections, as floats, and the estimate."""

    first_ns: float
    last_ns: float
    theta_m: float  # true angle of the motor
    shown: float  # angle that the encoder showed
    current_A: float  # true, at the last sample
    speed: float  # low-passed
    presliding: float
    loaded: float  # z of the presliding that grows with tension
    gripped: float  # z of the jaw's presliding
    theta_j: float  # as estimated
    lost_rad: float  # angle by which the pulley lags the motor
    loop: float
    creep_m: float
    stretched_m: float  # elongation less the moved zero and the creep
    tension_N: float
    tau_w_N_m: float
    elongation_m: float


_tuple: Any = fixed.to_fixed_tuple  # an array of known length as a tuple, in a kernel
_Seen = tuple[Vector, float, float]  # memory, and angle and torque of the paper's plant
_SIZE, _VALUES = len(Memory._fields), len(Physics._fields)
_LAST = Memory._fields.index("last_ns")


class Tuning(NamedTuple):
    """Constants of the corrections."""

    corner_rad_per_s: float  # of the low-pass of the speed
    # [rad/s] A quarter of a count within the low-pass's time constant: lower speeds look like standstill.
    still: float
    hold_s: float  # of a current, if every hold is sampled; else 0


@inlined
def _true_angle(p: Physics, shown: float) -> float:
    """Return the motor's angle for the angle that the encoder shows."""
    angle = shown / (1.0 + p.encoder_scale_relative_error)
    for _ in range(_NEWTON_ITERATIONS):
        angle -= (encoder_rad(p, angle) - shown) / (1.0 + p.encoder_scale_relative_error)
    return angle


@inlined
def _direction(speed: float, still: float) -> float:
    return max(-1.0, min(1.0, speed / still))


@inlined
def _true_current(p: Physics, torque_N_m: float) -> float:
    return (torque_N_m / p.K_t - p.current_offset_offset_A) / (1.0 + p.current_gain_relative_error)


@inlined
def begin(p: Physics, time_ns: int, shown_rad: float, torque_N_m: float) -> Memory:
    """Return the memory at the first sample: at rest, without memory of wire and friction."""
    current_A = _true_current(p, torque_N_m)
    angle = _true_angle(p, shown_rad)
    now = float(time_ns)
    theta_j = paid_angle(p, wound_m(p, angle) - p.wire_permanent_stretch_stretch_m)
    kept = (0.0, 0.0, 0.0, 0.0, theta_j, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    return Memory(now, now, angle, shown_rad, current_A, *kept)


@inlined
def _mean_current(p: Physics, previous_A: float, current_A: float, hold_s: float) -> float:
    """Return the mean over a hold of a current that lags its command or comes late, from its values at both ends."""
    mean = current_A
    if p.electrical_lag_time_constant_s > 0.0:
        kept = math.exp(-hold_s / p.electrical_lag_time_constant_s)
        if kept < _SLOW_LAG_KEPT_SHARE:
            commanded = (current_A - kept * previous_A) / (1.0 - kept)
            mean = commanded + (previous_A - commanded) * (1.0 - kept) * p.electrical_lag_time_constant_s / hold_s
        else:
            mean = 0.5 * (previous_A + current_A)
    late = p.actuation_delay_delay_s / hold_s - math.floor(p.actuation_delay_delay_s / hold_s)
    return mean + late * (previous_A - mean)


@inlined
def before(
    p: Physics, m: Memory, tuning: Tuning, time_ns: int, shown_rad: float, torque_N_m: float
) -> tuple[Memory, float, float]:
    """Return the memory at a sample, and the angle and torque of the paper's plant."""
    dt_s = (time_ns - m.last_ns) * 1e-9
    theta_m = _true_angle(p, shown_rad)
    speed, presliding, loaded, lost = m.speed, m.presliding, m.loaded, m.lost_rad
    if dt_s > 0.0:
        share = tuning.corner_rad_per_s * dt_s / (1.0 + tuning.corner_rad_per_s * dt_s)
        speed += share * ((theta_m - m.theta_m) / dt_s - speed)
        presliding = slide(presliding, theta_m - m.theta_m, p.presliding_friction_angle_rad)
        loaded = slide(loaded, theta_m - m.theta_m, p.loaded_presliding_angle_rad)
        lost = lost_after(p, lost, theta_m - m.theta_m)
    time_s = (time_ns - m.first_ns) * 1e-9
    current = _true_current(p, torque_N_m)
    mean = current
    if tuning.hold_s > 0.0 and abs(dt_s - tuning.hold_s) < _HOLD_TOLERANCE_SHARE * tuning.hold_s:
        mean = _mean_current(p, m.current_A, current, tuning.hold_s)
    torque = torque_constant(p, time_s) * mean * (1.0 + relative_torque(p, theta_m)) + motor_torque_N_m(p, theta_m)
    paper = p.D_m * speed + p.motor_coulomb * _direction(speed, tuning.still)
    level = motor_friction_N_m(p, speed, m.tension_N)
    level += sided_friction_N_m(p, speed)
    friction = motor_viscosity_N_m_s_per_rad(p, time_s) * speed + level * _direction(speed, tuning.still)
    friction += rub_N_m(p, presliding, loaded, m.tension_N) + motor_drag_N_m(p, speed)
    # r f = torque − friction − inertia: scaled to the nominal radius, plus the friction that the estimator subtracts.
    theta_p = theta_m - lost
    seen = p.r_m / radius_m(p, theta_p) * (torque - friction) + paper
    memory = Memory(
        m.first_ns, max(m.last_ns, float(time_ns)), theta_m, shown_rad, current, speed, presliding, loaded,
        m.gripped, m.theta_j, lost, m.loop, m.creep_m, m.stretched_m, m.tension_N, m.tau_w_N_m, m.elongation_m,
    )  # fmt: skip
    return memory, wound_m(p, theta_p) / p.r_m, seen


@inlined
def _stretch(p: Physics, force_N: float) -> float:
    """Return the stretch beyond the dead zone for a force: Newton's method on the cubic."""
    linear = force_N / p.k
    stretch: float = linear / (1.0 + p.wire_hardening_beta_per_m2 * linear * linear) ** (1.0 / 3.0)
    for _ in range(_NEWTON_ITERATIONS):
        square = p.wire_hardening_beta_per_m2 * stretch * stretch
        stretch -= (stretch * (1.0 + square) - linear) / (1.0 + 3.0 * square)
    return stretch


@inlined
def after(p: Physics, m: Memory, tuning: Tuning, dt_s: float, tau_w_N_m: float, elongation_m: float) -> Memory:
    """Return the memory with the corrected estimate."""
    tension = p.k * elongation_m
    stretch = _stretch(p, tension - p.wire_hysteresis_force_N * m.loop)
    stretched = stretch
    if p.wire_slack_half_width_m > 0.0:
        stretched += p.wire_slack_half_width_m * max(-1.0, min(1.0, stretch / p.wire_slack_half_width_m))
    loop, creep = m.loop, m.creep_m
    if p.wire_hysteresis_force_N != 0.0:
        loop = slide(loop, stretched - m.stretched_m, p.wire_hysteresis_stretch_m)
        stretched = stretched - stretch + _stretch(p, tension - p.wire_hysteresis_force_N * loop)
    if p.wire_creep_share != 0.0:
        kept = math.exp(-max(0.0, dt_s) / p.wire_creep_time_constant_s)
        creep = kept * creep + (1.0 - kept) * p.wire_creep_share * tension / p.k
    elongation = stretched + p.wire_permanent_stretch_stretch_m + creep
    theta_j = paid_angle(p, wound_m(p, m.theta_m - m.lost_rad) - elongation)
    direction = _direction(m.speed * p.r_m / p.r_j, tuning.still)
    load = tau_w_N_m + (lever_m(p, theta_j) - p.r_j) * tension - jaw_load_N_m(p, theta_j)
    load -= (jaw_level_N_m(p, theta_j) - p.jaw_coulomb) * direction
    gripped = slide(m.gripped, theta_j - m.theta_j, p.jaw_presliding_angle_rad)
    load -= grip_N_m(p, gripped, tension) + p.jaw_viscous_friction_viscosity_N_m_s_per_rad * m.speed * p.r_m / p.r_j
    return Memory(
        m.first_ns, m.last_ns, m.theta_m, m.shown, m.current_A, m.speed, m.presliding, m.loaded, gripped,
        theta_j, m.lost_rad, loop, creep, stretched, tension, load, p.r_m * m.shown - p.r_j * theta_j,
    )  # fmt: skip


# Arrays in and out: a tuple of so many numbers would take longer at each call from Python than the arithmetic.
@kernel
def _start(theta: Vector, tuning: Tuning, time_ns: int, shown: float, torque: float) -> _Seen:
    p = Physics(*_tuple(theta, _VALUES))
    m, angle, seen = before(p, begin(p, time_ns, shown, torque), tuning, time_ns, shown, torque)
    return np.array(m), angle, seen


@kernel
def _sample(theta: Vector, memory: Vector, tuning: Tuning, time_ns: int, shown: float, torque: float) -> _Seen:
    p, known = Physics(*_tuple(theta, _VALUES)), Memory(*_tuple(memory, _SIZE))
    m, angle, seen = before(p, known, tuning, time_ns, shown, torque)
    return np.array(m), angle, seen


@kernel
def _told(theta: Vector, memory: Vector, tuning: Tuning, dt_s: float, tau_w_N_m: float, elongation_m: float) -> Vector:
    p, known = Physics(*_tuple(theta, _VALUES)), Memory(*_tuple(memory, _SIZE))
    return np.array(after(p, known, tuning, dt_s, tau_w_N_m, elongation_m))


@kernel
def _record(
    theta: Vector,
    start: KernelFunction,
    step: KernelFunction,
    c: Vector,
    tuning: Tuning,
    time_ns: Stamps,
    shown_rad: Vector,
    torque_N_m: Vector,
) -> tuple[Vector, Vector]:
    """Return τ̂_w and x̂ at each sample: `start` and `step` of `corrected` in one compiled loop."""
    tau_w, elongation = np.empty(time_ns.shape[0]), np.empty(time_ns.shape[0])
    p = Physics(*_tuple(theta, _VALUES))
    fresh = begin(p, time_ns[0], shown_rad[0], torque_N_m[0])
    memory, angle, torque = before(p, fresh, tuning, time_ns[0], shown_rad[0], torque_N_m[0])
    state = start(c, time_ns[0], angle, torque)
    memory = after(p, memory, tuning, 0.0, state[TAU_W], state[ELONGATION])
    for n in range(time_ns.shape[0]):
        dt_s = (time_ns[n] - memory.last_ns) * 1e-9
        if dt_s > 0.0:
            memory, angle, torque = before(p, memory, tuning, time_ns[n], shown_rad[n], torque_N_m[n])
            state = step(state, c, time_ns[n], angle, torque)
            memory = after(p, memory, tuning, dt_s, state[TAU_W], state[ELONGATION])
        tau_w[n], elongation[n] = memory.tau_w_N_m, memory.elongation_m
    return tau_w, elongation


def tuning_of(rig: Rig, sample_time_s: float) -> Tuning:
    """Return the constants of the corrections for samples that are `sample_time_s` apart."""
    corner = 2.0 * np.pi * rig.estimators.rfob_cutoff_Hz
    counts = rig.encoder.counts_per_rev
    quantum = 1e-6 if counts is None else 2.0 * np.pi / counts
    hold_s = sample_time_s if rig.drive is None else rig.drive.sample_time_s
    seen = abs(hold_s - sample_time_s) < _HOLD_TOLERANCE_SHARE * sample_time_s
    return Tuning(corner, 0.25 * quantum * min(corner, 1.0 / sample_time_s), hold_s if seen else 0.0)


def corrected(estimator: Estimator, rig: Rig, sample_time_s: float) -> Estimator:
    """Return the estimator with corrections for a rig's effects, or itself if there is none to correct.

    UserError when the rig doesn't know a value of the plant.
    """
    if not set(rig.effects) - IGNORED:
        return estimator
    if estimator.compiled is None:
        raise ValueError(f"estimator {estimator.id!r} has no kernels")
    kernels = estimator.compiled
    theta = vector(rig)
    tuning = tuning_of(rig, sample_time_s)

    def told(inner: State, memory: Vector, dt_s: float) -> State:
        tau_w_N_m, elongation_m = estimator.estimate(inner)
        return np.concatenate((inner, _told(theta, memory, tuning, dt_s, tau_w_N_m, elongation_m)))

    def start(sample: Sample) -> State:
        memory, angle, torque = _start(theta, tuning, *sample)
        return told(estimator.start(Sample(sample.time_ns, angle, torque)), memory, 0.0)

    def step(state: State, sample: Sample) -> State:
        known = state[-_SIZE:]
        dt_s = (sample.time_ns - known[_LAST]) * 1e-9
        if dt_s <= 0.0:
            return state
        memory, angle, torque = _sample(theta, known, tuning, *sample)
        return told(estimator.step(state[:-_SIZE], Sample(sample.time_ns, angle, torque)), memory, dt_s)

    def record(time_ns: Stamps, theta_m_rad: Vector, motor_torque_N_m: Vector) -> tuple[Vector, Vector]:
        return _record(theta, *kernels, tuning, time_ns, theta_m_rad, motor_torque_N_m)

    return Estimator(estimator.id, start, step, _estimate, record=record)


def _estimate(state: State) -> Estimate:
    return Estimate(float(state[-2]), float(state[-1]))
