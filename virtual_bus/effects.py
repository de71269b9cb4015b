"""What a rig's `effects:` adds to the truth plant, as one flat tuple of numbers that kernels take."""

import math
from collections.abc import Mapping
from typing import NamedTuple

from hil_forceps.rig.catalogue import EFFECTS
from hil_forceps.rig.errors import UserError

_SHAPE_WHILE_OFF = 1.0  # any length or time that can be divided by
_NO_LIMIT_A = math.inf


class EffectNumbers(NamedTuple):
    """Every parameter of every effect, SI floats, in the order of the catalogue; its docstring has the equations."""

    stribeck_rise: float
    stribeck_speed: float
    presliding_level: float
    presliding_angle: float
    mu: float
    asymmetry: float
    viscous_change: float
    viscous_time: float
    jaw_slope: float
    jaw_curvature: float
    gravity_sine: float
    gravity_cosine: float
    slack: float
    beta: float
    hysteresis_force: float
    hysteresis_stretch: float
    creep_share: float
    creep_time: float
    damping: float
    stretch: float
    constant_change: float
    constant_time: float
    cogging_sine: float
    cogging_cosine: float
    cogging_harmonic: float
    ripple_sine: float
    ripple_cosine: float
    ripple_harmonic: float
    current_offset: float
    current_error: float
    deadband: float
    lag: float
    delay: float
    skew_theta_m: float
    skew_current: float
    skew_theta_j: float
    skew_tau_w: float
    encoder_sine: float
    encoder_cosine: float
    encoder_error: float
    pulley_sine: float
    pulley_cosine: float
    spool_pitch: float
    saturation: float


def effect_numbers(effects: Mapping[str, Mapping[str, float]]) -> EffectNumbers:
    """Make numbers of a rig's `effects`; what isn't given is neutral. UserError for a shape that isn't given."""
    numbers: list[float] = []
    problems: list[str] = []
    for effect in EFFECTS:
        given = effects.get(effect.id)
        for parameter in effect.parameters:
            if given is not None and parameter.name in given:
                numbers.append(float(given[parameter.name]))
            elif parameter.neutral is not None:
                numbers.append(parameter.neutral)
            elif given is None:
                numbers.append(_NO_LIMIT_A if effect.id == "current_saturation" else _SHAPE_WHILE_OFF)
            else:
                problems.append(f"effects.{effect.id}: {parameter.name} is missing; give the {parameter.meaning}")
    if problems:
        raise UserError(problems)
    return EffectNumbers(*numbers)


def acting(effects: Mapping[str, Mapping[str, float]]) -> dict[str, Mapping[str, float]]:
    """Return the effects that do something: those with any amplitude, or any limit, that isn't neutral."""
    by_id = {effect.id: effect for effect in EFFECTS}
    found: dict[str, Mapping[str, float]] = {}
    for effect_id, given in effects.items():
        amplitudes = [p for p in by_id[effect_id].parameters if p.neutral is not None]
        if not amplitudes or any(given.get(p.name, p.neutral) != p.neutral for p in amplitudes):
            found[effect_id] = given
    return found
