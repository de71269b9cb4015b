"""One pass of the filter over a run.

Where a mass slides, its dry friction is what the model says. Where it may stick, friction is only known to lie within
its level: it is a state that wanders there, and those rows say nothing of the parameters (`passes.counting`).
"""

import math

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.advance import (
    Acting,
    Regimes,
    advance_in,
    expected_friction_j_N_m,
    expected_friction_m_N_m,
    steppers,
)
from hil_forceps.diagnosis.state_space.covariance import disturbed, forgotten, freed, moved, spread
from hil_forceps.diagnosis.state_space.kernel import inlined, kernel
from hil_forceps.diagnosis.state_space.layout import (
    CHANNELS,
    COMMAND_BIAS,
    COURSE,
    CURRENT,
    CURRENT_BEFORE,
    CURRENT_NOISE,
    ELASTIC_SLOPE,
    ENCODER,
    FRICTION_J,
    FRICTION_M,
    JAW_NOISE,
    JAW_ZERO,
    LOAD,
    LOAD_CELL,
    LOAD_NOISE,
    LOAD_SLOPE,
    OMEGA_J,
    OMEGA_M,
    PREDICTED_CURRENT,
    PREDICTED_LOAD_SLOPE,
    PREDICTED_OMEGA_J,
    PREDICTED_OMEGA_M,
    PREDICTED_THETA_J,
    PREDICTED_THETA_M,
    STATES,
    THETA_J,
    THETA_M,
    Filtered,
    Series,
)
from hil_forceps.diagnosis.state_space.measurement import (
    corrected,
    corrected_but,
    current_direction,
    direction,
    evidence,
    measured,
    predicted,
)
from hil_forceps.diagnosis.state_space.transition import (
    elastic_share,
    friction_kept,
    jump_covariance,
    stiffened,
    transition,
)
from hil_forceps.model.composition import Physics
from hil_forceps.model.physics import State

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Flags = NDArray[np.bool_]

SURPRISE = 4.5  # deviations of an innovation: 1 in 150 000 by chance
_SURE = 3.0  # deviations: a speed's sign is known beyond
_SETTLING_ROWS = 300  # after which the filter's deviations stay as they are


@kernel
def noise_kept(d: Series, kept_friction: float) -> Vector:
    """Return how much of each state beyond the plant's is kept over a row."""
    kept = np.ones(STATES)
    kept[FRICTION_M] = kept[FRICTION_J] = kept_friction
    kept[JAW_NOISE], kept[LOAD_NOISE] = d.noise_correlation[0], d.noise_correlation[1]
    kept[CURRENT_NOISE] = d.noise_correlation[2]
    return kept


@kernel
def first_plant(d: Series) -> State:
    """Return the plant at the first row: wire and friction remember nothing."""
    x = d.first_state
    current = d.command_A[0]
    return State(x[THETA_M], x[OMEGA_M], x[THETA_J], x[OMEGA_J], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, current)


@inlined
def beginning(x: State, plant: Vector) -> State:
    """Return the plant with the filter's angles and speeds."""
    memory = (x.creep_m, x.loop, x.presliding, x.loaded, x.gripped, x.lost_rad)
    return State(plant[THETA_M], plant[OMEGA_M], plant[THETA_J], plant[OMEGA_J], *memory, x.current_A)


@inlined
def friction_on(p: Physics, d: Series, row: int, x: Vector, variance: Vector) -> tuple[float, float]:
    """Return the dry friction that the plant's step is without, motor and jaw: its mean, and the filter's state."""
    motor, jaw = 0.0, 0.0
    if d.friction_free_m[row]:
        tension = p.k * (p.r_m * x[THETA_M] - p.r_j * x[THETA_J])
        motor = expected_friction_m_N_m(p, x[OMEGA_M], math.sqrt(variance[OMEGA_M]), tension) + x[FRICTION_M]
    if d.friction_free_j[row]:
        jaw = expected_friction_j_N_m(p, x[OMEGA_J], math.sqrt(variance[OMEGA_J]), x[THETA_J]) + x[FRICTION_J]
    return motor, jaw


