"""One step of the plant with every effect: exact where it is linear, second order where it is not.

The linear plant answers exactly to what the step brings (`gains`); what the effects add to it is evaluated at the start
and at the end that follows from its value at the start, and put in as a line between. Stiff additions of the wire and
of presliding are held back by their own stiffness, so that no size of an effect makes the step unstable. Dry friction
has its own rule (`friction`).
"""

from typing import NamedTuple

from hil_forceps.model.friction import STOPPED, STUCK, Levels, Response, friction
from hil_forceps.model.gains import (
    DAMPING,
    FROM_JAW,
    FROM_MOTOR,
    FROM_STRETCH,
    JAW_MEAN,
    JAW_SLOPE,
    JAW_SPEED,
    JAW_WAY,
    MOTOR_MEAN,
    MOTOR_SLOPE,
    MOTOR_SPEED,
    MOTOR_WAY,
    SLACK,
    STIFFNESS,
    TAUT,
    VISCOSITY,
    Gains,
)
from hil_forceps.model.kernel import kernel
from hil_forceps.model.physics import (
    Physics,
    State,
    Wire,
    cogging_N_m,
    gravity_N_m,
    jaw_level_N_m,
    motor_level_N_m,
    ripple,
    slide,
    wire,
)


class Torques(NamedTuple):
    """What acts on the pulleys over a step: mean and slope of each."""

    motor: float
    motor_slope: float
    jaw: float
    jaw_slope: float


class Drift(NamedTuple):
    """What time does to the plant, at the middle of the step."""

    torque_constant: float  # K_t(t)
    viscous_extra: float  # D(t) less the viscosity in the gains


class Motion(NamedTuple):
    """Angles and speeds."""

    theta_m: float
    omega_m: float
    theta_j: float
    omega_j: float


class Excess(NamedTuple):
    """What the effects add to the linear plant at an instant."""

    wire: float  # tension above the linear
    motor: float  # torque on the motor pulley, without the wire's and presliding
    jaw: float  # torque on the jaw, without the wire's


@kernel
def _free(g: Gains, s: int, row: int, stretch: float, omega_m: float, omega_j: float, u: Torques) -> float:
    """Return what a row of the gains makes of a state and of torques."""
    total: float = (
        g[s, row + FROM_STRETCH] * stretch
        + g[s, row + FROM_MOTOR] * omega_m
        + g[s, row + FROM_JAW] * omega_j
        + g[s, row + MOTOR_MEAN] * u.motor
        + g[s, row + MOTOR_SLOPE] * u.motor_slope
        + g[s, row + JAW_MEAN] * u.jaw
        + g[s, row + JAW_SLOPE] * u.jaw_slope
    )
    return total


@kernel
def _jaw_guess(omega_j: float, push_j: float, level: float) -> float:
    """Return the jaw's friction as it is at the start of the step."""
    if omega_j == 0.0:
        return max(-level, min(level, push_j))
    return level if omega_j > 0.0 else -level


