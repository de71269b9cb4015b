"""Sensors: resolution, saturation at the wire's fields, noise by seed."""

import math
from itertools import islice

import numpy as np
import pytest

from firmware_protocol.scales import ANGLE_LSB_RAD, BENCH_TORQUE_LSB_N_M, CURRENT_LSB_A
from virtual_bus.plant.sensors import (
    IDEAL_ENCODER,
    NOISE_BLOCK,
    Reading,
    SensorParameters,
    encoder_raw,
    noise_source,
    read_sensors,
)

QUIET = (0.0, 0.0, 0.0)
NOISELESS = SensorParameters(16384.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("counts", [4096, 16384, 65536, 1 << 24])
def test_encoder_of_a_power_of_two_gives_whole_counts_within_half_a_count(counts: int) -> None:
    lsb_per_count = (1 << 24) // counts
    for angle in np.linspace(-20.0, 20.0, 501):
        value = encoder_raw(float(angle), float(counts))
        assert value % lsb_per_count == 0
        assert abs(value * ANGLE_LSB_RAD - angle) <= math.pi / counts * (1.0 + 1.0e-9)


def test_encoder_of_any_count_is_within_half_a_count_and_half_a_wire_unit() -> None:
    for angle in np.linspace(-20.0, 20.0, 501):
        error = encoder_raw(float(angle), 5000.0) * ANGLE_LSB_RAD - angle
        assert abs(error) <= math.pi / 5000 + 0.51 * ANGLE_LSB_RAD


def test_ideal_encoder_has_the_resolution_of_the_wire() -> None:
    for angle in np.linspace(-20.0, 20.0, 501):
        assert abs(encoder_raw(float(angle), IDEAL_ENCODER) * ANGLE_LSB_RAD - angle) <= 0.5001 * ANGLE_LSB_RAD


def test_quantiser_has_no_bias() -> None:
    angles = np.linspace(0.0, 2.0 * math.pi, 100_001)
    errors = [encoder_raw(float(a), 4096.0) * ANGLE_LSB_RAD - a for a in angles]
    assert abs(float(np.mean(errors))) < 0.01 * 2.0 * math.pi / 4096


def test_angle_keeps_counting_beyond_the_wire() -> None:
    assert encoder_raw(300.0 * 2.0 * math.pi, 16384.0) == 300 << 24


def test_noiseless_reading_in_units_of_the_wire() -> None:
    reading = read_sensors(1.0, -0.25, -0.5, 1.5e-3, NOISELESS, QUIET)
    assert reading.current == round(-0.25 / CURRENT_LSB_A)
    assert reading.theta_j == round(-0.5 / ANGLE_LSB_RAD)
    assert reading.tau_w == round(1.5e-3 / BENCH_TORQUE_LSB_N_M)


@pytest.mark.parametrize("sign", [1, -1])
def test_fields_saturate_at_what_they_can_carry(sign: int) -> None:
    reading = read_sensors(1.0, sign * 1.0e3, sign * 10.0, sign * 1.0e3, NOISELESS, QUIET)
    assert reading[1:] == (sign * 32767, sign * 8388607, sign * 8388607)


def test_each_noise_moves_its_own_sensor_by_its_own_deviation() -> None:
    p = SensorParameters(16384.0, 1.0e-2, 2.0e-4, 1.0e-5)
    still = read_sensors(1.0, 0.1, 0.2, 1.0e-3, p, QUIET)
    moved = read_sensors(1.0, 0.1, 0.2, 1.0e-3, p, (1.0, -2.0, 3.0))
    difference = Reading(*(b - a for a, b in zip(still, moved, strict=True)))
    assert difference.theta_m == 0
    assert difference.current == round(1.0e-2 / CURRENT_LSB_A)
    assert difference.theta_j == pytest.approx(-4.0e-4 / ANGLE_LSB_RAD, abs=1)
    assert difference.tau_w == round(3.0e-5 / BENCH_TORQUE_LSB_N_M)


def test_same_seed_same_noise_other_seed_other_noise() -> None:
    length = 2 * NOISE_BLOCK + 5
    first = list(islice(noise_source(7), length))
    assert first == list(islice(noise_source(7), length))
    assert first != list(islice(noise_source(8), length))


def test_noise_is_standard_normal_white_and_independent_between_sensors() -> None:
    noise = np.array(list(islice(noise_source(3), 20_000)))
    limit = 5.0 / math.sqrt(20_000)
    assert np.abs(noise.mean(axis=0)).max() < limit
    assert np.abs(noise.std(axis=0) - 1.0).max() < limit
    correlation = np.corrcoef(np.hstack([noise[1:], noise[:-1]]).T)
    assert np.abs(correlation - np.eye(6)).max() < limit
