"""Settings of drive, bus, loop and forceps that don't go together: what a rig tells before anything is connected.

Pure. A finding is a `problem` where a run can't work or isn't safe, else a `note`. What a rig file can't even hold is
refused when it is read, and isn't looked for again here.
"""

import math
from collections.abc import Iterator

from firmware_protocol.scales import ANGLE_LSB_PER_REV, ANGLE_LSB_RAD, CURRENT_LSB_A
from hil_forceps.drives.profile import LOAD_N_M, MAX_QUANTUM_SHARE, Finding
from hil_forceps.drives.registry import maker_profile
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.sections import Limits

MIN_WATCHDOG_PERIODS = 3  # of the host, within a watchdog's time: one late tick must not stop the motor
MAX_WATCHDOG_S = 0.5  # a motor that goes on for longer behind a dead host
MAX_CORRECTION_TIME_S = 2.5  # half a period of the paper's pulses: a reference that is slower never makes up for one
TRAVEL_WINDOW_S = 0.25  # over which the gate bounds the travel
MAX_BUS_LOAD, HIGH_BUS_LOAD = 0.9, 0.6


def findings(rig: Rig) -> list[Finding]:
    """Return all that was found, problems first, otherwise in the order of the rig's keys."""
    found = [
        *_limits(rig),
        *_narrow(rig),
        *_unknown(rig),
        *_watchdog(rig),
        *_of_profile(rig),
        *_quanta(rig),
        *_current(rig),
        *_bus(rig),
    ]
    return sorted(found, key=lambda finding: finding.level != "problem")


def _limits(rig: Rig) -> Iterator[Finding]:
    if "limits" not in rig.model_fields_set:
        yield Finding(
            "problem", "limits", "is missing; add the limits of the mechanism, without which no motor is enabled"
        )


def _narrow(rig: Rig) -> Iterator[Finding]:
    """Yield limits of the gate within which the reference is slower than any load, or doesn't move at all.

    The way that is asked for: what makes up for the wire's stretch under `LOAD_N_M`, from rest to rest.
    """
    try:
        plant = rig.plant()
    except UserError:
        return
    limits, load = rig.limits, f"a load of {LOAD_N_M * 1e3:g} mN m"
    tension_N = LOAD_N_M / plant.jaw_pulley_radius_m
    way_rad = tension_N / plant.wire_stiffness_N_per_m / plant.motor_pulley_radius_m
    step = _times_s(limits, ANGLE_LSB_RAD)
    for key, time_s in _times_s(limits, way_rad).items():
        if time_s > MAX_CORRECTION_TIME_S:
            told = f"is {getattr(limits, key):g}: the reference needs {time_s:.3g} s to compensate {load}; raise it"
            yield Finding("problem" if step[key] > MAX_CORRECTION_TIME_S else "note", f"limits.{key}", told)
    N_per_A = plant.torque_constant_N_m_per_A / plant.motor_pulley_radius_m
    for key, limit, needed, least, unit in (
        ("tension_max_N", limits.tension_max_N, tension_N, N_per_A * CURRENT_LSB_A, "N"),
        ("current_max_A", limits.current_max_A, tension_N / N_per_A, CURRENT_LSB_A, "A"),
    ):
        if limit is not None and limit < needed:
            told = f"is {limit:g} {unit}; {load} alone needs {needed:.3g} {unit}, so that the gate latches; raise it"
            yield Finding("problem" if limit < least else "note", f"limits.{key}", told)
    if limits.position_max_rad - limits.position_min_rad < way_rad:
        told = (
            f"is less than {way_rad:.2g} rad above position_min_rad, and the compensation of {load} needs this "
            "range; widen it"
        )
        yield Finding("problem", "limits.position_max_rad", told)


def _times_s(limits: Limits, way_rad: float) -> dict[str, float]:
    """Return how long a way from rest to rest takes at least, by each limit of the reference's motion."""
    times_s = {
        "speed_max_rad_per_s": way_rad / limits.speed_max_rad_per_s,
        "acceleration_max_rad_per_s2": 2.0 * math.sqrt(way_rad / limits.acceleration_max_rad_per_s2),
    }
    if limits.jerk_max_rad_per_s3 is not None:
        times_s["jerk_max_rad_per_s3"] = math.cbrt(32.0 * way_rad / limits.jerk_max_rad_per_s3)
    if limits.window_travel_max_rad is not None:
        times_s["window_travel_max_rad"] = TRAVEL_WINDOW_S * way_rad / limits.window_travel_max_rad
    return times_s