@kernel
def linear_step(
    p: Physics, g: Gains, s: int, step_s: float, state: State, u: Torques, motor: Levels, jaw: Levels
) -> Motion:
    """Return the motion at the end of a step under given torques and levels of friction."""
    omega_m, omega_j = state.omega_m_rad_per_s, state.omega_j_rad_per_s
    stretch = p.r_m * state.theta_m_rad - p.r_j * state.theta_j_rad
    way_m = _free(g, s, MOTOR_WAY, stretch, omega_m, omega_j, u)
    speed_m = _free(g, s, MOTOR_SPEED, stretch, omega_m, omega_j, u)
    way_j = _free(g, s, JAW_WAY, stretch, omega_m, omega_j, u)
    speed_j = _free(g, s, JAW_SPEED, stretch, omega_m, omega_j, u)
    pull = g[s, STIFFNESS] * stretch + g[s, DAMPING] * (p.r_m * omega_m - p.r_j * omega_j)

    push_j = u.jaw - 0.5 * u.jaw_slope + p.r_j * pull
    guess = _jaw_guess(omega_j, push_j, jaw.rest)
    push_m = u.motor - 0.5 * u.motor_slope - p.r_m * pull - g[s, VISCOSITY] * omega_m
    response = Response(
        g[s, MOTOR_SPEED + MOTOR_MEAN],
        g[s, MOTOR_SPEED + MOTOR_SLOPE],
        g[s, MOTOR_WAY + MOTOR_MEAN],
        g[s, MOTOR_WAY + MOTOR_SLOPE],
    )
    free_speed = speed_m - g[s, MOTOR_SPEED + JAW_MEAN] * guess
    free_way = way_m - g[s, MOTOR_WAY + JAW_MEAN] * guess
    mean, slope, fate_m = friction(omega_m, free_speed, free_way, push_m, p.I_m / step_s, response, motor)
    way_m -= g[s, MOTOR_WAY + MOTOR_MEAN] * mean + g[s, MOTOR_WAY + MOTOR_SLOPE] * slope
    speed_m -= g[s, MOTOR_SPEED + MOTOR_MEAN] * mean + g[s, MOTOR_SPEED + MOTOR_SLOPE] * slope
    way_j -= g[s, JAW_WAY + MOTOR_MEAN] * mean + g[s, JAW_WAY + MOTOR_SLOPE] * slope
    speed_j -= g[s, JAW_SPEED + MOTOR_MEAN] * mean + g[s, JAW_SPEED + MOTOR_SLOPE] * slope

    response = Response(
        g[s, JAW_SPEED + JAW_MEAN], g[s, JAW_SPEED + JAW_SLOPE], g[s, JAW_WAY + JAW_MEAN], g[s, JAW_WAY + JAW_SLOPE]
    )
    mean, slope, fate_j = friction(omega_j, speed_j, way_j, push_j, p.I_j / step_s, response, jaw)
    way_m -= g[s, MOTOR_WAY + JAW_MEAN] * mean + g[s, MOTOR_WAY + JAW_SLOPE] * slope
    speed_m -= g[s, MOTOR_SPEED + JAW_MEAN] * mean + g[s, MOTOR_SPEED + JAW_SLOPE] * slope
    way_j -= g[s, JAW_WAY + JAW_MEAN] * mean + g[s, JAW_WAY + JAW_SLOPE] * slope
    speed_j -= g[s, JAW_SPEED + JAW_MEAN] * mean + g[s, JAW_SPEED + JAW_SLOPE] * slope
    if fate_m >= STOPPED:
        speed_m = 0.0
        if fate_m == STUCK:
            way_m = 0.0
    if fate_j >= STOPPED:
        speed_j = 0.0
        if fate_j == STUCK:
            way_j = 0.0
    return Motion(state.theta_m_rad + way_m, speed_m, state.theta_j_rad + way_j, speed_j)


@kernel
def _excess(p: Physics, g: Gains, s: int, m: Motion, w: Wire, drift: Drift, current_A: float) -> Excess:
    """Return what the effects add at an instant."""
    linear = g[s, STIFFNESS] * (p.r_m * m.theta_m - p.r_j * m.theta_j)
    linear += g[s, DAMPING] * (p.r_m * m.omega_m - p.r_j * m.omega_j)
    motor = drift.torque_constant * current_A * ripple(p, m.theta_m) + cogging_N_m(p, m.theta_m)
    motor -= drift.viscous_extra * m.omega_m + (w.radius_m - p.r_m) * w.tension_N
    return Excess(w.tension_N - linear, motor, -gravity_N_m(p, m.theta_j))


@kernel
def held_back(change: float, way: float, way_of_mean: float, way_of_slope: float) -> tuple[float, float]:
    """Return how much of a force's change over a step is put in: (mean, slope).

    `change` is what a way of `way` would bring; the force itself shortens the way by `way_of_mean` per unit of its mean
    (0 < way_of_mean) and `way_of_slope` per unit of its slope. Soft: half of it and all of it, a line from start to
    end. Stiff: the end's value alone, found implicitly, which damps.
    """
    stiffness = change / way if way != 0.0 else 0.0
    if not stiffness > 0.0:
        return 0.5 * change, change
    blend = 1.0 / (1.0 + way_of_mean * stiffness)
    mean = 1.0 - 0.5 * blend
    change /= 1.0 + (way_of_mean * mean + way_of_slope * blend) * stiffness
    return mean * change, blend * change


