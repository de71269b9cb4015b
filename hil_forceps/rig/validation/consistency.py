"""Checks between keys, on a flat view of what is valid: they run even when other keys of the file are wrong."""

import math
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any

from pydantic import BaseModel

from hil_forceps.rig.quantities import UNKNOWN
from hil_forceps.rig.validation.problems import Path, Problem, show_number

Values = Mapping[str, Any]

MAX_WIRE_CURRENT_A = 6.5534  # 2¹⁵ − 1 counts of 0.2 mA; a test compares it with the protocol's scale
MAX_BUS_LOAD = 0.95  # leaves room for heartbeats and parameters
# Most bits that a frame can take, intermission included: 11-bit id, stuffed at worst.
CLASSIC_BITS = 135  # 8 bytes
FD_NOMINAL_BITS = 32  # of an FD frame at the nominal rate
FD_FEEDBACK_BITS = 195  # 16 bytes, at the data rate
FD_SETPOINT_BITS = 115  # 8 bytes, at the data rate
_MAX_RATIO_ERROR_SHARE = 1e-6


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
    """Return a number in whatever form a file gives it; None where it isn't known."""
    if isinstance(item, Mapping):
        return item.get("value")
    return None if item == UNKNOWN else item


def check(values: Values) -> list[Problem]:
    """Run the checks that hold for every rig, as far as their keys are known and valid."""
    return _run(RULES, values)


def check_bench(values: Values) -> list[Problem]:
    """Run the checks on what a bench needs: that steps fit, and that the bus carries what it must in time.

    The latter only of the project's own protocol: makers' frames are others.
    """
    if values.get("motor_driver.profile", "native") != "native":
        return _run(BENCH_RULES, values)
    return _run((*BENCH_RULES, *NATIVE_RULES), values)


def _run(rules: "Rules", values: Values) -> list[Problem]:
    problems: list[Problem] = []
    for keys, rule in rules:
        needed = [values.get(key) for key in keys]
        if None not in needed:
            problems.extend(rule(*needed))
    return problems


def _problem(key: str, text: str) -> Problem:
    return Problem(tuple(key.split(".")), text)


def _position_range(low: float, high: float) -> Iterator[Problem]:
    """`limits.position_min_rad` is below `position_max_rad`."""
    if low >= high:
        yield _problem(
            "limits.position_min_rad",
            f"is {show_number(low)}, not below position_max_rad {show_number(high)}; swap them",
        )


def _host_phase(phase: float, period: float) -> Iterator[Problem]:
    """`bench.host_phase_s` is less than `host_period_s`."""
    if phase >= period:
        yield _problem(
            "bench.host_phase_s",
            f"is {show_number(phase)}, not below host_period_s {show_number(period)}; make it less",
        )


def _velocity_gain(cascade_s: float, kd: float) -> Iterator[Problem]:
    """A drive with `cascade_time_s` has a velocity loop, of which `kd_A_s_per_rad` is the gain."""
    if cascade_s > 0.0 and kd == 0.0:
        yield _problem("drive.kd_A_s_per_rad", "is 0, but with cascade_time_s it is the velocity loop's gain; set it")


def _step_divides_period(step: float, period: float) -> Iterator[Problem]:
    """`bench.plant_step_s` divides `drive.sample_time_s`."""
    if not _divides(step, period):
        text = f"is {show_number(step)} and doesn't divide drive.sample_time_s {show_number(period)}"
        yield _problem("bench.plant_step_s", f"{text}; take {_divisor_near(step, period):g}")


def _step_divides_direct(step: float, times: tuple[float, ...]) -> Iterator[Problem]:
    """`bench.plant_step_s` divides every one of `direct_sample_times_s`."""
    for index, period in enumerate(times):
        if not _divides(step, period):
            text = f"is {show_number(period)}, no multiple of plant_step_s {show_number(step)}; change one of them"
            yield Problem(("bench", "direct_sample_times_s", index), text)


def _divides(step: float, period: float) -> bool:
    ratio = period / step
    return abs(ratio - round(ratio)) <= _MAX_RATIO_ERROR_SHARE * ratio


def _divisor_near(step: float, period: float) -> float:
    """Return the largest round fraction of the period that is no longer than the step."""
    at_least = max(1.0, period / step)
    decade = 10.0 ** math.floor(math.log10(at_least))
    parts = next(round(decade * lead) for lead in (1, 2, 2.5, 4, 5, 8, 10) if decade * lead >= at_least * (1.0 - 1e-9))
    return period / parts


