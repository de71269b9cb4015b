"""Logs of sessions of one instrument whose parameters scatter from session to session, and drift."""

from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from hil_forceps.data.readers.parquet_table import write_parquet
from hil_forceps.data.run import Run
from hil_forceps.rig import Rig
from hil_forceps.rig.loading import dump_rig
from tests.hidden_effects.generator import RIG, generate
from tests.hidden_effects.generator_scenarios import Scenario

ASSUMED = RIG.with_changes({"forceps.motor_coulomb_N_m": 1e-4, "forceps.jaw_coulomb_N_m": 5e-5})
FRICTION = "forceps.motor_coulomb_N_m"
JAW_FRICTION = "forceps.jaw_coulomb_N_m"
VISCOSITY = "forceps.motor_viscous_N_m_s_per_rad"
STIFFNESS = "forceps.wire_stiffness_N_per_m"
TORQUE_CONSTANT = "motor.torque_constant_N_m_per_A"
# What differs between sessions, as a share: friction and grease with temperature, a wire as it lies, warm magnets.
SCATTER = {FRICTION: 0.03, JAW_FRICTION: 0.03, VISCOSITY: 0.02, STIFFNESS: 5e-3, TORQUE_CONSTANT: 2e-3}
KINDS = ("multisine", "teleoperation", "trapezoid", "chirp", "slow", "grasp")
FIRST_DAY = datetime(2026, 1, 5, 9, 30, tzinfo=UTC)


def shares_of(number: int, drift: Mapping[str, float], seed: int) -> dict[str, float]:
    """Return each parameter of a session as a share of what is assumed."""
    rng = np.random.default_rng([seed, number])
    return {name: drift.get(name, 1.0) * (1.0 + sd * rng.standard_normal()) for name, sd in SCATTER.items()}


def true_rig(shares: Mapping[str, float]) -> Rig:
    """Return the rig that a session has."""
    plant = ASSUMED.plant()
    return ASSUMED.with_changes(
        {name: float(share * getattr(plant, name.partition(".")[2])) for name, share in shares.items()}
    )


def run_of(number: int, drift: Mapping[str, float], seed: int, duration_s: float) -> tuple[Run, Rig]:
    """Return the run of a session, and the rig that made it."""
    rig = true_rig(shares_of(number, drift, seed))
    scenario = Scenario(KINDS[number % len(KINDS)], duration_s)
    return generate(rig, scenario, 1000 * seed + number), rig


def file_name(number: int) -> str:
    """Return the name of a session's log: two sessions a day, but none at weekends."""
    day, turn = divmod(number, 2)
    date = FIRST_DAY + timedelta(days=7 * (day // 5) + day % 5, hours=4 * turn)
    return f"{date:%Y-%m-%d_%H%M}"


def write_sessions(
    folder: Path, count: int, duration_s: float, *, onset: int, rise_a_session: float, seed: int = 0, first: int = 0
) -> None:
    """Write the logs from `first` to `count`, and their rig; from `onset` on dry friction rises."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "rig.yaml").write_text(dump_rig(ASSUMED), encoding="utf-8")
    for number in range(first, count):
        rise = 1.0 + rise_a_session * max(0, number - onset + 1)
        run, _ = run_of(number, {FRICTION: rise}, seed, duration_s)
        write_parquet(run, folder / f"{file_name(number)}.parquet")