@inlined
def acting_on(p: Physics, d: Series, row: int, x: Vector, variance: Vector, elastic_slope: float) -> Acting:
    """Return what acts from a row to the next; `x` and `variance`: of the filter's state there."""
    friction = friction_on(p, d, row, x, variance)
    load_slope = x[LOAD_SLOPE] + elastic_slope
    first = row * d.samples
    time_s = d.begin_s + row * d.period_s
    return Acting(time_s, d.command_A, first, x[COMMAND_BIAS], x[LOAD], load_slope, friction[0], friction[1])


@inlined
def near_standstill(first: float, last: float, deviation: float) -> bool:
    """Tell whether a speed's sign isn't sure over a row."""
    return first * last <= 0.0 or min(abs(first), abs(last)) < _SURE * deviation


@inlined
def _considered(d: Series, row: int, channel: int, sticks: bool, calm: bool, out: Flags) -> bool:
    """Mark the states of which a measurement is no evidence; tell whether there are any.

    Friction that holds a mass is the same for seconds, and wanders within its level by name only: what constants it
    seems to tell would be its own mean. The same holds of the load, which its own sensor tells, until the wire is
    calm again. So they are considered there, not estimated (Schmidt's filter).
    """
    load = not calm and channel != LOAD_CELL and not math.isnan(d.load_N_m[row])
    out[COMMAND_BIAS], out[JAW_ZERO] = sticks and channel != CURRENT, sticks
    out[LOAD], out[LOAD_SLOPE] = load, load
    return sticks or load


@inlined
def _sticks(d: Series, row: int, doubtful: bool) -> bool:
    """Tell whether dry friction may hold a mass, or did so a row before."""
    level_m, level_j = d.friction_level_N_m
    before = max(row - 1, 0)
    motor = d.friction_free_m[row] or d.friction_free_m[before]
    jaw = d.friction_free_j[row] or d.friction_free_j[before]
    return doubtful or (motor and level_m > 0.0) or (jaw and level_j > 0.0)


@inlined
def _measurements(
    p: Physics,
    d: Series,
    row: int,
    now_A: float,
    before_A: float,
    x: Vector,
    covariance: Matrix,
    f: Matrix,
    sticks: bool,
    calm: bool,
    considered: Flags,
    out: Filtered,
) -> bool:
    """Take a row's measurements in, one after the other; tell whether one of them was a surprise.

    A current that was not commanded leaves open how much of it drove the motor since the row before.
    """
    along = np.empty(STATES)
    surprise = False
    for place in range(CHANNELS):
        channel = (place + CURRENT) % CHANNELS  # the current first: what else moved the motor, is known by it
        if math.isnan(measured(d, channel, row)):
            continue
        if channel == CURRENT:
            variance = current_direction(covariance, 1.0 + p.current_gain_relative_error, along)
        else:
            variance = direction(channel, covariance, along)
        shown = predicted(p, channel, x, now_A, before_A, d.period_s)
        log_likelihood, score, information = evidence(d, channel, row, shown, variance)
        root = math.sqrt(information)
        # Far within a count both are next to nothing, and their quotient is noise of rounding.
        telling = channel != ENCODER or information * (variance + d.encoder_variance[row]) > 1e-12
        residual = score / root if telling else 0.0
        out.weight[row, channel], out.residual[row, channel] = root, residual
        out.log_likelihood[row, channel] = log_likelihood
        for i in range(STATES):
            out.gain[row, channel, i] = along[i] * information
        if _considered(d, row, channel, sticks, calm, considered):
            corrected_but(considered, x, covariance, along, score, information, out.gain[row, channel])
        else:
            corrected(x, covariance, along, score, information)
        if channel == CURRENT and abs(residual) > SURPRISE:
            error_A = residual / root / (1.0 + p.current_gain_relative_error)
            spread(covariance, f, FRICTION_M, (p.K_t * error_A) ** 2)
        surprise = surprise or (abs(residual) > SURPRISE and channel != CURRENT)
    return surprise