@kernel
def full_step(
    p: Physics,
    g: Gains,
    step_s: float,
    state: State,
    u: Torques,
    drift: Drift,
    current: tuple[float, float, float],
    kept: float,
) -> State:
    """Return the plant's state a step on with every effect that hangs on the state.

    `u`: torques of current and load; `current`: mean, slope and end of the current; `kept`: what creep keeps of itself.
    """
    now = Motion(state.theta_m_rad, state.omega_m_rad_per_s, state.theta_j_rad, state.omega_j_rad_per_s)
    w0 = wire(p, now.theta_m, now.omega_m, now.theta_j, now.omega_j, state.creep_m, state.loop)
    s = SLACK if w0.slack else TAUT
    first = _excess(p, g, s, now, w0, drift, current[0] - 0.5 * current[1])
    rub = p.presliding_level * state.presliding
    held = Torques(
        u.motor + first.motor - rub - p.r_m * first.wire,
        u.motor_slope,
        u.jaw + first.jaw + p.r_j * first.wire,
        u.jaw_slope,
    )
    level = motor_level_N_m(p, now.omega_m, w0.tension_N)
    rest = motor_level_N_m(p, 0.0, w0.tension_N)
    forward, backward = max(0.0, p.asymmetry), max(0.0, -p.asymmetry)
    level_j = jaw_level_N_m(p, now.theta_j)
    motor, jaw = Levels(level, level, rest, forward, backward), Levels(level_j, level_j, level_j, 0.0, 0.0)
    end = linear_step(p, g, s, step_s, state, held, motor, jaw)

    creep = kept * state.creep_m + (1.0 - kept) * p.creep_share * w0.tension_N / p.k
    wound0, loop = w0.elongation_m, state.loop
    w1 = wire(p, end.theta_m, end.omega_m, end.theta_j, end.omega_j, creep, loop)
    if p.loop_force != 0.0:
        loop = slide(state.loop, w1.elongation_m - wound0, p.loop_stretch)
        w1 = wire(p, end.theta_m, end.omega_m, end.theta_j, end.omega_j, creep, loop)
    last = _excess(p, g, s, end, w1, drift, current[0] + 0.5 * current[1])
    compliance = p.r_m * p.r_m * g[s, MOTOR_WAY + MOTOR_MEAN] + p.r_j * p.r_j * g[s, JAW_WAY + JAW_MEAN]
    compliance -= p.r_m * p.r_j * (g[s, MOTOR_WAY + JAW_MEAN] + g[s, JAW_WAY + MOTOR_MEAN])
    compliance_slope = p.r_m * p.r_m * g[s, MOTOR_WAY + MOTOR_SLOPE] + p.r_j * p.r_j * g[s, JAW_WAY + JAW_SLOPE]
    compliance_slope -= p.r_m * p.r_j * (g[s, MOTOR_WAY + JAW_SLOPE] + g[s, JAW_WAY + MOTOR_SLOPE])
    pull, pull_slope = held_back(last.wire - first.wire, w1.elongation_m - wound0, compliance, compliance_slope)
    more_rub, rub_slope = 0.0, 0.0
    if p.presliding_level != 0.0:
        way = end.theta_m - now.theta_m
        change = p.presliding_level * (slide(state.presliding, way, p.presliding_angle) - state.presliding)
        more_rub, rub_slope = held_back(change, way, g[s, MOTOR_WAY + MOTOR_MEAN], g[s, MOTOR_WAY + MOTOR_SLOPE])
    more_m, more_j = last.motor - first.motor, last.jaw - first.jaw
    u2 = Torques(
        held.motor + 0.5 * more_m - p.r_m * pull - more_rub,
        held.motor_slope + more_m - p.r_m * pull_slope - rub_slope,
        held.jaw + 0.5 * more_j + p.r_j * pull,
        held.jaw_slope + more_j + p.r_j * pull_slope,
    )
    motor = Levels(level, motor_level_N_m(p, end.omega_m, w1.tension_N), rest, forward, backward)
    jaw = Levels(level_j, jaw_level_N_m(p, end.theta_j), level_j, 0.0, 0.0)
    end = linear_step(p, g, s, step_s, state, u2, motor, jaw)

    creep, presliding = state.creep_m, state.presliding
    if p.creep_share != 0.0:
        creep = kept * creep + (1.0 - kept) * p.creep_share * 0.5 * (w0.tension_N + w1.tension_N) / p.k
    if p.presliding_level != 0.0:
        presliding = slide(presliding, end.theta_m - now.theta_m, p.presliding_angle)
    loop = state.loop
    if p.loop_force != 0.0:
        after = wire(p, end.theta_m, end.omega_m, end.theta_j, end.omega_j, creep, loop)
        loop = slide(loop, after.elongation_m - wound0, p.loop_stretch)
    return State(end.theta_m, end.omega_m, end.theta_j, end.omega_j, creep, loop, presliding, current[2])


@kernel
def plain_step(p: Physics, g: Gains, step_s: float, state: State, u: Torques, current_A: float) -> State:
    """Return the plant's state a step on, without an effect that hangs on the state; `current_A` is the end's."""
    motor = Levels(p.motor_coulomb, p.motor_coulomb, p.motor_coulomb, max(0.0, p.asymmetry), max(0.0, -p.asymmetry))
    jaw = Levels(p.jaw_coulomb, p.jaw_coulomb, p.jaw_coulomb, 0.0, 0.0)
    end = linear_step(p, g, TAUT, step_s, state, u, motor, jaw)
    return State(
        end.theta_m, end.omega_m, end.theta_j, end.omega_j, state.creep_m, state.loop, state.presliding, current_A
    )
