"""Runs of the simulated world for the tests of the state-space model, and what they are filtered with."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from hil_forceps.data.even_rows import EvenRun
from hil_forceps.data.run import Run
from hil_forceps.diagnosis.inference.parameters import Free, known_parameters
from hil_forceps.diagnosis.preparation.records import Record, record_of
from hil_forceps.diagnosis.state_space.layout import Noise
from hil_forceps.rig import Rig
from tests.hidden_effects.generator import RIG, generate
from tests.hidden_effects.generator_scenarios import SCENARIOS, Course, Scenario
from virtual_bus.plant.load import piecewise_linear

STICKING = RIG.with_changes({"forceps.motor_coulomb_N_m": 2e-4, "forceps.jaw_coulomb_N_m": 1e-4})
POOL = ThreadPoolExecutor(2)


def records_of(runs: Sequence[Run], rig: Rig) -> list[Record]:
    noise = Noise(np.array([rig.noise.theta_j_rad, rig.noise.tau_w_N_m, rig.noise.current_A]), np.zeros(3), np.zeros(3))
    return [record_of(EvenRun.whole(run), rig, noise) for run in runs]


def runs_of(rig: Rig, kinds: Sequence[str], seed: int, row_s: float = 1e-3) -> list[Run]:
    scenarios = [replace(SCENARIOS[kind], row_s=row_s) for kind in kinds]
    return [generate(rig, scenarios[i], seed + i, name=f"{i}_{kind}") for i, kind in enumerate(kinds)]


def known_of(rig: Rig) -> tuple[Free, ...]:
    return known_parameters(rig, 4e-3, jaw_measured=True, torque_measured=True)


def held(rng: np.random.Generator, _: Scenario) -> Course:
    """Close, hold for seconds while a load comes and goes, the drive's integral hunting over one count."""
    to, load, on = float(rng.uniform(0.4, 0.8)), float(rng.uniform(1e-3, 2e-3)), float(rng.uniform(2.0, 3.0))
    off = float(rng.uniform(7.0, 9.0))
    return Course(
        lambda t: np.asarray(np.interp(t, [0.5, 1.5], [0.0, to])),
        piecewise_linear([-3.0, on, on + 0.02, off, off + 0.02], [0.0, 0.0, load, load, 0.0]),
    )


def begun_in_the_friction_band(rng: np.random.Generator, _: Scenario) -> Course:
    """At rest under a load that the jaw's friction holds, then a sine."""
    reach, frequency, on = float(rng.uniform(0.4, 0.8)), float(rng.uniform(0.3, 0.6)), float(rng.uniform(3.0, 3.5))
    return Course(
        lambda t: np.where(t < 0.5, 0.0, reach * np.sin(2.0 * np.pi * frequency * np.maximum(t - 0.5, 0.0))),
        piecewise_linear([-3.0, on - 0.5, on], [8e-5, 8e-5, 1.5e-3]),
    )
