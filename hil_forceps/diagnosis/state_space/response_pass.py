"""How the innovations of a pass answer to other parameters: linear, along its course, with its gains.

What other parameters drive is found by the model's own step from near each state of the course, so that every effect of
the catalogue with its memory is in it. How the filter then follows that, is its own gains: whatever it forgives
(starts, holds, noise of the load, counting) is forgiven here. The course at a row is made of rows up to it,
so under the model innovations behind it are uncorrelated with these answers, and their score has no bias.
"""

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.advance import advance, stepper
from hil_forceps.diagnosis.state_space.drive.between_rows import answered, ended
from hil_forceps.diagnosis.state_space.drive.sample import derivative_left, sampled
from hil_forceps.diagnosis.state_space.kernel import as_its_caller, inlined, run_kernel
from hil_forceps.diagnosis.state_space.layout import (
    BETWEEN,
    CHANNELS,
    COMMAND_ERROR,
    CURRENT,
    CURRENT_BEFORE,
    CURRENT_NOISE,
    DERIVATIVE_ERROR,
    ELASTIC_SLOPE,
    ELONGATION_DEVIATION,
    ENCODER,
    INTEGRAL_ERROR,
    JAW,
    JAW_NOISE,
    JAW_ZERO,
    LAW_STATES,
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
    RECORDED_STATES,
    THETA_J,
    THETA_M,
    Filtered,
    Series,
)
from hil_forceps.diagnosis.state_space.measurement import late_s
from hil_forceps.diagnosis.state_space.memory import beginning, following, no_memory, sure_ways
from hil_forceps.diagnosis.state_space.row_plant import (
    acting_on,
    end_friction,
    first_plant,
    is_slack,
    may_hold,
    noise_kept,
)
from hil_forceps.diagnosis.state_space.transition import elastic_share, transition
from hil_forceps.model.composition import Physics, encoder_rad

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@inlined
def _shown(p: Physics, d: Series, channel: int, at: Vector, current_A: float, before_A: float) -> float:
    """Return what a channel shows of a row's prediction, without the nuisances that are alike for all parameters."""
    late = late_s(p, d, channel)
    if channel == ENCODER:
        value: float = encoder_rad(p, at[PREDICTED_THETA_M]) - late * at[PREDICTED_OMEGA_M]
    elif channel == JAW:
        value = -late * at[PREDICTED_OMEGA_J]
    elif channel == LOAD_CELL:
        value = -late * at[PREDICTED_LOAD_SLOPE]
    else:
        recorded_A = current_A - late / d.period_s * (current_A - before_A)
        value = (1.0 + p.current_gain_relative_error) * recorded_A + p.current_offset_offset_A
    return value


@inlined
def _change_shown(p: Physics, d: Series, channel: int, x: Vector) -> float:
    """Return what a channel shows of a change of the state; the current's is in the plant already."""
    late = late_s(p, d, channel)
    if channel == ENCODER:
        value: float = x[THETA_M] - late * x[OMEGA_M]
    elif channel == JAW:
        value = x[THETA_J] + x[JAW_ZERO] + x[JAW_NOISE] - late * x[OMEGA_J]
    elif channel == LOAD_CELL:
        value = x[LOAD] + x[LOAD_NOISE] - late * x[LOAD_SLOPE]
    else:
        value = x[CURRENT_NOISE]
    return value


