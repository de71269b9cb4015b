"""From answers to the entries of a rig: values at the motor pulley, and for each where it is from."""

import math
from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple

from hil_forceps.rig.first_rig.answers import Answers
from hil_forceps.rig.first_rig.mini_cheetah import own_firmware
from hil_forceps.rig.first_rig.position_loop import STEPS_S, inertia_at_pulley, loop_entries, plant_step_s
from hil_forceps.rig.presets import Fact
from hil_forceps.rig.validation.consistency import MAX_WIRE_CURRENT_A

# What nobody knows yet: bounds as wide as `configs/surgical_tool_unknown.yaml` has them, and what the paper's forceps
# has (Table I), for a simulation.
UNKNOWN: Final = {
    "motor_inertia_kg_m2": (1e-8, 1e-2, None),
    "jaw_inertia_kg_m2": (1e-8, 1e-4, 6.85e-8),
    "motor_viscous_N_m_s_per_rad": (1e-7, 1e-1, None),
    "motor_coulomb_N_m": (1e-7, 1.0, None),
    "jaw_coulomb_N_m": (1e-9, 1.0, 4.62e-9),
    "wire_stiffness_N_per_m": (1e2, 1e7, 2.6e4),
}
MEASURE: Final = {
    "motor_inertia_kg_m2": "of rotor, gear and pulley; `hil-forceps diagnose` fits it to runs that accelerate",
    "jaw_inertia_kg_m2": "from the drawing, or `hil-forceps diagnose` fits it to runs that accelerate",
    "motor_viscous_N_m_s_per_rad": "the slope of the current over speed, wire off; `hil-forceps diagnose` fits it",
    "motor_coulomb_N_m": "half of the current between slow turns both ways, wire off; `hil-forceps diagnose` fits it",
    "jaw_coulomb_N_m": "half of the torque between slow turns of the jaw both ways; `hil-forceps diagnose` fits it",
    "wire_stiffness_N_per_m": "jaw held, a torque on the motor and how far it turns; `hil-forceps diagnose` fits it",
}
MAX_TO_MIN_NO_LOAD_LOSS_RATIO: Final = 100.0  # a part of the no-load loss, between all of it and a hundredth

Known = float | int | str | Mapping[str, float]


class Entry(NamedTuple):
    """A key with its value and where that is from."""

    key: str
    value: Known
    source: str


Sections = dict[str, list[Entry]]


def sections(answers: Answers) -> Sections:
    """Return the sections of a rig with their entries, in a file's order."""
    found: Sections = {
        "forceps": list(_forceps(answers)),
        "motor": [_torque_constant(answers)],
        "encoder": [_encoder(answers)],
    }
    plant = {entry.key: value for entry in found["forceps"] if (value := _value(entry.value)) is not None}
    inertia = inertia_at_pulley(plant, answers.radii) or math.sqrt(math.prod(UNKNOWN["motor_inertia_kg_m2"][:2]))
    limit = _current_limit(answers)
    found["drive"] = [Entry(*entry) for entry in loop_entries(answers, inertia, limit.value, limit.source)]
    if answers.profile != "native":
        found["motor_driver"] = list(_motor_driver(answers, plant, inertia, limit))
    torque = answers.motor.values.nominal_torque_N_m
    if answers.profile == "cia402" and torque is not None:
        rated = _through_gear(answers, torque, abs(answers.gear))
        found["recording"] = [Entry("rated_torque_N_m", rated.value, f"{rated.source}; 6076h")]
    found["bench"] = list(_bench(answers, plant))
    found["limits"] = list(_limits(answers, inertia if "motor_inertia_kg_m2" in plant else None, limit))
    return found


def without_value(found: Sections) -> list[str]:
    """Return the keys of which bounds alone are known, by their paths."""
    return [
        f"{section}.{entry.key}"
        for section, entries in found.items()
        for entry in entries
        if isinstance(entry.value, Mapping) and "value" not in entry.value
    ]


def _value(known: Known) -> float | None:
    if isinstance(known, Mapping):
        return known.get("value")
    return None if isinstance(known, str) else float(known)


