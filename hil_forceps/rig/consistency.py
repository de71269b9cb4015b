"""Checks between keys, on a flat view of what is valid: they run even when other keys of the file are wrong."""

import math
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any

from pydantic import BaseModel

from hil_forceps.rig.problems import Path, Problem

Values = Mapping[str, Any]

MAX_BUS_LOAD = 0.95  # leaves room for heartbeats and parameters
_CLASSIC_FRAME_BITS = 135  # 8 bytes, 11-bit id, worst-case stuffing, intermission
_FD_NOMINAL_BITS = 36  # arbitration, acknowledge, end, intermission, stuffed
_FD_FEEDBACK_DATA_BITS = 240  # 16 bytes with CRC-17 and stuffing
_FD_SETPOINT_DATA_BITS = 160
_TOLERANCE = 1e-6


def flatten(data: Mapping[str, Any], root: type[BaseModel], bad: Collection[Path] = ()) -> Values:
    """Return `section.key` -> value with defaults filled in, without the keys at or above a path in `bad`."""
    values: dict[str, Any] = {}
    for section, info in root.model_fields.items():
        default = info.default
        given = data.get(section, {} if isinstance(default, BaseModel) else None)
        if isinstance(default, BaseModel):
            values |= {f"{section}.{key}": getattr(default, key) for key in type(default).model_fields}
        if isinstance(given, Mapping):
            values |= {f"{section}.{key}": _value(item) for key, item in given.items()}
    for path in bad:
        prefix = ".".join(str(step) for step in path[:2])
        values = {key: item for key, item in values.items() if key != prefix and not key.startswith(f"{prefix}.")}
    return values


def _value(item: object) -> object:
    return item.get("value") if isinstance(item, Mapping) else item


def check(values: Values) -> list[Problem]:
    """Run the checks that hold for every rig, as far as their keys are known and valid."""
    return _run(_RULES, values)


def check_bench(values: Values) -> list[Problem]:
    """Run the checks on what a bench needs: that steps fit, and that the bus carries what it must in time."""
    return _run(_BENCH_RULES, values)


def _run(rules: "_Rules", values: Values) -> list[Problem]:
    problems: list[Problem] = []
    for keys, rule in rules:
        needed = [values.get(key) for key in keys]
        if None not in needed:
            problems.extend(rule(*needed))
    return problems


def _problem(key: str, text: str) -> Problem:
    return Problem(tuple(key.split(".")), text)


def _position_range(low: float, high: float) -> Iterator[Problem]:
    if low >= high:
        yield _problem("limits.position_min_rad", f"is {low:g}, not below position_max_rad {high:g}; swap them")


def _host_phase(phase: float, period: float) -> Iterator[Problem]:
    if phase >= period:
        yield _problem("bench.host_phase_s", f"is {phase:g}, not below host_period_s {period:g}; make it less")


def _step_divides_period(step: float, period: float) -> Iterator[Problem]:
    if not _divides(step, period):
        text = f"is {step:g} and doesn't divide drive.sample_time_s {period:g}; take {_divisor_near(step, period):g}"
        yield _problem("bench.plant_step_s", text)


def _step_divides_direct(step: float, times: tuple[float, ...]) -> Iterator[Problem]:
    for index, period in enumerate(times):
        if not _divides(step, period):
            text = f"is {period:g}, no multiple of plant_step_s {step:g}; change one of them"
            yield Problem(("bench", "direct_sample_times_s", index), text)


def _divides(step: float, period: float) -> bool:
    ratio = period / step
    return round(ratio) >= 1 and abs(ratio - round(ratio)) <= _TOLERANCE * ratio


def _divisor_near(step: float, period: float) -> float:
    return period / max(1, math.ceil(period / step - _TOLERANCE))


