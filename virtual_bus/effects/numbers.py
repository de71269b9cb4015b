"""What a rig's `effects:` adds to the truth plant, as one flat tuple of numbers that kernels take."""

import math
from collections.abc import Mapping
from typing import NamedTuple

from hil_forceps.rig.catalogue import EFFECT_IDS, EFFECTS, Effect, effect
from hil_forceps.rig.errors import UserError

_SHAPE_WHILE_OFF = 1.0  # any length or time that can be divided by
_OFF = {"current_saturation": math.inf}


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
    play: float
    lever_sine: float
    lever_cosine: float
    coupling_stiffness: float
    coupling_torque: float
    loaded_mu: float
    loaded_angle: float
    viscous_asymmetry: float
    film_level: float
    film_speed: float
    grip_level: float
    grip_mu: float
    grip_angle: float
    jaw_viscous: float


def effect_numbers(effects: Mapping[str, Mapping[str, float]]) -> EffectNumbers:
    """Make numbers of a rig's `effects`; what isn't given is neutral, and an effect that does nothing is as if absent.

    UserError for a shape that isn't given and for names that the catalogue doesn't have.
    """
    if problems := [line for effect_id, given in effects.items() for line in _problems(effect_id, given)]:
        raise UserError(problems)
    return EffectNumbers(*(number for effect in EFFECTS for number in _numbers(effect, effects.get(effect.id))))


def _problems(effect_id: str, given: Mapping[str, float]) -> list[str]:
    if effect_id not in EFFECT_IDS:
        return [f"effects.{effect_id}: is no effect of the catalogue"]
    parameters = effect(effect_id).parameters
    unknown = set(given) - {p.name for p in parameters}
    missing = [p for p in parameters if p.neutral is None and p.name not in given]
    return [f"effects.{effect_id}.{name}: is no parameter of this effect" for name in sorted(unknown)] + [
        f"effects.{effect_id}.{p.name}: is missing; give the {p.meaning}" for p in missing
    ]


def _numbers(entry: Effect, given: Mapping[str, float] | None) -> list[float]:
    amplitudes = [p for p in entry.parameters if p.neutral is not None]
    if given is None or (amplitudes and all(given.get(p.name, p.neutral) == p.neutral for p in amplitudes)):
        return [_OFF.get(entry.id, _SHAPE_WHILE_OFF) if p.neutral is None else p.neutral for p in entry.parameters]
    return [float(given.get(p.name, p.neutral or 0.0)) for p in entry.parameters]