@inlined
def _friction(d: Series, row: int, was: tuple[bool, bool], x: Vector, covariance: Matrix) -> tuple[bool, bool]:
    """Begin or end the stretches where a mass may stick; return where it may, motor and jaw."""
    free_m, free_j = d.friction_free_m[row], d.friction_free_j[row]
    if not (free_m and was[0]):
        forgotten(covariance, FRICTION_M)
        x[FRICTION_M] = 0.0
    if not (free_j and was[1]):
        forgotten(covariance, FRICTION_J)
        x[FRICTION_J] = 0.0
    return free_m, free_j


@inlined
def _friction_noise(
    d: Series,
    row: int,
    free: tuple[bool, bool],
    x: Vector,
    ahead: tuple[float, float],
    variance: Vector,
    usual: Vector,
    f: Matrix,
    kept: float,
    covariance: Matrix,
) -> int:
    """Add what dry friction leaves open over a row; return which masses came near standstill though taken to slide.

    `ahead`: speeds at the next row; `usual`: deviations of both speeds while they slide. What they are here would not
    do: doubt makes speeds uncertain, and uncertain speeds make doubt.
    """
    doubtful = 0
    for mass in range(2):
        level = d.friction_level_N_m[mass]
        column, speed = (FRICTION_M, OMEGA_M) if mass == 0 else (FRICTION_J, OMEGA_J)
        if free[mass]:
            freed(covariance, column, level, kept)
            continue
        deviation = math.sqrt(variance[speed])
        if d.switching.given:
            doubts = d.switching.doubtful[row] & (1 + mass) != 0
        else:
            doubts = level > 0.0 and near_standstill(x[speed], ahead[mass], min(deviation, usual[mass]))
        if doubts:
            doubtful += 1 + mass
            spread(covariance, f, column, level**2)
    return doubtful