def _step_against_plant(
    step: float, r_m: float, r_j: float, i_m: float, i_j: float, d_m: float, k: float
) -> Iterator[Problem]:
    rate = max(math.sqrt(k * (r_m**2 / i_m + r_j**2 / i_j)), d_m / i_m)
    if step * rate > 1.0:
        text = f"is {step:g}, too coarse: the plant's fastest rate is {rate:.4g} 1/s; take at most {0.5 / rate:.1g}"
        yield _problem("bench.plant_step_s", text)


def _bitrates(transport: str, nominal: int, data: int) -> Iterator[Problem]:
    if transport == "fd" and data < nominal:
        text = f"is {data}, below bitrate_bit_per_s {nominal}; the data phase of CAN FD is never slower, so raise it"
        yield _problem("bench.data_bitrate_bit_per_s", text)


def _bus_load(
    transport: str, nominal: int, data: int, host_period: float, sample: float, divider: int
) -> Iterator[Problem]:
    feedback, sensor, setpoint = _frame_times_s(transport, nominal, data)
    load = (feedback + sensor) / (sample * divider) + setpoint / host_period
    if load > MAX_BUS_LOAD:
        text = (
            f"is {nominal}, too slow: the cyclic frames would load the bus by {100.0 * load:.0f} %; "
            "raise it, raise feedback_divider or use transport fd"
        )
        yield _problem("bench.bitrate_bit_per_s", text)


def _sample_age(
    max_age: float,
    transport: str,
    nominal: int,
    data: int,
    latency: float,
    jitter: float,
    sample: float,
    divider: int,
) -> Iterator[Problem]:
    frames = _frame_times_s(transport, nominal, data)[0]
    oldest = frames + latency + jitter + sample * divider
    if oldest > max_age:
        text = (
            f"is {max_age:g}, but the newest sample may be {oldest:.3g} s old (frames {1e3 * frames:.3g} ms, latency "
            f"and jitter {1e3 * (latency + jitter):.3g} ms, between samples {1e3 * sample * divider:.3g} ms); "
            "raise it or make the way shorter"
        )
        yield _problem("limits.max_sample_age_s", text)


def _frame_times_s(transport: str, nominal: int, data: int) -> tuple[float, float, float]:
    """Return worst-case times of one sample's feedback frames, of the bench sensor's frame and of one setpoint."""
    classic = _CLASSIC_FRAME_BITS / nominal
    if transport == "classic":
        return 2.0 * classic, classic, classic
    arbitration = _FD_NOMINAL_BITS / nominal
    return arbitration + _FD_FEEDBACK_DATA_BITS / data, classic, arbitration + _FD_SETPOINT_DATA_BITS / data


_BUS = ("bench.transport", "bench.bitrate_bit_per_s", "bench.data_bitrate_bit_per_s")
_PLANT = (
    "forceps.motor_pulley_radius_m",
    "forceps.jaw_pulley_radius_m",
    "forceps.motor_inertia_kg_m2",
    "forceps.jaw_inertia_kg_m2",
    "forceps.motor_viscous_N_m_s_per_rad",
    "forceps.wire_stiffness_N_per_m",
)
_FEEDBACK = ("drive.sample_time_s", "bench.feedback_divider")

_Rules = tuple[tuple[tuple[str, ...], Callable[..., Iterator[Problem]]], ...]

_RULES: _Rules = (
    (("limits.position_min_rad", "limits.position_max_rad"), _position_range),
    (("bench.host_phase_s", "bench.host_period_s"), _host_phase),
    (_BUS, _bitrates),
)
_BENCH_RULES: _Rules = (
    (("bench.plant_step_s", "drive.sample_time_s"), _step_divides_period),
    (("bench.plant_step_s", "bench.direct_sample_times_s"), _step_divides_direct),
    (("bench.plant_step_s", *_PLANT), _step_against_plant),
    ((*_BUS, "bench.host_period_s", *_FEEDBACK), _bus_load),
    (("limits.max_sample_age_s", *_BUS, "bench.latency_s", "bench.latency_jitter_s", *_FEEDBACK), _sample_age),
)
