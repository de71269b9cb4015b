"""Runs of a forceps with hidden effects, for the tests of the diagnosis: shares no code with the diagnosing model.

The plant and its effects are those of `virtual_bus`. Everything is drawn from seeds: same arguments, same bytes.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil_forceps.data.readers import csv_table
from hil_forceps.data.run import Run
from hil_forceps.rig import Rig
from hil_forceps.rig.schema import rig_from_data
from tests.hidden_effects.generator_scenarios import NO_ENVIRONMENT, SCENARIOS, Scenario, course_of
from virtual_bus.drive import loop_of
from virtual_bus.effects.composition import EffectNumbers, encoder_angle
from virtual_bus.effects.numbers import effect_numbers
from virtual_bus.effects.start import rest_with_effects
from virtual_bus.logs import Log, simulated_log
from virtual_bus.plant.load import LoadProfile
from virtual_bus.plant.plant import TruthParameters, truth_parameters

PLANT_STEP_S = 5.0e-5
PAD_S = 0.12  # simulated before and after the rows: a skewed channel shows up to 0.1 s from there
STARTS = 20  # rounds in which the start is found: each leaves a few per cent of the error
LEAD_S = 2.0  # simulated before the rows of a run that begins mid-motion
CHANNELS = ("theta_m_rad", "current_A", "theta_j_rad", "tau_w_N_m")

RIG = rig_from_data(
    {
        "forceps": {
            "motor_pulley_radius_m": 2.0e-3,
            "jaw_pulley_radius_m": 1.4e-3,
            "motor_inertia_kg_m2": 3.18e-8,
            "jaw_inertia_kg_m2": 6.85e-8,
            "motor_viscous_N_m_s_per_rad": 1.16e-4,
            "motor_coulomb_N_m": 4.62e-7,
            "jaw_coulomb_N_m": 4.62e-9,
            "wire_stiffness_N_per_m": 2.6e4,
        },
        "motor": {"torque_constant_N_m_per_A": 1.35e-2},
        "encoder": {"counts_per_rev": 16384},
        "drive": {
            "sample_time_s": 1.0e-3,
            "kp_A_per_rad": 1.2,
            "ki_A_per_rad_s": 15.0,
            "kd_A_s_per_rad": 0.006,
            "derivative_cutoff_Hz": 150.0,
            "current_limit_A": 1.0,
        },
        "noise": {"current_A": 1.0e-3, "theta_j_rad": 2.0e-4, "tau_w_N_m": 1.0e-5},
    }
)
OTHER_GAINS_RIG = RIG.with_changes(
    {"drive.kp_A_per_rad": 0.8, "drive.ki_A_per_rad_s": 0.0, "drive.kd_A_s_per_rad": 0.009}
)
FAST_DRIVE_RIG = RIG.with_changes({"drive.sample_time_s": 5.0e-4})


@dataclass(frozen=True, slots=True)
class NoiseKind:
    """Sensor noise: white, or first-order autoregressive with this correlation from row to row; sd from the rig."""

    correlation: float = 0.0


WHITE = NoiseKind()
COLOURED = NoiseKind(0.9)


def quantum_rad(rig: Rig) -> float:
    """Return the step of the encoder, 0 for an ideal one."""
    counts = rig.encoder.counts_per_rev
    return 0.0 if counts is None else 2.0 * math.pi / counts


def simulate(
    rig: Rig,
    scenario: Scenario,
    seed: int,
    *,
    ideal: bool = False,
    rounding_rad: NDArray[np.float64] | None = None,
    load: LoadProfile | None = None,
    step_s: float = PLANT_STEP_S,
) -> tuple[NDArray[np.float64], Log]:
    """Return the reference and the log of a run without noise.

    `ideal`: the encoder doesn't count either. The drive then reads what `rounding_rad` adds, sample by sample. `load`:
    instead of the scenario's load and of what the jaw touches there.
    """
    law = rig.require_drive()
    course = course_of(scenario, seed)
    logged = _logged(rig, scenario)
    lead, rows = logged.start, logged.stop - logged.start
    pad = round(PAD_S / law.sample_time_s)
    time_s = np.arange(-lead, rows + pad, dtype=np.float64) * law.sample_time_s
    # A run from rest waits at its first reference; one from mid-motion moves there on its way.
    reference = course.reference(time_s if scenario.mid_motion else np.maximum(time_s, 0.0))
    plant, effects = truth_parameters(rig.plant(), step_s), effect_numbers(rig.effects)
    log = simulated_log(
        plant,
        effects,
        loop_of(rig),
        0.0 if ideal else quantum_rad(rig),
        reference,
        course.load if load is None else load,
        logged,
        jaw_start_rad(plant, effects, float(reference[0])),
        step_s,
        course.environment if load is None else NO_ENVIRONMENT,
        rounding_rad,
    )
    return reference[logged], log


def _logged(rig: Rig, scenario: Scenario) -> slice:
    """Return which samples of the drive are rows of a log."""
    period_s = rig.require_drive().sample_time_s
    per_row = round(scenario.row_s / period_s)
    if per_row < 1 or not math.isclose(per_row * period_s, scenario.row_s):
        raise ValueError(f"rows every {scenario.row_s} s don't fall on samples of {period_s} s")
    lead = round((LEAD_S if scenario.mid_motion else PAD_S) / period_s)
    return slice(lead, lead + round(scenario.duration_s / scenario.row_s) * per_row, per_row)


def jaw_start_rad(plant: TruthParameters, effects: EffectNumbers, reference_rad: float) -> float:
    """Return where the jaw rests when the drive holds its encoder at the reference."""
    ratio = plant.motor_pulley_radius_m / plant.jaw_pulley_radius_m
    theta_j = ratio * reference_rad
    for _ in range(STARTS):
        shown = encoder_angle(effects, float(rest_with_effects(plant, effects, theta_j)[0]))
        theta_j += ratio * (reference_rad - shown)
    return theta_j


def answer(rig: Rig, load: LoadProfile, rows: int, row_s: float) -> Log:
    """Return what a load does to a drive that holds still at 0, without noise and without the encoder's counting."""
    law = rig.require_drive()
    per_row = round(row_s / law.sample_time_s)
    pad = round(PAD_S / law.sample_time_s)
    return simulated_log(
        truth_parameters(rig.plant(), PLANT_STEP_S),
        effect_numbers(rig.effects),
        loop_of(rig),
        0.0,
        np.zeros(rows * per_row + 2 * pad),
        load,
        slice(pad, pad + rows * per_row, per_row),
        0.0,
        PLANT_STEP_S,
        NO_ENVIRONMENT,
    )