@kernel
def sliding_deviations(p: Physics, d: Series, f: Matrix, jump: Matrix, kept: Vector) -> Vector:
    """Return the deviations of both speeds that the filter settles at while both masses slide.

    A count is taken as white noise of its rounding there, and the load to change as it mostly does.
    """
    covariance, work = np.diag(d.first_variance), np.empty((STATES, STATES))
    along, x, settled = np.empty(STATES), np.zeros(STATES), np.zeros(2)
    usual_row = np.argsort(d.load_slope_variance + d.load_jump_variance / d.period_s**2)[d.encoder_rad.size // 2]
    for _ in range(_SETTLING_ROWS):
        for channel in range(CURRENT):
            if math.isnan(measured(d, channel, usual_row)):
                continue
            variance = direction(channel, covariance, along)
            noise = d.count_rad**2 / 12.0 + d.encoder_variance[usual_row]
            if channel != ENCODER:
                noise = d.noise_variance[channel - 1] * (1.0 if d.noise_correlation[channel - 1] == 0.0 else 0.01)
            information = 1.0 / (variance + noise)
            corrected(x, covariance, along, 0.0, information)
        settled[0], settled[1] = math.sqrt(covariance[OMEGA_M, OMEGA_M]), math.sqrt(covariance[OMEGA_J, OMEGA_J])
        moved(f, covariance, kept, work)
        disturbed(covariance, d, usual_row, f, jump, p.K_t)
    return settled


@kernel
def filter_pass(plants: Regimes, d: Series, out: Filtered) -> None:
    """Fill `out`."""
    p = plants[0]
    s = steppers(plants, d.period_s, d.samples)
    taut, slack = transition(p, d.period_s, True), transition(p, d.period_s, False)
    jump = jump_covariance(p, d.period_s)
    kept = noise_kept(d, friction_kept(d.period_s))
    level_m, level_j = d.friction_level_N_m
    x, covariance = d.first_state.copy(), np.diag(d.first_variance)
    work, touching = np.empty((STATES, STATES)), np.empty((STATES, STATES))
    covariance[FRICTION_M, FRICTION_M], covariance[FRICTION_J, FRICTION_J] = level_m**2, level_j**2
    plant = first_plant(d)
    before_A = plant.current_A
    was = (True, True)
    considered, calm_rows = np.zeros(STATES, dtype=np.bool_), 0
    usual = sliding_deviations(p, d, taut, jump, kept)
    for row in range(d.encoder_rad.size):
        _note_prediction(out.course, row, x, plant.current_A, before_A)
        sticks = _sticks(d, row, row > 0 and out.doubtful[row - 1] > 0)
        calm_rows = 0 if sticks else calm_rows + 1
        calm = calm_rows > d.fading_rows
        surprised = _measurements(
            p, d, row, plant.current_A, before_A, x, covariance, taut, sticks, calm, considered, out
        )
        out.surprised[row] = d.switching.surprised[row] if d.switching.given else surprised
        if out.surprised[row]:
            covariance[LOAD_SLOPE, LOAD_SLOPE] += d.load_surprise_variance
        was = _friction(d, row, was, x, covariance)
        for i in range(STATES):
            out.course[row, i], out.variance[row, i] = x[i], covariance[i, i]
        if row == d.encoder_rad.size - 1:
            break
        before_A = plant.current_A
        begin = beginning(plant, x)
        plant = advance_in(plants, s, was[0], was[1], begin, acting_on(p, d, row, x, out.variance[row], 0.0))
        f = slack if is_slack(p, x) else taut
        elastic_slope = 0.0
        if d.contact_stiffness[row] > 0.0:
            elastic_slope = elastic_share(f, d.contact_stiffness[row], d.period_s) * (plant.theta_j_rad - x[THETA_J])
            stiffened(f, d.contact_stiffness[row], d.period_s, touching)
            f = touching
            acting = acting_on(p, d, row, x, out.variance[row], elastic_slope)
            plant = advance_in(plants, s, was[0], was[1], begin, acting)
        out.course[row, ELASTIC_SLOPE] = elastic_slope
        moved(f, covariance, kept, work)
        disturbed(covariance, d, row, f, jump, p.K_t)
        now, ahead = out.variance[row], (plant.omega_m_rad_per_s, plant.omega_j_rad_per_s)
        out.doubtful[row] = _friction_noise(d, row, was, x, ahead, now, usual, f, kept[FRICTION_M], covariance)
        for i in range(4, STATES):
            x[i] *= kept[i]
        x[LOAD] += d.period_s * (x[LOAD_SLOPE] + elastic_slope)
        x[THETA_M], x[OMEGA_M] = plant.theta_m_rad, plant.omega_m_rad_per_s
        x[THETA_J], x[OMEGA_J] = plant.theta_j_rad, plant.omega_j_rad_per_s


@inlined
def is_slack(p: Physics, x: Vector) -> bool:
    """Tell whether the wire of a plant with a dead zone is in it."""
    return (
        p.wire_slack_half_width_m > 0.0
        and abs(p.r_m * x[THETA_M] - p.r_j * x[THETA_J] - p.wire_permanent_stretch_stretch_m)
        < p.wire_slack_half_width_m
    )


@kernel
def _note_prediction(course: Matrix, row: int, x: Vector, current_A: float, before_A: float) -> None:
    course[row, PREDICTED_THETA_M], course[row, PREDICTED_OMEGA_M] = x[THETA_M], x[OMEGA_M]
    course[row, PREDICTED_THETA_J], course[row, PREDICTED_OMEGA_J] = x[THETA_J], x[OMEGA_J]
    course[row, PREDICTED_LOAD_SLOPE], course[row, PREDICTED_CURRENT] = x[LOAD_SLOPE], current_A
    course[row, CURRENT_BEFORE] = before_A


def filter_run(plants: Regimes, d: Series) -> Filtered:
    """Return one pass over a run."""
    n = d.encoder_rad.size
    out = Filtered(
        np.zeros((n, CHANNELS)),
        np.zeros((n, CHANNELS)),
        np.zeros((n, CHANNELS)),
        np.zeros((n, CHANNELS, STATES)),
        np.zeros((n, COURSE)),
        np.zeros((n, STATES)),
        np.zeros(n, dtype=np.int64),
        np.zeros(n, dtype=np.bool_),
    )
    filter_pass(plants, d, out)
    return out
