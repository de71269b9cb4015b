"""A whole run of the closed loop on the truth plant with effects, in one go: rows as an ideal logger would write them.

The drive's law is that of the rig file's description, on angles in rad; the simulated drive of the bus has its own in
the units of the wire.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from virtual_bus.effects.command import Queue, acting_command, empty_queue, push_command
from virtual_bus.effects.composition import EffectNumbers, encoder_angle
from virtual_bus.effects.motion import advance_with_effects, unpacked
from virtual_bus.effects.physics import Environment, jaw_load, tension_of
from virtual_bus.effects.start import STATE, check_step, rest_with_effects
from virtual_bus.kernel import kernel, run_kernel, subroutine
from virtual_bus.plant.load import LoadProfile, load_at, segment_of
from virtual_bus.plant.plant import TruthParameters
from virtual_bus.plant.position_loop import LoopParameters

TRUTH_COLUMNS = (*STATE, "tau_w_N_m", "elongation_m", "tension_N")


class Log(NamedTuple):
    """Rows at the instants of the drive's samples: what sensors give (without noise), and the truth."""

    theta_m_rad: NDArray[np.float64]  # encoder, quantised where it counts
    current_A: NDArray[np.float64]
    theta_j_rad: NDArray[np.float64]
    tau_w_N_m: NDArray[np.float64]
    truth: NDArray[np.float64]  # (rows, TRUTH_COLUMNS): before this sample's command
    rounding_rad: NDArray[np.float64]  # what counting added to the encoder's angle, at every sample of the drive


@kernel
def counted(angle: float, quantum: float) -> float:
    """Return the nearest multiple of the quantum; the angle itself without one."""
    if quantum <= 0.0:
        return angle
    count = math.floor(angle / quantum + 0.5)
    return count * quantum


@subroutine
def law_step(memory: NDArray[np.float64], error_rad: float, theta_enc: float, law: LoopParameters) -> float:
    """One sample of the drive's law, i_ref in A; `memory`: integral, last θ_enc, filtered speed."""
    gain = -math.expm1(-2.0 * math.pi * law.derivative_cutoff_Hz * law.sample_time_s)
    memory[2] += gain * ((theta_enc - memory[1]) / law.sample_time_s - memory[2])
    integral = memory[0] + (error_rad - law.cascade_time_s * memory[2]) * law.sample_time_s
    if law.ki_A_per_rad_s > 0.0:
        reach = law.current_limit_A / law.ki_A_per_rad_s
        integral = min(max(integral, -reach), reach)
    memory[0], memory[1] = integral, theta_enc
    wanted: float = law.kp_A_per_rad * error_rad + law.ki_A_per_rad_s * integral - law.kd_A_s_per_rad * memory[2]
    return min(max(wanted, -law.current_limit_A), law.current_limit_A)


@run_kernel
def run_loop(
    state: NDArray[np.float64],
    queue: Queue,
    p: TruthParameters,
    e: EffectNumbers,
    env: Environment,
    law: LoopParameters,
    quantum_rad: float,
    encoder_error_rad: NDArray[np.float64],
    reference_rad: NDArray[np.float64],
    load_time_ns: NDArray[np.int64],
    load_N_m: NDArray[np.float64],
    start_ns: int,
    period_ns: int,
    max_step_s: float,
    rest_ns: NDArray[np.int64],
    taps: NDArray[np.float64],
    truth: NDArray[np.float64],
) -> None:
    """Fill `truth` at each sample and `taps` with what was `rest_ns` before the end of the period after it."""
    memory = np.zeros(3)
    memory[1] = counted(encoder_angle(e, state[0]), quantum_rad) + encoder_error_rad[0]
    delay_ns = round(e.actuation_delay_delay_s * 1.0e9)
    columns = state.size
    for k in range(reference_rad.size):
        now_ns = start_ns + k * period_ns
        m, memory_here = unpacked(state, p, e)
        truth[k, :columns] = state
        load = load_at(load_time_ns, load_N_m, segment_of(load_time_ns, now_ns), now_ns)
        truth[k, columns] = jaw_load(m.theta_j, load, env)
        truth[k, columns + 1] = memory_here.elongation
        truth[k, columns + 2] = tension_of(m, memory_here, p, e)
        theta_enc = counted(encoder_angle(e, m.theta_m), quantum_rad) + encoder_error_rad[k]
        command = law_step(memory, reference_rad[k] - theta_enc, theta_enc, law)
        push_command(queue, acting_command(command, e), delay_ns)
        end_ns = now_ns + period_ns
        advance_with_effects(
            state, queue, p, e, env, load_time_ns, load_N_m, now_ns, end_ns, max_step_s, end_ns - rest_ns, taps[k]
        )


