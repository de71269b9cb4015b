"""The cases of the campaign: what is hidden in which runs, all from seeds; any first part of them is a sample."""

import math
from dataclasses import dataclass

import numpy as np

from hil_forceps.rig import Rig
from hil_forceps.rig.catalogue import EFFECT_IDS, EFFECTS, Effect, effect
from tests.hidden_effects.generator import COLOURED, FAST_DRIVE_RIG, OTHER_GAINS_RIG, RIG, WHITE, NoiseKind

SIZES = (8.0, 12.0, 20.0, 50.0)
LARGE_SIZES = (200.0, 1000.0)
SCENARIO_SETS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {  # fitted, held out
    "mixed": (("multisine", "trapezoid", "chirp", "multisine_mid"), ("teleoperation", "slow")),
    "work": (("teleoperation", "slow", "grasp", "multisine"), ("trapezoid", "chirp")),
    "turns": (("spin", "trapezoid", "slow", "chirp"), ("teleoperation", "multisine")),
}
REST = (("rest", "rest"), ("rest",))
RIGS: dict[str, Rig] = {"rig": RIG, "other_gains": OTHER_GAINS_RIG, "fast_drive": FAST_DRIVE_RIG}
NOISES: dict[str, NoiseKind] = {"white": WHITE, "coloured": COLOURED}
PER_ROUND = {  # how many of each kind a round has
    "effect": len(EFFECT_IDS),
    "none": 8,
    "shift": 8,
    "pair": 6,
    "triple": 2,
    "deleted": 6,
    "no_jaw": 3,
    "other_controller": 3,
    "fast_drive": 2,
    "uninformative": 2,
    "large": 4,  # last: what the others draw hangs on the order
}
ROUNDS = 25  # gives the 200 seeds without effect and with shifts only that the figures need
SHIFTED = (
    "forceps.wire_stiffness_N_per_m",
    "forceps.motor_viscous_N_m_s_per_rad",
    "forceps.motor_inertia_kg_m2",
    "forceps.jaw_inertia_kg_m2",
    "forceps.motor_coulomb_N_m",
    "motor.torque_constant_N_m_per_A",
)
LARGEST_SHIFT = 0.25  # of the logarithm
FRICTION_SHIFT = 6.0  # times as much: its prior is that wide
RANGES: dict[str, dict[str, tuple[float, float]]] = {  # of shape parameters, drawn evenly in the logarithm
    entry.id: hidden
    for entry in EFFECTS
    if (hidden := {parameter.name: parameter.hidden for parameter in entry.parameters if parameter.hidden})
}
HARMONICS = (4, 6, 7, 9, 12, 18, 24)


@dataclass(frozen=True, slots=True)
class Spec:
    """A case before anything is simulated."""

    id: str
    kind: str
    effects: tuple[str, ...]
    size: float  # d of each effect; 0 without any
    seed: int
    scenarios: str
    noise: str = "white"
    rig: str = "rig"
    drop: tuple[str, ...] = ()
    shifted: bool = False
    deleted: bool = False  # the effects are missing from the catalogue


def specs(rounds: int = ROUNDS, first: int = 0) -> list[Spec]:
    """Return all cases; every kind is spread evenly over each round, and every round holds every effect."""
    return [spec for number in range(first, rounds) for spec in _round(number)]


def _round(number: int) -> list[Spec]:
    rng = np.random.default_rng([number, 0xCA5E])
    order = [EFFECT_IDS[i] for i in rng.permutation(len(EFFECT_IDS))]
    placed = [
        ((place + 0.5) / count, _spec(kind, number, place, order, rng))
        for kind, count in PER_ROUND.items()
        for place in range(count)
    ]
    return [spec for _, spec in sorted(placed, key=lambda item: item[0])]


def _spec(kind: str, number: int, place: int, order: list[str], rng: np.random.Generator) -> Spec:
    seed = 10_000 + 100 * number + place
    sets = list(SCENARIO_SETS)
    scenarios = sets[(number + place) % len(sets)]
    noise = ("white", "coloured")[place % 2]
    many = {"effect": 1, "pair": 2, "triple": 3, "none": 0, "shift": 0}.get(kind, 1)
    if kind == "effect":
        effects: tuple[str, ...] = (order[place],)
        # Each effect meets each size and each set of runs within 4 × 3 rounds.
        at = EFFECT_IDS.index(order[place])
        size, scenarios, noise = SIZES[(number + at) % 4], sets[(number // 4 + at) % 3], "white"
    else:
        effects = tuple(str(name) for name in rng.choice(EFFECT_IDS, many, replace=False))
        size = (LARGE_SIZES if kind == "large" else (20.0, 50.0))[place % 2] if many else 0.0
    if kind not in {"none", "shift"}:
        noise = "white"
    if kind == "uninformative":
        scenarios = "rest" if place % 2 == 0 else scenarios
    drop: tuple[str, ...] = ("theta_j_rad",) if kind == "no_jaw" else ()
    if kind == "uninformative" and place % 2 == 1:
        drop = ("theta_j_rad", "tau_w_N_m")
    rig = {"other_controller": "other_gains", "fast_drive": "fast_drive"}.get(kind, "rig")
    words = [kind, "+".join(effects), f"d{size:g}" if many else noise, scenarios, f"s{seed}"]
    return Spec(
        "/".join(word for word in words if word),
        kind,
        effects,
        size,
        seed,
        scenarios,
        noise,
        rig,
        drop,
        kind == "shift",
        kind == "deleted",
    )


def drawn_shifts(seed: int) -> dict[str, float]:
    """Return factors on two or three known parameters."""
    rng = np.random.default_rng([seed, 0x5417])
    names = rng.choice(SHIFTED, int(rng.integers(2, 4)), replace=False)
    shifts = {}
    for name in names:
        reach = LARGEST_SHIFT * (FRICTION_SHIFT if "coulomb" in name else 1.0)
        shifts[str(name)] = float(np.exp(rng.uniform(-reach, reach)))
    return shifts


def drawn_effect(effect_id: str, seed: int) -> dict[str, float]:
    """Return parameters of an effect: shape and direction from the seed, amplitude as the catalogue has it."""
    rng = np.random.default_rng([seed, EFFECT_IDS.index(effect_id)])
    entry = effect(effect_id)
    values: dict[str, float] = {}
    for name, (low, high) in RANGES.get(effect_id, {}).items():
        values[name] = float(np.exp(rng.uniform(math.log(low), math.log(high))))
    if any(p.name == "harmonic" for p in entry.parameters):
        values["harmonic"] = float(rng.choice(HARMONICS))
    return values | _amplitudes(entry, rng)


def _amplitudes(entry: Effect, rng: np.random.Generator) -> dict[str, float]:
    amplitudes = [p for p in entry.parameters if p.neutral is not None]
    if entry.id == "channel_skew":  # one channel is late
        amplitudes = [amplitudes[int(rng.integers(len(amplitudes)))]]
    if not amplitudes:  # a limit: its shape is all there is
        return {}
    sign = float(rng.choice((-1.0, 1.0)))
    if len(amplitudes) == 1:
        p = amplitudes[0]
        return {p.name: abs(p.typical) * (sign if p.minimum < 0.0 else 1.0)}
    angle = float(rng.uniform(0.0, 2.0 * math.pi))
    parts = (math.cos(angle), math.sin(angle))
    return {p.name: abs(p.typical) * part for p, part in zip(amplitudes, parts, strict=True)}
