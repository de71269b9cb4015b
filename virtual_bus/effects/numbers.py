"""The numbers of a rig's `effects:` as the flat tuple that kernels take."""

import math
from collections.abc import Mapping

from hil_forceps.rig.catalogue import EFFECT_IDS, EFFECTS, Effect, effect
from hil_forceps.rig.errors import UserError
from virtual_bus.effects.composition import EffectNumbers

_SHAPE_WHILE_OFF = 1.0  # any length or time that can be divided by
_OFF = {"current_saturation": math.inf}


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
