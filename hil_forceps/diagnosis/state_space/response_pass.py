"""How the innovations of a pass answer to other parameters: linear, along its course, with its gains.

What other parameters drive is found by the model's own step from each state of the course, so that every effect of the
catalogue with its memory is in it. How the filter then follows that, is its own transition and gains: whatever it
forgives (starts, holds, noise of the load, counting) is forgiven here. The course at a row is made of rows up to it,
so under the model innovations behind it are uncorrelated with these answers, and their score has no bias.
"""

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.advance import Regimes, advance_in, steppers
from hil_forceps.diagnosis.state_space.filter_pass import acting_on, beginning, first_plant, is_slack, noise_kept
from hil_forceps.diagnosis.state_space.kernel import inlined, kernel
from hil_forceps.diagnosis.state_space.layout import (
    CHANNELS,
    COMMAND_BIAS,
    CURRENT,
    CURRENT_BEFORE,
    ELASTIC_SLOPE,
    ENCODER,
    FRICTION_J,
    FRICTION_M,
    JAW,
    JAW_NOISE,
    JAW_ZERO,
    LOAD,
    LOAD_CELL,
    LOAD_NOISE,
    LOAD_SLOPE,
    OMEGA_J,
    OMEGA_M,
    PLANT_STATES,
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
from hil_forceps.diagnosis.state_space.transition import elastic_share, friction_kept, transition
from hil_forceps.model.composition import Physics, encoder_rad

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_COUPLED = COMMAND_BIAS + 1


@inlined
def _shown(p: Physics, channel: int, at: Vector, current_A: float, before_A: float, period_s: float) -> float:
    """Return what a channel shows of a row's prediction, without the nuisances that are alike for all parameters."""
    if channel == ENCODER:
        value: float = encoder_rad(p, at[PREDICTED_THETA_M]) - p.channel_skew_theta_m_s * at[PREDICTED_OMEGA_M]
    elif channel == JAW:
        value = -p.channel_skew_theta_j_s * at[PREDICTED_OMEGA_J]
    elif channel == LOAD_CELL:
        value = -p.channel_skew_tau_w_s * at[PREDICTED_LOAD_SLOPE]
    else:
        late = current_A - p.channel_skew_current_s / period_s * (current_A - before_A)
        value = (1.0 + p.current_gain_relative_error) * late + p.current_offset_offset_A
    return value


@inlined
def _change_shown(channel: int, gain: float, x: Vector) -> float:
    """Return what a channel shows of a change of the state."""
    if channel == ENCODER:
        value: float = x[THETA_M]
    elif channel == JAW:
        value = x[THETA_J] + x[JAW_ZERO] + x[JAW_NOISE]
    elif channel == LOAD_CELL:
        value = x[LOAD] + x[LOAD_NOISE]
    else:
        value = gain * x[COMMAND_BIAS] + x[STATES - 1]
    return value


@kernel
def response_pass(
    plants: Regimes,
    base: Physics,
    d: Series,
    weight: Matrix,
    gain: Matrix,
    course: Matrix,
    variance: Matrix,
    per: float,
    out: Matrix,
) -> None:
    """Fill `out` (n × CHANNELS) with the change of the whitened innovations from `base` to `plants`, times `per`."""
    p = plants[0]
    s = steppers(plants, d.period_s, d.samples)
    taut, slack = transition(base, d.period_s, True), transition(base, d.period_s, False)
    kept = noise_kept(d, friction_kept(d.period_s))
    plant = first_plant(d)
    x, after = np.zeros(STATES), np.zeros(STATES)
    before_A = plant.current_A
    was_m, was_j = True, True
    for row in range(d.encoder_rad.size):
        at = course[row]
        for place in range(CHANNELS):
            channel = (place + CURRENT) % CHANNELS
            change = _shown(p, channel, at, plant.current_A, before_A, d.period_s)
            change -= _shown(base, channel, at, at[PREDICTED_CURRENT], at[CURRENT_BEFORE], d.period_s)
            change = change * per + _change_shown(channel, 1.0 + base.current_gain_relative_error, x)
            out[row, channel] = -change * weight[row, channel]
            for i in range(STATES):
                x[i] -= gain[row, channel, i] * change
        if row == d.encoder_rad.size - 1:
            break
        before_A = plant.current_A
        free_m, free_j = d.friction_free_m[row], d.friction_free_j[row]
        if not (free_m and was_m):
            x[FRICTION_M] = 0.0
        if not (free_j and was_j):
            x[FRICTION_J] = 0.0
        was_m, was_j = free_m, free_j
        acting = acting_on(p, d, row, at, variance[row], at[ELASTIC_SLOPE])
        plant = advance_in(plants, s, free_m, free_j, beginning(plant, at), acting)
        f = slack if is_slack(base, at) else taut
        _carried(f, x, after, d.period_s, kept)
        there = course[row + 1]
        after[THETA_M] += per * (plant.theta_m_rad - there[PREDICTED_THETA_M])
        after[OMEGA_M] += per * (plant.omega_m_rad_per_s - there[PREDICTED_OMEGA_M])
        after[THETA_J] += per * (plant.theta_j_rad - there[PREDICTED_THETA_J])
        after[OMEGA_J] += per * (plant.omega_j_rad_per_s - there[PREDICTED_OMEGA_J])
        answer_of_contact(f, d.contact_stiffness[row], d.period_s, x[THETA_J], after)
        x[:] = after


@inlined
def _carried(f: Matrix, x: Vector, after: Vector, period_s: float, kept: Vector) -> None:
    """Fill `after` with a change of the state a row on."""
    for i in range(PLANT_STATES):
        total = 0.0
        for j in range(_COUPLED):
            total += f[i, j] * x[j]
        after[i] = total
    for i in range(PLANT_STATES, STATES):
        after[i] = kept[i] * x[i]
    after[LOAD] += period_s * x[LOAD_SLOPE]


@inlined
def answer_of_contact(f: Matrix, stiffness: float, period_s: float, before_rad: float | Vector, after: Vector) -> None:
    """Add to a change of the state a row on what a load that answers to the jaw's angle makes of it.

    `before_rad`: the jaw's change at the row before; many changes at once have a column each.
    """
    if stiffness > 0.0:
        slope = elastic_share(f, stiffness, period_s) * (after[THETA_J] - before_rad)
        for i in range(PLANT_STATES):
            after[i] += f[i, LOAD_SLOPE] * slope
        after[LOAD] += period_s * slope


def response_run(plants: Regimes, base: Physics, d: Series, f: Filtered, per: float) -> Matrix:
    """Return the change of a run's whitened innovations (n × CHANNELS) from `base` to other `plants`, times `per`."""
    out = np.zeros_like(f.residual)
    response_pass(plants, base, d, f.weight, f.gain, f.course, f.variance, per, out)
    return out