def _forceps(answers: Answers) -> Iterator[Entry]:
    yield Entry("motor_pulley_radius_m", answers.motor_pulley_radius_m, "given with --motor-pulley-radius-mm")
    yield Entry("jaw_pulley_radius_m", answers.jaw_pulley_radius_m, "given with --jaw-pulley-radius-mm")
    yield _inertia(answers)
    yield _given_or_unknown(answers, "jaw_inertia_kg_m2", answers.jaw_inertia_kg_m2, "--jaw-inertia")
    yield from _motor_friction(answers)
    yield _given_or_unknown(answers, "jaw_coulomb_N_m", answers.jaw_coulomb_N_m, "--jaw-coulomb")
    yield _given_or_unknown(answers, "wire_stiffness_N_per_m", answers.wire_stiffness_N_per_m, "--wire-stiffness")


def _inertia(answers: Answers) -> Entry:
    key, fact = "motor_inertia_kg_m2", answers.motor.values.inertia_kg_m2
    if fact is None:
        return _unknown(answers, key)
    found = _through_gear(answers, fact, answers.gear**2)
    return Entry(key, found.value, f"{found.source}; without the pulley, add its own")


def _motor_friction(answers: Answers) -> Iterator[Entry]:
    values, keys = answers.motor.values, ("motor_viscous_N_m_s_per_rad", "motor_coulomb_N_m")
    current, speed = values.no_load_current_A, values.no_load_speed_rad_per_s
    if values.viscous_N_m_s_per_rad is not None and values.coulomb_N_m is not None:
        facts = (values.viscous_N_m_s_per_rad, values.coulomb_N_m)
        for key, fact, factor in zip(keys, facts, (answers.gear**2, abs(answers.gear)), strict=True):
            yield Entry(key, *_through_gear(answers, fact, factor))
    elif current is not None and speed is not None:
        loss_N_m = float(current.value) * answers.torque_constant_N_m_per_A
        why = f"no-load current ({current.source}) times K_t is all of the motor's loss: half of it taken for this"
        for key, most in zip(keys, (loss_N_m * abs(answers.gear) / float(speed.value), loss_N_m), strict=True):
            yield Entry(key, {"value": most / 2, "min": most / MAX_TO_MIN_NO_LOAD_LOSS_RATIO, "max": most}, why)
    else:
        yield from (_unknown(answers, key) for key in keys)


def _given_or_unknown(answers: Answers, key: str, given: float | None, option: str) -> Entry:
    return _unknown(answers, key) if given is None else Entry(key, given, f"given with {option}")


def _unknown(answers: Answers, key: str) -> Entry:
    low, high, of_paper = UNKNOWN[key]
    bounds = {"min": low, "max": high}
    if not answers.assume:
        return Entry(key, bounds, f"no data sheet has it: {MEASURE[key]}")
    if of_paper is not None:
        return Entry(key, {"value": of_paper, **bounds}, f"ASSUMED, the paper's (Table I): {MEASURE[key]}")
    middle = float(f"{math.sqrt(low * high):.3g}")
    return Entry(key, {"value": middle, **bounds}, f"ASSUMED, the middle of the bounds: {MEASURE[key]}")


class _Scaled(NamedTuple):
    value: float
    source: str


def _through_gear(answers: Answers, fact: Fact, factor: float) -> _Scaled:
    """Return a motor's value as the pulley sees it."""
    through = "" if answers.gear == 1.0 else f"; times {factor:g} by the gear"
    return _Scaled(float(fact.value) * factor, f"{fact.source}{through}")


def _torque_constant(answers: Answers) -> Entry:
    found = _through_gear(answers, answers.motor.values.torque_constant_N_m_per_A, abs(answers.gear))
    return Entry("torque_constant_N_m_per_A", *found)


def _encoder(answers: Answers) -> Entry:
    counts, source = int(answers.encoder_counts.value), answers.encoder_counts.source
    if answers.profile == "native" and answers.gear != 1.0:
        return Entry("counts_per_rev", round(counts * abs(answers.gear)), f"{source}; times the gear: of the pulley")
    return Entry("counts_per_rev", counts, source)


def _current_limit(answers: Answers) -> _Scaled:
    """Return the lowest of what motor, wire and protocol allow."""
    limits = [_Scaled(float(answers.current_limit_A.value), answers.current_limit_A.source)]
    if answers.tension_max_N is not None:
        at_most = answers.tension_max_N * answers.motor_pulley_radius_m / answers.torque_constant_N_m_per_A
        limits.append(_Scaled(at_most, f"what pulls with --tension-max, {answers.tension_max_N:g} N r_m / K_t"))
    if answers.profile == "native":
        limits.append(_Scaled(MAX_WIRE_CURRENT_A, "what the protocol carries"))
    return min(limits)