@run_kernel
def response_pass(
    p: Physics,
    base: Physics,
    d: Series,
    filtered: Filtered,
    per: float,
    commands_A: Vector,
    out: Matrix,
) -> None:
    """Fill `out` (n × CHANNELS) with the change of the whitened innovations from `base` to `p`, times `per`.

    `commands_A`: a copy of the pass's commands, to be changed.

    The state's change is carried as a small one, by the step of the plant: where a mass stops, it is held in both.
    """
    s, course, share = stepper(p, d.period_s, d.samples), filtered.course, 1.0 / per
    taut, slack = transition(base, d.period_s, True), transition(base, d.period_s, False)
    kept = noise_kept(d, d.samples)
    plant = first_plant(d)
    x, near, memory = np.zeros(d.states), np.zeros(d.states), no_memory(p, d.first_state)
    before_A = plant.current_A
    for row in range(d.encoder_rad.size):
        at = course[row]
        for place in range(CHANNELS):
            channel = (place + CURRENT) % CHANNELS
            change = _shown(p, d, channel, at, plant.current_A, before_A)
            change -= _shown(base, d, channel, at, at[PREDICTED_CURRENT], at[CURRENT_BEFORE])
            change = change * per + _change_shown(base, d, channel, x)
            out[row, channel] = -change * filtered.weight[row, channel]
            for i in range(d.states):
                x[i] -= filtered.gain[row, channel, i] * change
        if row == d.encoder_rad.size - 1:
            break
        before_A = plant.current_A
        end_friction(d, row, x)
        there = course[row + 1]
        # What the next current tells of counts moves the state before the plant goes on from it.
        if d.states > RECORDED_STATES:
            shift = per * (encoder_rad(p, at[THETA_M]) - encoder_rad(base, at[THETA_M]))
            shown_A = _shown(p, d, CURRENT, there, there[PREDICTED_CURRENT], there[CURRENT_BEFORE])
            shown_A -= _shown(base, d, CURRENT, there, there[PREDICTED_CURRENT], there[CURRENT_BEFORE])
            _sample_answer(d, filtered, row, 0, shift, per * shown_A, x)
        for i in range(d.states):
            near[i] = at[i] + share * x[i]
        sure = sure_ways(d, row, filtered.variance[row], at[ELONGATION_DEVIATION])
        memory = following(p, memory, near, sure)
        plant = beginning(p, memory, plant, near, sure)
        acting = acting_on(p, d, row, near, filtered.variance[row], at[ELASTIC_SLOPE])
        for sample in range(d.samples):
            if d.states > RECORDED_STATES and sample > 0:
                _sample_answer(d, filtered, row, sample, 0.0, 0.0, x)
            at_sample = row * d.samples + sample
            commands_A[at_sample] += share * x[COMMAND_ERROR] * (1.0 if filtered.reacts[at_sample] else 0.0)
            plant = advance(p, s, may_hold(d, row, 0), may_hold(d, row, 1), plant, acting, commands_A, sample)
        before_rad = x[THETA_J]
        x[LOAD] += d.period_s * x[LOAD_SLOPE]
        for i in range(PLANT_STATES, d.states):
            x[i] *= kept[i]
        x[THETA_M] = per * (plant.theta_m_rad - there[PREDICTED_THETA_M])
        x[OMEGA_M] = per * (plant.omega_m_rad_per_s - there[PREDICTED_OMEGA_M])
        x[THETA_J] = per * (plant.theta_j_rad - there[PREDICTED_THETA_J])
        x[OMEGA_J] = per * (plant.omega_j_rad_per_s - there[PREDICTED_OMEGA_J])
        f = slack if is_slack(base, at) else taut
        _answer_of_contact(f, d.contact_stiffness[row], d.period_s, before_rad, x)


@as_its_caller
def sample_answers(
    d: Series,
    filtered: Filtered,
    row: int,
    sample: int,
    shift_rad: float | Vector,
    shown_A: float | Vector,
    x: Vector | Matrix,
) -> None:
    """Carry a change of the state over a sample of the drive; many changes have a column each.

    `shift_rad`: the encoder shows so much more of it; `shown_A`: the next row's current sensor so much more of its
    current. Both are for the first sample, behind a row's measurements.
    """
    reacts = filtered.reacts[row * d.samples + sample]
    if sample == 0:
        sampled(d.law, filtered.count_slope[row] * (x[THETA_M] + shift_rad), reacts, x)
    else:
        sampled(d.law, 0.0 * shift_rad, reacts, x)
    if d.states > LAW_STATES:
        if sample == 0:
            if filtered.between.directions[row, 0, THETA_M] != 0.0:
                acts = 1.0 if filtered.reacts[row * d.samples + d.samples - 1] else 0.0
                left, kept = derivative_left(d.law, d.samples - 1), d.noise_correlation[CURRENT - 1]
                expected_A = acts * (x[INTEGRAL_ERROR] + left * x[DERIVATIVE_ERROR]) + kept * x[CURRENT_NOISE]
                answered(filtered.between, row, shift_rad, -expected_A - shown_A, x)
            else:
                x[BETWEEN:] = 0.0
        if reacts:
            x[COMMAND_ERROR] += x[BETWEEN + sample]
        if sample == d.samples - 1:
            ended(x)


@inlined
def _sample_answer(
    d: Series, filtered: Filtered, row: int, sample: int, shift_rad: float, shown_A: float, x: Vector
) -> None:
    """Carry one change of the state over a sample of the drive: numbers, for which no array is made."""
    sample_answers(d, filtered, row, sample, shift_rad, shown_A, x)


@as_its_caller
def answers_of_contact(f: Matrix, stiffness: float, period_s: float, before_rad: float | Vector, after: Vector) -> None:
    """Add to a change of the state a row on what a load that answers to the jaw's angle makes of it.

    `before_rad`: the jaw's change at the row before; many changes at once have a column each.
    """
    if stiffness > 0.0:
        slope = elastic_share(f, stiffness, period_s) * (after[THETA_J] - before_rad)
        for i in range(PLANT_STATES):
            after[i] += f[i, LOAD_SLOPE] * slope
        after[LOAD] += period_s * slope


@inlined
def _answer_of_contact(f: Matrix, stiffness: float, period_s: float, before_rad: float, after: Vector) -> None:
    """Add what such a load makes of one change of the state: numbers, for which no array is made."""
    answers_of_contact(f, stiffness, period_s, before_rad, after)


def response_run(p: Physics, base: Physics, d: Series, f: Filtered, per: float) -> Matrix:
    """Return the change of a run's whitened innovations (n × CHANNELS) from `base` to `p`, times `per`."""
    out = np.zeros_like(f.residual)
    response_pass(p, base, d, f, per, f.command_A.copy(), out)
    return out