def generate(rig: Rig, scenario: Scenario, seed: int, noise: NoiseKind = WHITE, name: str = "") -> Run:
    """Make one run: the closed loop on the plant with the rig's effects, its encoder's counts and its sensors' noise.

    What happens is drawn from `seed` and the scenario; the noise from `seed` alone, a stream for each sensor.
    """
    reference, log = simulate(rig, scenario, seed)
    columns: dict[str, NDArray[np.float64]] = {channel: getattr(log, channel).copy() for channel in CHANNELS}
    deviations = {
        "current_A": rig.noise.current_A,
        "theta_j_rad": rig.noise.theta_j_rad,
        "tau_w_N_m": rig.noise.tau_w_N_m,
    }
    streams = np.random.SeedSequence([seed, 0x5EED]).spawn(len(deviations))
    for (channel, deviation), stream in zip(deviations.items(), streams, strict=True):
        columns[channel] += deviation * _noise(np.random.default_rng(stream), reference.size, noise)
    time_s = np.arange(reference.size, dtype=np.float64) * scenario.row_s
    return Run(name or f"{scenario.kind}_{seed}", {"time_s": time_s, "theta_m_ref_rad": reference, **columns})


def _noise(rng: np.random.Generator, rows: int, kind: NoiseKind) -> NDArray[np.float64]:
    values = rng.standard_normal(rows)
    if kind.correlation != 0.0:
        fresh = math.sqrt(1.0 - kind.correlation**2)
        for k in range(1, rows):
            values[k] = kind.correlation * values[k - 1] + fresh * values[k]
    return values


def write_csv(run: Run, path: str | Path) -> None:
    """Write a run as a table of the contract's form."""
    csv_table.write_csv(run, path)


@dataclass(frozen=True, slots=True)
class Case:
    """A set of runs with what is hidden in them."""

    assumed: Rig  # what the diagnosis is told
    true: Rig  # what made the runs
    fit: tuple[Run, ...]
    held_out: tuple[Run, ...]

    @property
    def runs(self) -> tuple[Run, ...]:
        """All of them, those to fit first."""
        return self.fit + self.held_out


FIT_SCENARIOS = ("multisine", "trapezoid", "chirp", "multisine_mid")
HELD_OUT_SCENARIOS = ("teleoperation", "slow")


def make_case(
    effects: Mapping[str, Mapping[str, float]],
    seed: int,
    *,
    scenarios: tuple[Sequence[str], Sequence[str]] = (FIT_SCENARIOS, HELD_OUT_SCENARIOS),
    shifts: Mapping[str, float] | None = None,
    drop: Sequence[str] = (),
    noise: NoiseKind = WHITE,
    rig: Rig = RIG,
) -> Case:
    """Make a set of runs with `effects` in the plant.

    `scenarios`: names of those to fit and of those of other kinds. `shifts`: dotted key -> factor on the true value of
    a parameter. `drop`: columns that weren't measured. KeyError for a name that isn't one of `SCENARIOS`.
    """
    true = true_rig(rig, effects, shifts or {})
    runs = []
    for place, name in enumerate([*scenarios[0], *scenarios[1]]):
        run = generate(true, SCENARIOS[name], run_seed(seed, place), noise, f"{place}_{name}")
        kept = {column: values for column, values in run.columns.items() if column not in drop}
        runs.append(Run(run.name, kept))
    split = len(scenarios[0])
    return Case(rig, true, tuple(runs[:split]), tuple(runs[split:]))


def run_seed(seed: int, place: int) -> int:
    """Return the seed of one run of a set."""
    return 1000 * seed + place


def true_rig(rig: Rig, effects: Mapping[str, Mapping[str, float]], shifts: Mapping[str, float]) -> Rig:
    """Return the rig with effects in it and with parameters times a factor."""
    changes: dict[str, object] = {"effects": {name: dict(values) for name, values in effects.items()}}
    plant = rig.plant()
    for key, factor in shifts.items():
        changes[key] = getattr(plant, key.partition(".")[2]) * factor
    return rig.with_changes(changes)