@kernel
def sense(theta_m: NDArray[np.float64], e: EffectNumbers, quantum_rad: float, theta_enc: NDArray[np.float64]) -> None:
    """Fill `theta_enc` with what the encoder says to each angle."""
    for k in range(theta_m.size):
        theta_enc[k] = counted(encoder_angle(e, theta_m[k]), quantum_rad)


@kernel
def sense_load(
    theta_j: NDArray[np.float64],
    time_ns: NDArray[np.int64],
    load_time_ns: NDArray[np.int64],
    load_N_m: NDArray[np.float64],
    env: Environment,
    tau_w: NDArray[np.float64],
) -> None:
    """Fill `tau_w` with the reaction torque at each time, the jaw being at this angle."""
    for k in range(theta_j.size):
        load = load_at(load_time_ns, load_N_m, segment_of(load_time_ns, time_ns[k]), time_ns[k])
        tau_w[k] = jaw_load(theta_j[k], load, env)


def simulated_log(
    p: TruthParameters,
    e: EffectNumbers,
    law: LoopParameters,
    quantum_rad: float,
    reference_rad: NDArray[np.float64],
    load: LoadProfile,
    rows: slice,
    jaw_start_rad: float,
    max_step_s: float,
    env: Environment | None = None,
    encoder_error_rad: NDArray[np.float64] | None = None,
) -> Log:
    """Simulate from rest, one sample of the drive for each of `reference_rad`, and return the `rows` among them.

    The load's time is 0 at the first of the rows. A channel with skew T_s is what it was T_s before its row (after it,
    where T_s is negative), so the rows must lie as far as that from both ends; ValueError where they don't, or
    the step is too coarse. `encoder_error_rad`, one for each sample: added to what the drive reads, not to the rows.
    """
    check_step(p, e, law.current_limit_A, max_step_s)
    samples = reference_rad.size
    first, stop, stride = rows.indices(samples)
    period_ns = round(law.sample_time_s * 1.0e9)
    skew_ns = np.rint(
        np.array([e.channel_skew_theta_m_s, e.channel_skew_current_s, e.channel_skew_theta_j_s, e.channel_skew_tau_w_s])
        * 1.0e9
    ).astype(np.int64)
    taken = np.arange(first, stop, stride)
    # A row at t_k shows an instant in the period (t_(k-q-1), t_(k-q)], the rest before its end.
    periods, rest_ns = np.divmod(skew_ns, period_ns)
    interval = taken[:, np.newaxis] - periods - 1
    if taken.size == 0 or interval.min() < 0 or interval.max() >= samples:
        raise ValueError("the rows of a log must lie one sample and their skew from its ends at least")
    environment = env or Environment(0.0, 0.0)
    state = rest_with_effects(p, e, jaw_start_rad)
    taps, truth = np.zeros((samples, 4)), np.zeros((samples, len(TRUTH_COLUMNS)))
    run_loop(
        state,
        empty_queue(e.actuation_delay_delay_s, law.sample_time_s),
        p,
        e,
        environment,
        law,
        quantum_rad,
        np.zeros(samples) if encoder_error_rad is None else np.ascontiguousarray(encoder_error_rad),
        np.ascontiguousarray(reference_rad),
        load.time_ns,
        load.torque_N_m,
        -first * period_ns,
        period_ns,
        max_step_s,
        rest_ns,
        taps,
        truth,
    )
    theta_m, current, theta_j, touching = (taps[interval[:, c], c] for c in range(4))
    theta_enc, tau_w = np.zeros(taken.size), np.zeros(taken.size)
    sense(theta_m, e, quantum_rad, theta_enc)
    load_ns = (taken - first) * period_ns - skew_ns[3]
    sense_load(touching, load_ns, load.time_ns, load.torque_N_m, environment, tau_w)
    exact, rounded = np.zeros(samples), np.zeros(samples)
    sense(truth[:, 0], e, 0.0, exact)
    sense(truth[:, 0], e, quantum_rad, rounded)
    measured_A = (1.0 + e.current_gain_relative_error) * current + e.current_offset_offset_A
    return Log(theta_enc, measured_A, theta_j, tau_w, truth[taken], rounded - exact)
