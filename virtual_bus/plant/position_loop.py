"""The position loop that the drive closes: PID on the encoder angle, the derivative on the measured speed.

With a cascade time it is a position loop around a velocity loop, which has the integral.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.scales import ANGLE_LSB_RAD
from virtual_bus.kernel import kernel, subroutine


class LoopParameters(NamedTuple):
    """Gains of the loop and its sampling time; SI floats, all positive or nought."""

    sample_time_s: float
    kp_A_per_rad: float
    ki_A_per_rad_s: float
    kd_A_s_per_rad: float
    derivative_cutoff_Hz: float
    current_limit_A: float
    cascade_time_s: float = 0.0  # the integral takes in the error less this times the speed


class LoopState(NamedTuple):
    """What the loop remembers from sample to sample."""

    integral_rad_s: float
    speed_rad_per_s: float
    theta_raw: float  # encoder angle of the sample before, wire units


def idle_loop(theta_raw: int) -> NDArray[np.float64]:
    """Return a loop at rest at this encoder angle, as an array in the order of `LoopState`."""
    return np.array([0.0, 0.0, float(theta_raw)])


@subroutine
def speed_filter_gain(p: LoopParameters) -> float:
    """Gain of the one-pole filter per sample: the exact discrete form of a pole at the cutoff, 1 − e^(−2π f_c T)."""
    return -math.expm1(-2.0 * math.pi * p.derivative_cutoff_Hz * p.sample_time_s)


@kernel
def clamped(value: float, limit: float) -> float:
    """Return the value within ±limit."""
    return min(max(value, -limit), limit)


@kernel
def loop_step(
    state: LoopState, p: LoopParameters, active: bool, reference_raw: int, theta_raw: int
) -> tuple[LoopState, float]:
    """One sample of the loop: the state after it, and the current in A to hold until the next one.

    While not active the current is nought and the memory empty, but for the last angle: so the loop starts without a
    kick from an old integral or from a speed that it did not see. The integral takes in the error of this sample
    before it is used.
    """
    if not active:
        return LoopState(0.0, 0.0, float(theta_raw)), 0.0
    error = (reference_raw - theta_raw) * ANGLE_LSB_RAD
    difference = (theta_raw - state.theta_raw) * (ANGLE_LSB_RAD / p.sample_time_s)
    speed = state.speed_rad_per_s + speed_filter_gain(p) * (difference - state.speed_rad_per_s)
    integral = state.integral_rad_s + (error - p.cascade_time_s * speed) * p.sample_time_s
    if p.ki_A_per_rad_s > 0.0:
        integral = clamped(integral, p.current_limit_A / p.ki_A_per_rad_s)
    wanted = p.kp_A_per_rad * error + p.ki_A_per_rad_s * integral - p.kd_A_s_per_rad * speed
    return LoopState(integral, speed, float(theta_raw)), clamped(wanted, p.current_limit_A)
