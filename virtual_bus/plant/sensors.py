"""What the world's sensors make of the truth: quantised, noisy, saturating, in the raw integers of the wire."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from firmware_protocol.scales import ANGLE_LSB_PER_REV, ANGLE_LSB_RAD, BENCH_TORQUE_LSB_N_M, CURRENT_LSB_A
from virtual_bus.kernel import kernel

INT16_MAX = (1 << 15) - 1
INT24_MAX = (1 << 23) - 1
IDEAL_ENCODER = 0.0
NOISE_BLOCK = 1024


class SensorParameters(NamedTuple):
    """Resolution and noise of the sensors; floats."""

    counts_per_rev: float  # IDEAL_ENCODER: only the wire's own resolution
    current_sd_A: float
    theta_j_sd_rad: float
    tau_w_sd_N_m: float


class Reading(NamedTuple):
    """What the sensors say at one instant, in the raw units of the messages."""

    theta_m: int  # unwrapped
    current: int
    theta_j: int
    tau_w: int


@kernel
def nearest(value: float) -> int:
    """Round half up; a quantiser without bias."""
    return math.floor(value + 0.5)


@kernel
def saturated(value: float, limit: int) -> int:
    """Round to an integer field of ±limit, holding at its ends."""
    return nearest(min(max(value, -float(limit)), float(limit)))


@kernel
def encoder_raw(theta_rad: float, counts_per_rev: float) -> int:
    """Return the nearest count of an encoder in units of the wire, unwrapped."""
    if counts_per_rev <= 0.0:
        return nearest(theta_rad / ANGLE_LSB_RAD)
    count = nearest(theta_rad * (counts_per_rev / (2.0 * math.pi)))
    return nearest(count * (ANGLE_LSB_PER_REV / counts_per_rev))


@kernel
def read_sensors(
    theta_m_rad: float,
    current_A: float,
    theta_j_rad: float,
    tau_w_N_m: float,
    p: SensorParameters,
    noise: tuple[float, float, float],
) -> Reading:
    """Latch all sensors at one instant; `noise` are standard normals for current, jaw encoder, load cell."""
    return Reading(
        encoder_raw(theta_m_rad, p.counts_per_rev),
        saturated((current_A + p.current_sd_A * noise[0]) / CURRENT_LSB_A, INT16_MAX),
        saturated((theta_j_rad + p.theta_j_sd_rad * noise[1]) / ANGLE_LSB_RAD, INT24_MAX),
        saturated((tau_w_N_m + p.tau_w_sd_N_m * noise[2]) / BENCH_TORQUE_LSB_N_M, INT24_MAX),
    )


def noise_streams(seed: int) -> list[np.random.Generator]:
    """Return where the noise of each sensor of `read_sensors` is drawn from, as standard normals."""
    return [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(3)]


def noise_source(seed: int) -> Iterator[tuple[float, float, float]]:
    """Yield standard normals for `read_sensors` for ever."""
    streams = noise_streams(seed)
    while True:
        yield from zip(*(stream.standard_normal(NOISE_BLOCK).tolist() for stream in streams), strict=True)
