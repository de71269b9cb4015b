"""The truth plant with effects in time: friction that holds and lets go, commands that arrive late, edges of the load.

The numbers of one forceps live in two arrays that `advance_with_effects` changes in place: `state`, in the order of
`effects_start.STATE`, and the queue of commands under way.
"""

import math

import numpy as np
from numpy.typing import NDArray

from virtual_bus.effects.command import Queue
from virtual_bus.effects.composition import EffectNumbers, motor_friction_N_m
from virtual_bus.effects.physics import (
    Environment,
    Inputs,
    Memory,
    Motion,
    behind_at,
    current_at,
    elongation_of,
    jaw_drive,
    jaw_level,
    motor_drive,
    runge_kutta,
    slipped,
    tension_of,
)
from virtual_bus.kernel import kernel, subroutine
from virtual_bus.plant.load import load_at, segment_of
from virtual_bus.plant.plant import TruthParameters

MAX_EVENTS = 4  # of friction in one step; a body that changes its mind more often is held for the rest of it
ROOT_ITERATIONS = 4


@subroutine
def side_of(drive_N_m: float, forward_N_m: float, backward_N_m: float) -> float:
    """Return where a body at rest goes under a torque: ±1, or 0 while friction holds it; without friction it's free."""
    if drive_N_m > forward_N_m or forward_N_m + backward_N_m == 0.0:
        return 1.0
    if drive_N_m < -backward_N_m:
        return -1.0
    return 0.0


@subroutine
def released(
    m: Motion,
    memory: Memory,
    u: Inputs,
    offset_s: float,
    holds_m: bool,
    holds_j: bool,
    p: TruthParameters,
    e: EffectNumbers,
    env: Environment,
) -> Memory:
    """Let go of each body at rest that is driven by more than its friction, unless it is to be held.

    A body that moves is braked on the side to which it moves: without friction it turns round with no event.
    """
    side_m, side_j = memory.side_m, memory.side_j
    if m.omega_m * side_m > 0.0 and m.omega_j * side_j > 0.0:
        return memory
    tension = tension_of(m, memory, p, e)
    if m.omega_m != 0.0:
        side_m = math.copysign(1.0, m.omega_m)
    elif side_m == 0.0 and not holds_m:
        drive = motor_drive(m, memory, current_at(u, offset_s), u.time_s + offset_s, tension, p, e)
        side_m = side_of(
            drive, motor_friction_N_m(p, e, 1.0, 0.0, tension), motor_friction_N_m(p, e, -1.0, 0.0, tension)
        )
    if m.omega_j != 0.0:
        side_j = math.copysign(1.0, m.omega_j)
    elif side_j == 0.0 and not holds_j:
        drive = jaw_drive(m.theta_j, m.omega_j, memory, tension, u.load_N_m + u.load_slope * offset_s, p, e, env)
        level = jaw_level(m.theta_j, p, e)
        side_j = side_of(drive, level, level)
    return Memory(
        memory.theta_m, memory.theta_j, memory.elongation, memory.presliding, memory.hysteresis, side_m, side_j,
        memory.behind, memory.loaded, memory.gripped,
    )  # fmt: skip


@subroutine
def remembered(m: Motion, memory: Memory, side_m: float, side_j: float, p: TruthParameters, e: EffectNumbers) -> Memory:
    """Return the memory at the end of a way."""
    behind = behind_at(m, memory, e)
    x = elongation_of(m.theta_m - behind, m.theta_j, p, e)
    presliding, hysteresis, loaded, gripped = 0.0, 0.0, 0.0, 0.0
    if e.presliding_friction_level_N_m != 0.0:
        presliding = slipped(memory.presliding, m.theta_m - memory.theta_m, e.presliding_friction_angle_rad)
    if e.wire_hysteresis_force_N != 0.0:
        hysteresis = slipped(memory.hysteresis, x - memory.elongation, e.wire_hysteresis_stretch_m)
    if e.loaded_presliding_mu != 0.0:
        loaded = slipped(memory.loaded, m.theta_m - memory.theta_m, e.loaded_presliding_angle_rad)
    if e.jaw_presliding_level_N_m != 0.0 or e.jaw_presliding_mu != 0.0:
        gripped = slipped(memory.gripped, m.theta_j - memory.theta_j, e.jaw_presliding_angle_rad)
    return Memory(m.theta_m, m.theta_j, x, presliding, hysteresis, side_m, side_j, behind, loaded, gripped)