def _motor_driver(
    answers: Answers, plant: Mapping[str, float], inertia_kg_m2: float, limit: _Scaled
) -> Iterator[Entry]:
    yield Entry("profile", answers.profile, answers.drive.title)
    for key, fact in answers.drive.motor_driver.items():
        is_other = key == "node_id" and answers.node_id is not None
        yield Entry(key, answers.node_id if is_other and answers.node_id is not None else fact.value, fact.source)
    direct, geared = (
        "the pulley sits on the encoder's shaft",
        "given with --gear: the encoder sits on the motor's shaft",
    )
    yield Entry("encoder_rev_per_pulley_rev", answers.gear, direct if answers.gear == 1.0 else geared)
    yield Entry("encoder_zero_rev", *_zero(answers))
    if answers.drive.takes_current_limit:
        yield Entry("current_limit_A", *limit)
    if answers.profile == "mit":
        low, high = _reach(answers)
        yield from (Entry(*each) for each in own_firmware(answers, plant, inertia_kg_m2, limit.value, (low, high)))


def _zero(answers: Answers) -> tuple[float, str]:
    if not answers.drive.tells_one_turn:
        return 0.0, "what the drive tells where the jaw is at 0"
    low, high = _reach(answers)
    centre_rev = (low + high) / 2.0 * answers.gear / (2.0 * math.pi)
    return 0.5 - centre_rev, "puts the middle of the motion at half a turn: the drive tells one turn alone"


def _reach(answers: Answers) -> tuple[float, float]:
    """Return the limits of the motor angle: the jaw's travel through the pulleys, and half of it more either way."""
    low, high = answers.jaw_min_rad / answers.radii, answers.jaw_max_rad / answers.radii
    return low - (high - low) / 2.0, high + (high - low) / 2.0


def _bench(answers: Answers, plant: Mapping[str, float]) -> Iterator[Entry]:
    for key, fact in answers.drive.bench.items():
        is_other = key == "node_id" and answers.node_id is not None
        yield Entry(key, answers.node_id if is_other and answers.node_id is not None else fact.value, fact.source)
    step_s = plant_step_s(plant)
    why = (
        "at most half of the fastest rate's time" if step_s is not None else "the default; the wire's rate isn't known"
    )
    yield Entry("plant_step_s", STEPS_S[0] if step_s is None else step_s, f"of the simulated plant: {why}")


def _limits(answers: Answers, inertia_kg_m2: float | None, limit: _Scaled) -> Iterator[Entry]:
    low, high = _reach(answers)
    travel = f"the jaw's {answers.jaw_min_rad:.4g} to {answers.jaw_max_rad:.4g} rad times r_j/r_m"
    why = f"{travel}, and half of the way more for the wire's stretch; narrow it to the mechanism's own stops"
    yield Entry("position_min_rad", low, why)
    yield Entry("position_max_rad", high, why)
    yield Entry("speed_max_rad_per_s", *_speed(answers))
    if inertia_kg_m2 is not None:
        most = answers.torque_constant_N_m_per_A * limit.value / inertia_kg_m2
        yield Entry("acceleration_max_rad_per_s2", most, "torque at the current limit over the inertia at the pulley")
    yield Entry("max_sample_age_s", answers.drive.max_sample_age_s.value, answers.drive.max_sample_age_s.source)
    if answers.tension_max_N is not None:
        yield Entry("tension_max_N", answers.tension_max_N, "given with --tension-max")


def _speed(answers: Answers) -> tuple[float, str]:
    """Return the lower of what the motor reaches and what its drive's angle can be followed at."""
    values, by_gear = answers.motor.values, 1.0 / abs(answers.gear)
    of_motor = values.nominal_speed_rad_per_s or values.no_load_speed_rad_per_s
    found = [(200.0, "the default; no speed is known of this motor")]
    if of_motor is not None:
        found = [_through_gear(answers, of_motor, by_gear)]
    if answers.drive.speed_max_rad_per_s is not None:
        found.append(_through_gear(answers, answers.drive.speed_max_rad_per_s, by_gear))
    return min(found)
