"""Cases drawn over all that a user may have: friction, laws, drives, encoders, motions, sensors, noise.

An effect's d is that in the case's own runs that are fitted (`own_sizes`), when it is hidden alone.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil_forceps.data.even_rows import EvenRun, even_rows
from hil_forceps.data.run import Run
from hil_forceps.diagnosis.identified import LIKE_A_LOAD
from hil_forceps.rig import Rig
from hil_forceps.rig.catalogue import EFFECT_IDS
from tests.hidden_effects.cases import drawn_effect, drawn_shifts
from tests.hidden_effects.generator import COLOURED, RIG, WHITE, Case, generate, run_seed, true_rig
from tests.hidden_effects.generator_scenarios import SCENARIOS
from tests.hidden_effects.generator_sizes import Effects
from tests.hidden_effects.own_sizes import own_size, sized

KINDS = ("none", "shift", "effect", "pair", "triple", "deleted")
FRICTION = (0.0, 0.02, 0.1, 0.3)  # of the load's torque, on motor and jaw
LOAD_N_M = 1.0e-3  # a usual load on the jaw, and the friction of both masses in units of it
MOTOR_SHARE, JAW_SHARE = 2.0, 1.0
LAWS: dict[str, dict[str, float]] = {
    "P": {"drive.ki_A_per_rad_s": 0.0, "drive.kd_A_s_per_rad": 0.0},
    "PI": {"drive.kd_A_s_per_rad": 0.0},
    "PD": {"drive.ki_A_per_rad_s": 0.0, "drive.kp_A_per_rad": 0.8, "drive.kd_A_s_per_rad": 0.009},
    "PID": {},
    "cascade": {
        "drive.kp_A_per_rad": 0.72,
        "drive.ki_A_per_rad_s": 36.0,
        "drive.kd_A_s_per_rad": 0.009,
        "drive.cascade_time_s": 0.0125,
    },
}
SAMPLE_TIMES_S = (2.5e-4, 5.0e-4, 1.0e-3, 2.0e-3)
COUNTS = (2048, 4096, 16384, 65536, None)
MOTIONS = (
    "multisine",
    "multisine_mid",
    "trapezoid",
    "chirp",
    "slow",
    "teleoperation",
    "grasp",
    "hold",
    "short_hold",
    "long_hold",
    "begun",
)
MOST_ROWS = 150_000
SIZES = (8.0, 12.0, 20.0, 50.0)
EFFECTS = tuple(name for name in EFFECT_IDS if name != "encoder_scale")  # a gauge: other radii give the same runs


@dataclass(frozen=True, slots=True)
class Drawn:
    """A case before anything is simulated."""

    kind: str
    seed: int
    friction: float
    law: str
    sample_time_s: float
    row_s: float
    counts: int | None
    motions: tuple[str, ...]  # those to fit first
    held_out: int  # how many of the last are
    jaw: bool
    load_cell: bool
    coloured: bool
    effects: tuple[str, ...] = ()
    size: float = 0.0


def draw(kind: str, seed: int, *, usual: bool = False) -> Drawn:
    """Draw a case; `usual`: a drive of 1 ms, every sample logged, all sensors, white noise, six runs."""
    rng = np.random.default_rng([seed, KINDS.index(kind), 0xD4A7])
    friction = FRICTION[seed % len(FRICTION)]
    law, sample_s = str(rng.choice(list(LAWS))), float(rng.choice(SAMPLE_TIMES_S))
    row_s = sample_s if sample_s >= 1.0e-3 or rng.random() < 0.5 else 1.0e-3
    counts = COUNTS[int(rng.integers(len(COUNTS)))]
    count = int(rng.choice((1, 2, 3, 4, 6, 9, 20), p=(0.1, 0.1, 0.15, 0.2, 0.25, 0.15, 0.05)))
    jaw, load_cell = [(True, True), (True, True), (True, True), (True, False), (False, True)][int(rng.integers(5))]
    coloured = bool(rng.random() < 0.3)
    if usual:
        sample_s = row_s = 1.0e-3
        count, jaw, load_cell, coloured = 6, True, True, False
    motions = [str(name) for name in rng.choice(MOTIONS, count)]
    while len(motions) > 1 and sum(SCENARIOS[name].duration_s for name in motions) / row_s > MOST_ROWS:
        motions.pop()
    many = {"effect": 1, "pair": 2, "triple": 3, "deleted": 1}.get(kind, 0)
    told = [name for name in EFFECTS if load_cell or name not in LIKE_A_LOAD]
    effects = tuple(str(name) for name in rng.choice(told, many, replace=False))
    size = float(rng.choice(SIZES if kind == "effect" else SIZES[2:])) if many else 0.0
    held_out = len(motions) // 3 if len(motions) > 2 else 0
    return Drawn(
        kind,
        seed,
        friction,
        law,
        sample_s,
        row_s,
        counts,
        tuple(motions),
        held_out,
        jaw,
        load_cell,
        coloured,
        effects,
        size,
    )


def assumed_rig(case: Drawn) -> Rig:
    """Return the rig that the diagnosis is told."""
    plant = {}
    if case.friction > 0.0:
        plant = {
            "forceps.motor_coulomb_N_m": MOTOR_SHARE * case.friction * LOAD_N_M,
            "forceps.jaw_coulomb_N_m": JAW_SHARE * case.friction * LOAD_N_M,
        }
    drive = {**LAWS[case.law], "drive.sample_time_s": case.sample_time_s}
    return RIG.with_changes({**plant, **drive, "encoder.counts_per_rev": case.counts or "ideal"})


def hidden(case: Drawn) -> dict[str, dict[str, float]]:
    """Return the effects, each of its size in the runs to be fitted; ValueError where no size shows as much."""
    rig, fitted = assumed_rig(case), case.motions[: len(case.motions) - case.held_out]

    def own(effects: Effects) -> float:
        true = true_rig(rig, effects, {})
        ((effect_id, values),) = effects.items()
        if abs(values.get("current_s", math.inf)) < case.sample_time_s:
            return 0.0  # of a current that is constant between the drive's samples, no skew within one shows
        return own_size(_even(_runs(case, true, fitted), rig), rig, true, effect_id)

    found: dict[str, dict[str, float]] = {}
    for name in case.effects:
        found |= sized(case.size, name, drawn_effect(name, case.seed), own)
    return found


def make(case: Drawn) -> Case:
    """Simulate the runs of a case."""
    rig = assumed_rig(case)
    true = true_rig(rig, hidden(case), drawn_shifts(case.seed) if case.kind == "shift" else {})
    runs = _runs(case, true, case.motions)
    split = len(runs) - case.held_out
    return Case(rig, true, tuple(runs[:split]), tuple(runs[split:]))


def even_parts(case: Case) -> tuple[list[EvenRun], list[EvenRun]]:
    """Return the runs to fit and those held out with equally spaced rows."""
    return _even(case.fit, case.assumed), _even(case.held_out, case.assumed)


def _runs(case: Drawn, true: Rig, motions: Sequence[str]) -> list[Run]:
    """Return runs of a rig with the sensors and the noise of a case."""
    dropped = {name for name, kept in (("theta_j_rad", case.jaw), ("tau_w_N_m", case.load_cell)) if not kept}
    runs = []
    for place, name in enumerate(motions):
        scenario = replace(SCENARIOS[name], row_s=case.row_s)
        noise = COLOURED if case.coloured else WHITE
        run = generate(true, scenario, run_seed(case.seed, place), noise, f"{place}_{name}")
        runs.append(Run(run.name, {key: values for key, values in run.columns.items() if key not in dropped}))
    return runs


def _even(runs: Sequence[Run], rig: Rig) -> list[EvenRun]:
    return [even for run in runs if (even := even_rows(run, rig))]