@subroutine
def forward_speed(m: Motion, memory: Memory, first: bool) -> float:
    """Return the speed of the motor (`first`) or jaw to the side on which friction brakes it."""
    return memory.side_m * m.omega_m if first else memory.side_j * m.omega_j


@subroutine
def has_friction(m: Motion, memory: Memory, first: bool, p: TruthParameters, e: EffectNumbers) -> bool:
    """Whether dry friction acts on the motor (`first`) or jaw near standstill, to either side."""
    if not first:
        return jaw_level(m.theta_j, p, e) > 0.0
    tension = tension_of(m, memory, p, e)
    return motor_friction_N_m(p, e, 1.0, 0.0, tension) + motor_friction_N_m(p, e, -1.0, 0.0, tension) > 0.0


@subroutine
def time_to_rest(
    m: Motion,
    memory: Memory,
    u: Inputs,
    offset_s: float,
    step_s: float,
    end: Motion,
    first: bool,
    p: TruthParameters,
    e: EffectNumbers,
    env: Environment,
) -> float:
    """Return when, within the step that ends at `end`, a body comes to rest: false position (Illinois)."""
    low, high = 0.0, step_s
    speed_low, speed_high = forward_speed(m, memory, first), forward_speed(end, memory, first)
    for _ in range(ROOT_ITERATIONS):
        middle = (low * speed_high - high * speed_low) / (speed_high - speed_low)
        speed = forward_speed(runge_kutta(m, memory, u, offset_s, middle, p, e, env), memory, first)
        if speed > 0.0:
            low, speed_low, speed_high = middle, speed, 0.5 * speed_high
        elif speed < 0.0:
            high, speed_high, speed_low = middle, speed, 0.5 * speed_low
        else:
            return middle
    return (low * speed_high - high * speed_low) / (speed_high - speed_low)


@subroutine
def glide(
    m: Motion,
    memory: Memory,
    u: Inputs,
    offset_s: float,
    step_s: float,
    p: TruthParameters,
    e: EffectNumbers,
    env: Environment,
) -> tuple[Motion, Memory]:
    """One step, cut where a body comes to rest: there it stays, or turns round."""
    left, holds_m, holds_j = step_s, False, False
    for event in range(MAX_EVENTS + 1):
        memory = released(m, memory, u, offset_s, holds_m, holds_j, p, e, env)
        end = runge_kutta(m, memory, u, offset_s, left, p, e, env)
        stops_m = forward_speed(end, memory, True) < 0.0 and has_friction(end, memory, True, p, e)
        stops_j = forward_speed(end, memory, False) < 0.0 and has_friction(end, memory, False, p, e)
        if not (stops_m or stops_j):
            break
        # A body that was just let go and comes back at once was let go for nothing.
        holds_m = holds_m or (stops_m and (m.omega_m == 0.0 or event == MAX_EVENTS - 1))
        holds_j = holds_j or (stops_j and (m.omega_j == 0.0 or event == MAX_EVENTS - 1))
        time_m = time_to_rest(m, memory, u, offset_s, left, end, True, p, e, env) if stops_m else left
        time_j = time_to_rest(m, memory, u, offset_s, left, end, False, p, e, env) if stops_j else left
        part = min(time_m, time_j)
        m = runge_kutta(m, memory, u, offset_s, part, p, e, env)
        rests_m, rests_j = stops_m and time_m <= part, stops_j and time_j <= part
        m = Motion(m.theta_m, 0.0 if rests_m else m.omega_m, m.theta_j, 0.0 if rests_j else m.omega_j, m.creep)
        memory = remembered(m, memory, 0.0 if rests_m else memory.side_m, 0.0 if rests_j else memory.side_j, p, e)
        offset_s += part
        left -= part
        end = m
    return end, remembered(end, memory, memory.side_m, memory.side_j, p, e)


@kernel
def between(left: float, left_rate: float, right: float, right_rate: float, share: float, step_s: float) -> float:
    """Return the cubic through both ends of a step with their rates, at a share of it."""
    if share >= 1.0:
        return right
    rest = 1.0 - share
    rise = right - left
    bend = share * rest * (rest * (left_rate * step_s - rise) - share * (right_rate * step_s - rise))
    return left + share * rise + bend


