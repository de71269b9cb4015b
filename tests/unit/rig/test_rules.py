"""Ranges of sense and rules between keys, at their boundaries."""

import math
from pathlib import Path

import pytest

from firmware_protocol.layouts import LAYOUTS
from firmware_protocol.messages import Function
from hil_forceps.rig import Rig, UserError, load_rig
from hil_forceps.rig.quantities import Quantity
from hil_forceps.rig.sections import Forceps
from hil_forceps.rig.validation import consistency
from virtual_bus.bus import bit_timing

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def paper() -> Rig:
    return load_rig(ROOT / "configs" / "paper.yaml")


TOO_OLD = ["bench.latency_s"]


def bench_problems(rig: Rig, changes: dict[str, object]) -> list[str]:
    try:
        rig.with_changes(changes).require_bench()
    except UserError as error:
        return [line.split(":")[0] for line in error.problems]
    return []


@pytest.mark.parametrize("key", list(Forceps.model_fields))
def test_ends_of_every_range_of_the_plant(paper: Rig, key: str) -> None:
    quantity = next(item for item in Forceps.model_fields[key].metadata if isinstance(item, Quantity))
    low = math.nextafter(quantity.low, math.inf) if quantity.open_low else quantity.low
    beyond_low = quantity.low if quantity.open_low else math.nextafter(quantity.low, -math.inf)
    for inside in (low, quantity.high):
        assert getattr(paper.with_changes({f"forceps.{key}": inside}).forceps, key).value == inside
    for outside in (beyond_low, math.nextafter(quantity.high, math.inf), -1.0, math.nan, math.inf):
        with pytest.raises(UserError, match=f"forceps.{key}: is "):
            paper.with_changes({f"forceps.{key}": outside})


@pytest.mark.parametrize(
    ("key", "value", "remedy"),
    [
        ("forceps.motor_pulley_radius_m", 2.0, "if 2 mm is meant, write 0.002"),
        ("forceps.motor_pulley_radius_m", 2000, "if 2000 um is meant, write 0.002"),
        ("forceps.motor_inertia_kg_m2", 31.8, "if 31.8 g mm² is meant, write 3.18e-08"),
        ("motor.torque_constant_N_m_per_A", 13.5, "if 13.5 mN m/A is meant, write 0.0135"),
        ("drive.sample_time_s", 1, "if 1 ms is meant, write 0.001"),
        ("drive.current_limit_A", 1000, "if 1000 mA is meant, write 1"),
        ("bench.bitrate_bit_per_s", 500, "if 500 kbit/s is meant, write 500000"),
        ("limits.position_max_rad", 1000.0, "if 1000 deg is meant, write 17.4533"),
        ("forceps.jaw_pulley_radius_m", 1e9, "correct it"),
    ],
)
def test_nonsense_values_get_a_guess_at_the_unit(paper: Rig, key: str, value: float, remedy: str) -> None:
    with pytest.raises(UserError) as caught:
        paper.with_changes({key: value})
    assert caught.value.problems[0].startswith(f"{key}: is {value:.12g}")
    assert caught.value.problems[0].endswith(f"; {remedy}")


@pytest.mark.parametrize(
    ("changes", "blamed"),
    [
        ({"bench.host_phase_s": 0.999e-3}, None),
        ({"bench.host_phase_s": 1e-3}, "bench.host_phase_s"),
        ({"limits.position_min_rad": 2.999}, None),
        ({"limits.position_min_rad": 3.0}, "limits.position_min_rad"),
        ({"bench.transport": "fd", "bench.data_bitrate_bit_per_s": 1_000_000}, None),
        ({"bench.transport": "fd", "bench.data_bitrate_bit_per_s": 999_999}, "bench.data_bitrate_bit_per_s"),
        ({"bench.data_bitrate_bit_per_s": 999_999}, None),
    ],
)
def test_rules_of_every_rig(paper: Rig, changes: dict[str, object], blamed: str | None) -> None:
    if blamed is None:
        paper.with_changes(changes)
        return
    with pytest.raises(UserError, match=f"^{blamed}: "):
        paper.with_changes(changes)


