"""The catalogue of effects: what a rig file may hold under `effects:`, with equations, units and physical ranges.

Plain data; each entry is a file in `hil_forceps/effects`. The model and the simulated world implement each on their
own, from these equations:

    law      i_ref: the drive's law on θ_enc; i_ref → deadband → saturation → delay → lag → i (true current)
    sensors  i_meas = (1 + g) i + i0;  θ_enc = quantised((1 + s) θ_m + A_s sin θ_m + A_c cos θ_m);  a skewed channel is
             recorded as it was T_s earlier (in the log alone, not in the loop)
    motor    I_m ω̇_m = K_t(t) i (1 + ripple(θ_m)) + cogging(θ_m) − D(t, ω_m) ω_m − F_m − r(θ_p) f
    play     θ_p = θ_m − p,  |p| ≤ ψ,  ṗ = ω_m, but 0 where p would leave ±ψ; without play θ_p = θ_m
    wire     x = wound(θ_p) − paid(θ_j),  wound' = r(θ_p),  paid' = r_j(θ_j);  e = x − x0 − x_c;  d = dz(e, δ)
             f = k d (1 + β d²) + c ẋ [where d ≠ 0 or δ = 0] + h z
    jaw      I_j ω̇_j = r_j(θ_j) f − F_j(θ_j) − gravity(θ_j) − coupling(θ_j) − τ_w
    friction F = level · sgn ω while moving; at rest whatever holds, up to the level

Times of drifts count from the first row of a run (in the world: from the start of the load profile or of the run).
"""

from collections.abc import Iterator
from importlib import import_module
from pkgutil import iter_modules

from hil_forceps import effects
from hil_forceps.effects.entry import Effect, Location, Parameter

__all__ = ["EFFECTS", "EFFECT_IDS", "MODULES", "Effect", "Location", "Parameter", "effect"]

# As tables show them. An entry that isn't named here comes behind these.
_ORDER = (
    "stribeck_friction",
    "presliding_friction",
    "load_dependent_friction",
    "coulomb_asymmetry",
    "viscous_drift",
    "jaw_position_friction",
    "jaw_gravity",
    "wire_slack",
    "wire_hardening",
    "wire_hysteresis",
    "wire_creep",
    "wire_damping",
    "wire_permanent_stretch",
    "torque_constant_drift",
    "cogging",
    "torque_ripple",
    "current_offset",
    "current_gain",
    "amplifier_deadband",
    "electrical_lag",
    "actuation_delay",
    "channel_skew",
    "encoder_eccentricity",
    "encoder_scale",
    "pulley_eccentricity",
    "spool_radius_change",
    "current_saturation",
    "transmission_play",
    "transmission_curve",
    "jaw_coupling",
    "loaded_presliding",
    "viscous_asymmetry",
    "film_friction",
    "jaw_presliding",
    "jaw_viscous_friction",
)


def _found() -> Iterator[tuple[str, Effect]]:
    for room in iter_modules(effects.__path__, f"{effects.__name__}."):
        if room.ispkg:
            for module in iter_modules(import_module(room.name).__path__, f"{room.name}."):
                entry = import_module(module.name).EFFECT
                if module.name.rpartition(".")[2] != entry.id:
                    raise ValueError(f"{module.name} holds the effect {entry.id!r}; a file is named like its effect")
                yield module.name, entry


_FOUND = sorted(_found(), key=lambda found: (*_ORDER, found[1].id).index(found[1].id))
EFFECTS: tuple[Effect, ...] = tuple(entry for _, entry in _FOUND)
EFFECT_IDS = tuple(entry.id for entry in EFFECTS)
MODULES = {entry.id: module for module, entry in _FOUND}  # where each entry's equations are


def effect(effect_id: str) -> Effect:
    """Return an entry of the catalogue; KeyError for an id that isn't in it."""
    for entry in EFFECTS:
        if entry.id == effect_id:
            return entry
    raise KeyError(effect_id)