def _unknown(rig: Rig) -> Iterator[Finding]:
    for section, values in (("forceps", rig.forceps), ("motor", rig.motor)):
        for key in type(values).model_fields:
            if getattr(values, key).value is None:
                yield Finding(
                    "note",
                    f"{section}.{key}",
                    "has no value, and `run` needs one; fit it with `diagnose` (docs/diagnosis.md)",
                )


def _watchdog(rig: Rig) -> Iterator[Finding]:
    if rig.motor_driver is None or rig.drive_profile == "native":
        return
    key, watchdog_s, period_s = "motor_driver.watchdog_s", rig.motor_driver.watchdog_s, rig.bench.host_period_s
    if watchdog_s == 0.0:
        yield Finding("problem", key, "is 0: nothing stops the motor if this program or the bus fails")
    elif watchdog_s < MIN_WATCHDOG_PERIODS * period_s:
        yield Finding(
            "problem",
            key,
            f"is {watchdog_s:g} s, {watchdog_s / period_s:.1f} periods of the host: one late tick stops the motor; "
            "set at "
            f"least {MIN_WATCHDOG_PERIODS * period_s:g} s",
        )
    elif watchdog_s > MAX_WATCHDOG_S:
        yield Finding(
            "note", key, f"is {watchdog_s:g} s: after a failure of the host the motor continues for this time"
        )


def _of_profile(rig: Rig) -> Iterator[Finding]:
    found = maker_profile(rig)
    if found is not None:
        profile, settings = found
        yield from profile.findings(rig, settings)


def _quanta(rig: Rig) -> Iterator[Finding]:
    try:
        plant = rig.plant()
    except UserError:
        return
    stretch_m = LOAD_N_M / plant.jaw_pulley_radius_m / plant.wire_stiffness_N_per_m
    counts = rig.encoder.counts_per_rev or ANGLE_LSB_PER_REV
    ratio = 1.0 if rig.motor_driver is None else abs(rig.motor_driver.encoder_rev_per_pulley_rev)
    key, quantum_rev = "encoder.counts_per_rev", 1.0 / counts / ratio
    found = maker_profile(rig)
    if found is not None:
        profile, settings = found
        coarser = profile.quantum(rig, settings)
        if coarser is not None and coarser.pulley_rev > quantum_rev:
            key, quantum_rev = coarser
    quantum_m = 2.0 * math.pi * quantum_rev * plant.motor_pulley_radius_m
    if quantum_m > MAX_QUANTUM_SHARE * stretch_m:
        yield Finding(
            "note",
            key,
            f"the resolution of the angle is {quantum_m * 1e6:.2g} µm at the wire, "
            f"{100.0 * quantum_m / stretch_m:.0f} % "
            f"of its stretch under {LOAD_N_M * 1e3:g} mN m ({stretch_m * 1e6:.2g} µm)",
        )


def _current(rig: Rig) -> Iterator[Finding]:
    try:
        plant = rig.plant()
    except UserError:
        return
    torque_N_m = LOAD_N_M * plant.motor_pulley_radius_m / plant.jaw_pulley_radius_m
    needed_A = torque_N_m / plant.torque_constant_N_m_per_A
    limits = {"drive.current_limit_A": None if rig.drive is None else rig.drive.current_limit_A}
    maker = maker_profile(rig)
    if maker is not None and maker[0].tells_current_limit:
        limits["motor_driver.current_limit_A"] = maker[1].current_limit_A
    for key, limit_A in limits.items():
        if limit_A is not None and limit_A < needed_A:
            yield Finding(
                "note",
                key,
                f"is {limit_A:g} A; a load of {LOAD_N_M * 1e3:g} mN m at the jaw alone needs {needed_A:.3g} A, so "
                "that the "
                "current saturates",
            )


def _bus(rig: Rig) -> Iterator[Finding]:
    found = maker_profile(rig)
    if found is None:
        return
    profile, settings = found
    load = profile.bus_load(rig, settings)
    text = f"the cyclic frames of one axis load the bus by {100.0 * load:.0f} % at worst"
    key = "bench.bitrate_bit_per_s" if profile.link == "can" else "motor_driver.baudrate_bit_per_s"
    if load > MAX_BUS_LOAD:
        yield Finding("problem", key, f"{text}; raise it, or lower the rates")
    elif load > HIGH_BUS_LOAD:
        yield Finding("note", key, text)