def _step_against_plant(
    step: float, r_m: float, r_j: float, i_m: float, i_j: float, d_m: float, k: float
) -> Iterator[Problem]:
    """`bench.plant_step_s` times the plant's fastest rate, that of the undamped wire or D_m/I_m, is at most 1."""
    rate = max(math.sqrt(k * (r_m**2 / i_m + r_j**2 / i_j)), d_m / i_m)
    if step * rate > 1.0:
        text = f"is {show_number(step)}, too coarse: the plant's fastest rate is {rate:.4g} 1/s"
        yield _problem("bench.plant_step_s", f"{text}; take at most {0.5 / rate:.1g}")


def _bitrates(transport: str, nominal: int, data: int) -> Iterator[Problem]:
    """With `transport: fd`, `bench.data_bitrate_bit_per_s` is at least `bitrate_bit_per_s`."""
    if transport == "fd" and data < nominal:
        text = f"is {data}, below bitrate_bit_per_s {nominal}; the data phase of CAN FD is never slower, so raise it"
        yield _problem("bench.data_bitrate_bit_per_s", text)


def _bus_load(
    transport: str, nominal: int, data: int, host_period: float, sample: float, divider: int
) -> Iterator[Problem]:
    """The cyclic frames, stuffed at worst, load the bus by no more than 95 %."""
    load = native_bus_load(transport, nominal, data, host_period, sample, divider)
    if load > MAX_BUS_LOAD:
        text = (
            f"is {nominal}, too slow: the cyclic frames would load the bus by {100.0 * load:.0f} %; "
            "raise it, raise feedback_divider or use transport fd"
        )
        yield _problem("bench.bitrate_bit_per_s", text)


def native_bus_load(transport: str, nominal: int, data: int, host_period: float, sample: float, divider: int) -> float:
    """Return the share of the bus's time that the cyclic frames of the project's own protocol take, at worst."""
    feedback, sensor, setpoint = _frame_times_s(transport, nominal, data)
    return (feedback + sensor) / (sample * divider) + setpoint / host_period


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
    """Frames, latency, jitter and the time between samples leave a sample younger than `limits.max_sample_age_s`."""
    frames = _frame_times_s(transport, nominal, data)[0]
    oldest = frames + latency + jitter + sample * divider
    if oldest > max_age:
        text = (
            f"is {show_number(latency)}: with jitter, frames ({frames:.3g} s) and the time between samples "
            f"({sample * divider:.3g} s) the newest may be {oldest:.3g} s old, above limits.max_sample_age_s "
            f"{show_number(max_age)}; lower one of these or raise that"
        )
        yield _problem("bench.latency_s", text)


def _wire_current(limit: float) -> Iterator[Problem]:
    """`drive.current_limit_A` is within what the wire carries, 6.5534 A."""
    if limit > MAX_WIRE_CURRENT_A:
        text = f"is {show_number(limit)}, more than the {MAX_WIRE_CURRENT_A} A that the wire carries; lower it"
        yield _problem("drive.current_limit_A", text)


def _frame_times_s(transport: str, nominal: int, data: int) -> tuple[float, float, float]:
    """Return worst-case times of one sample's feedback frames, of the bench sensor's frame and of one setpoint."""
    classic = CLASSIC_BITS / nominal
    if transport == "classic":
        return 2.0 * classic, classic, classic
    arbitration = FD_NOMINAL_BITS / nominal
    return arbitration + FD_FEEDBACK_BITS / data, classic, arbitration + FD_SETPOINT_BITS / data


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

Rules = tuple[tuple[tuple[str, ...], Callable[..., Iterator[Problem]]], ...]

RULES: Rules = (
    (("limits.position_min_rad", "limits.position_max_rad"), _position_range),
    (("bench.host_phase_s", "bench.host_period_s"), _host_phase),
    (("drive.cascade_time_s", "drive.kd_A_s_per_rad"), _velocity_gain),
    (_BUS, _bitrates),
)
BENCH_RULES: Rules = (
    (("bench.plant_step_s", "drive.sample_time_s"), _step_divides_period),
    (("bench.plant_step_s", "bench.direct_sample_times_s"), _step_divides_direct),
    (("bench.plant_step_s", *_PLANT), _step_against_plant),
)
# Of the project's own protocol; what holds for those of makers is in hil_forceps/drives/compatibility/lint.py.
NATIVE_RULES: Rules = (
    (("drive.current_limit_A",), _wire_current),
    ((*_BUS, "bench.host_period_s", *_FEEDBACK), _bus_load),
    (("limits.max_sample_age_s", *_BUS, "bench.latency_s", "bench.latency_jitter_s", *_FEEDBACK), _sample_age),
)