@pytest.mark.parametrize(
    ("changes", "blamed"),
    [
        ({}, []),
        ({"bench.plant_step_s": 1e-4}, []),
        ({"bench.plant_step_s": 2.5e-5}, []),
        ({"bench.plant_step_s": 1e-3 / 3, "bench.direct_sample_times_s": []}, ["bench.plant_step_s"]),
        ({"bench.plant_step_s": 2e-4}, ["bench.direct_sample_times_s[0]"]),
        ({"bench.plant_step_s": 2e-3, "bench.direct_sample_times_s": []}, ["bench.plant_step_s"] * 2),
        ({"bench.plant_step_s": 2.5e-4, "bench.direct_sample_times_s": []}, []),
        # The wire's rate grows with the root of the stiffness: 100 times stiffer, ten times the rate.
        ({"forceps.wire_stiffness_N_per_m": 2.5e6}, []),
        ({"forceps.wire_stiffness_N_per_m": 2.65e6}, ["bench.plant_step_s"]),
        ({"drive.current_limit_A": 6.5534}, []),
        ({"drive.current_limit_A": 6.5535}, ["drive.current_limit_A"]),
        # Four frames of 135 bits a millisecond: 0.54 ms at 1 Mbit/s, 95 % at 568.4 kbit/s.
        ({"bench.bitrate_bit_per_s": 568_500}, []),
        ({"bench.bitrate_bit_per_s": 568_300}, ["bench.bitrate_bit_per_s"]),
        ({"bench.bitrate_bit_per_s": 250_000, "bench.feedback_divider": 2}, ["bench.bitrate_bit_per_s", *TOO_OLD]),
        ({"bench.bitrate_bit_per_s": 250_000, "bench.feedback_divider": 4}, TOO_OLD),
        ({"drive.sample_time_s": 5e-4}, []),
        ({"drive.sample_time_s": 2.5e-4}, ["bench.bitrate_bit_per_s"]),
        ({"drive.sample_time_s": 2.5e-4, "bench.feedback_divider": 2}, []),
        # Two frames (0.27 ms) and a period of 1 ms leave 1.73 ms of the 3 ms.
        ({"bench.latency_s": 1.0e-3, "bench.latency_jitter_s": 0.7299e-3}, []),
        ({"bench.latency_s": 1.0e-3, "bench.latency_jitter_s": 0.7301e-3}, TOO_OLD),
        ({"bench.latency_s": 1.7301e-3, "limits.max_sample_age_s": 3.1e-3}, []),
    ],
)
def test_rules_of_a_bench(paper: Rig, changes: dict[str, object], blamed: list[str]) -> None:
    assert bench_problems(paper, changes) == blamed


def test_bits_of_frames_are_those_of_the_wire() -> None:
    longest = {function: layout.length for function, layout in LAYOUTS.items()}
    intermission = bit_timing.INTERMISSION_BITS
    for function in (Function.FEEDBACK, Function.TIMING, Function.BENCH_SENSOR, Function.SETPOINT):
        _, most = bit_timing.frame_bits_bounds(longest[function])
        assert most.nominal + intermission <= consistency.CLASSIC_BITS
    for function, bits in (
        (Function.FD_FEEDBACK, consistency.FD_FEEDBACK_BITS),
        (Function.FD_SETPOINT, consistency.FD_SETPOINT_BITS),
    ):
        _, most = bit_timing.frame_bits_bounds(longest[function], is_fd=True)
        assert (most.nominal + intermission, most.data) == (consistency.FD_NOMINAL_BITS, bits)


def test_bench_rules_do_not_need_what_is_not_known(paper: Rig) -> None:
    rig = paper.with_changes({"forceps.wire_stiffness_N_per_m": "unknown", "drive": None})
    assert bench_problems(rig, {}) == ["forceps.wire_stiffness_N_per_m", "drive"]


def test_rules_of_the_own_protocol_hold_for_it_alone(paper: Rig) -> None:
    changes: dict[str, object] = {"bench.bitrate_bit_per_s": 250_000}
    assert bench_problems(paper, changes) == ["bench.bitrate_bit_per_s"]
    assert bench_problems(paper, changes | {"motor_driver": {"profile": "native"}}) == ["bench.bitrate_bit_per_s"]
    assert bench_problems(paper, changes | {"motor_driver": {"profile": "odrive"}}) == []