@subroutine
def fill_taps(
    taps: NDArray[np.float64],
    tap_ns: NDArray[np.int64],
    left_ns: int,
    right_ns: int,
    step: int,
    step_s: float,
    before: Motion,
    after: Motion,
    u: Inputs,
) -> None:
    """Write down each tap that lies in this step of the segment from `left_ns` to `right_ns`."""
    for c in range(tap_ns.size):
        if tap_ns[c] <= left_ns or tap_ns[c] > right_ns:
            continue
        share = ((tap_ns[c] - left_ns) * 1.0e-9 - step * step_s) / step_s
        if abs(share - 0.5) > 0.5 + 1.0e-9:
            continue
        if c == 0:
            taps[c] = between(before.theta_m, before.omega_m, after.theta_m, after.omega_m, share, step_s)
        elif c == 1:
            taps[c] = current_at(u, (step + share) * step_s)
        else:
            taps[c] = between(before.theta_j, before.omega_j, after.theta_j, after.omega_j, share, step_s)


@kernel
def unpacked(state: NDArray[np.float64], p: TruthParameters, e: EffectNumbers) -> tuple[Motion, Memory]:
    """Return motion and memory of a state in the order of `effects_start.STATE`."""
    m = Motion(state[0], state[1], state[2], state[3], state[4])
    x = elongation_of(m.theta_m - state[11], m.theta_j, p, e)
    memory = Memory(
        m.theta_m, m.theta_j, x, state[5], state[6], state[7], state[8], state[11], state[12], state[13]
    )  # fmt: skip
    return m, memory


@kernel
def advance_with_effects(
    state: NDArray[np.float64],
    queue: Queue,
    p: TruthParameters,
    e: EffectNumbers,
    env: Environment,
    load_time_ns: NDArray[np.int64],
    load_N_m: NDArray[np.float64],
    start_ns: int,
    end_ns: int,
    max_step_s: float,
    tap_ns: NDArray[np.int64],
    taps: NDArray[np.float64],
) -> None:
    """Move `state` and `queue` in place from `start_ns` to `end_ns` of the load's time.

    Steps are cut at edges of the load and where a command arrives. `taps` gets θ_m, i, θ_j and again θ_j as they
    were at the times `tap_ns` (in `start_ns` < t <= `end_ns`; the current from before a change at that time).
    """
    m, memory = unpacked(state, p, e)
    target, current = state[9], state[10]
    tally, room = queue.tally, queue.due_ns.size
    left_ns = start_ns
    while left_ns < end_ns:
        right_ns = end_ns
        while tally[2] > 0 and queue.due_ns[tally[1]] <= tally[0]:
            target = queue.command_A[tally[1]]
            tally[1], tally[2] = (tally[1] + 1) % room, tally[2] - 1
        if tally[2] > 0:
            right_ns = min(right_ns, left_ns + queue.due_ns[tally[1]] - tally[0])
        segment = segment_of(load_time_ns, left_ns)
        if segment < load_time_ns.size:
            right_ns = min(right_ns, load_time_ns[segment])
        span_s = (right_ns - left_ns) * 1.0e-9
        load = load_at(load_time_ns, load_N_m, segment, left_ns)
        slope = (load_at(load_time_ns, load_N_m, segment, right_ns) - load) / span_s
        u = Inputs(
            target, current, e.electrical_lag_time_constant_s, load, slope, max(left_ns, -1_000_000_000_000) * 1.0e-9
        )
        steps = max(math.ceil(span_s / max_step_s - 1.0e-6), 1)
        step_s = span_s / steps
        for i in range(steps):
            before = m
            m, memory = glide(m, memory, u, i * step_s, step_s, p, e, env)
            fill_taps(taps, tap_ns, left_ns, right_ns, i, step_s, before, m, u)
        current = current_at(u, span_s)
        tally[0] += right_ns - left_ns
        left_ns = right_ns
    state[0], state[1], state[2], state[3], state[4] = m.theta_m, m.omega_m, m.theta_j, m.omega_j, m.creep
    state[5], state[6], state[7], state[8] = memory.presliding, memory.hysteresis, memory.side_m, memory.side_j
    state[9], state[10], state[11] = target, current, memory.behind
    state[12], state[13] = memory.loaded, memory.gripped
