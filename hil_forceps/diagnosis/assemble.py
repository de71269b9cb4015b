"""From runs and a rig to a fitting problem, and to the first guess of its noise."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis import linear, predict_driven
from hil_forceps.diagnosis.assemble_driven import driven_problem
from hil_forceps.diagnosis.experiment import Record
from hil_forceps.diagnosis.first_rows import make_starts
from hil_forceps.diagnosis.fit import chi2_of
from hil_forceps.diagnosis.load_errors import with_load_errors
from hil_forceps.diagnosis.mapper import Mapper
from hil_forceps.diagnosis.predict import REFERENCES, ClosedLoop, samples_per_row
from hil_forceps.diagnosis.predict_driven import Driven
from hil_forceps.diagnosis.problem import Problem
from hil_forceps.diagnosis.spectrum import make_layout, transform, white_noise
from hil_forceps.diagnosis.unknowns import Unknowns, known_parameters
from hil_forceps.model import drive_law, parameters
from hil_forceps.rig import Rig
from hil_forceps.rig.plant import PlantParameters

Vector = NDArray[np.float64]

ZERO_SD_RAD = 2e-3  # of a jaw sensor's zero from run to run
INTEGRAL_SHARE = 0.003  # of the current seen: how well the drive's integral at the start is known
LEAST_INTEGRAL_A = 5e-4


class Setting(NamedTuple):
    """A problem with the pieces it was made of."""

    problem: Problem
    simulator: ClosedLoop | Driven
    floor: Vector  # least noise power of each band
    first_power: Vector  # first guess of it


def assemble(records: Sequence[Record], rig: Rig, mapper: Mapper, shared: Unknowns | None = None) -> Setting:
    """Make the problem of fitting a rig's known parameters to runs, in closed loop or driven as the records say."""
    if records[0].mode == "driven":
        problem, driven = driven_problem(records, rig, mapper, shared)
        power = first_noise(driven, problem.layout.band_channel, rig)
        return Setting(problem, driven, 0.2 * power, power)
    law = drive_law.law_vector(rig.require_drive())
    theta = parameters.vector(rig)
    starts, errors = make_starts(records, theta, law), (np.empty(0),) * len(records)
    simulator = ClosedLoop(tuple(records), law, starts, errors, clips_as_recorded=True)
    layout = make_layout(
        [list(record.channels) for record in records],
        [record.weights for record in records],
        [record.period_s for record in records],
    )
    current = max(float(np.sqrt(np.mean(record.channels["current_A"] ** 2))) for record in records)
    torque = current * float(theta[parameters.index("motor.torque_constant_N_m_per_A")])
    if shared is None:
        measured = any("theta_j_rad" in record.channels for record in records)
        shared = known_parameters(rig, torque, jaw_measured=measured)
    ki = float(law[drive_law.KI])
    problem = Problem(
        tuple(records),
        layout,
        transform(layout, simulator.measured()),
        simulator,
        theta,
        parameters.index,
        shared,
        ZERO_SD_RAD,
        max(INTEGRAL_SHARE * current, LEAST_INTEGRAL_A) / ki if ki > 0.0 else 0.0,
        mapper,
    )
    power = first_noise(simulator, layout.band_channel, rig)
    if any(samples_per_row(record, law) > 1 for record in records):
        simulator = _with_its_reference(problem, simulator, power)
        problem = replace(problem, simulate_runs=simulator)
    return Setting(problem, simulator, 0.2 * power, power)


def _with_its_reference(problem: Problem, simulator: ClosedLoop, power: Vector) -> ClosedLoop:
    """Return the loop with the reference between rows as the runs show it.

    No rig says how it goes on, and half a row of delay is what many an effect does.
    """
    whitener, start = problem.whitener(white_noise(problem.layout, power)), np.zeros(problem.size)

    def chi2(loop: ClosedLoop) -> float:
        at = replace(problem, simulate_runs=loop)
        return chi2_of(at, problem.measured - at.predicted(start), whitener, start)

    return min((replace(simulator, reference=reference) for reference in REFERENCES), key=chi2)


def aware_of_load(setting: Setting, theta: Vector, rig: Rig) -> Setting:
    """Return the setting with what errors of the load do to the channels, with these parameters of the model."""
    problem, responses = setting.problem, responses_of(setting.simulator, theta, rig)
    layout = with_load_errors(problem.layout, problem.records, responses, setting.first_power, problem.mapper)
    return setting._replace(problem=replace(problem, layout=layout))


def responses_of(simulator: ClosedLoop | Driven, theta: Vector, rig: Rig) -> list[linear.Response]:
    """Return what torques, forces and loads do to the channels of each run, with these parameters of the model."""
    plant = PlantParameters(*(float(value) for value in theta[: len(PlantParameters._fields)]))
    if isinstance(simulator, Driven):
        return [predict_driven.responses(plant, record) for record in simulator.records]
    law, added = rig.require_drive(), simulator.integral_per_s
    return [linear.responses(plant, law, r.time_s.size, r.period_s, added) for r in simulator.records]


def first_noise(simulator: ClosedLoop | Driven, band_channels: Sequence[str], rig: Rig) -> Vector:
    """Return a first guess of the noise power of each band: what the rig says, counts, or second differences.

    Second differences see little of what moves and all of white noise: their variance is 6 times its.
    """
    outputs = simulator.measured()
    guess: dict[str, float] = {}
    for name in dict.fromkeys(band_channels):
        values = [out[name] for out in outputs if name in out]
        second = np.concatenate([np.diff(v[100:], n=2) for v in values])
        guess[name] = float(np.median(np.abs(second)) / 0.6745) ** 2 / 6.0
    if rig.encoder.counts_per_rev is not None:
        guess["theta_m_rad"] = (2.0 * np.pi / rig.encoder.counts_per_rev) ** 2 / 12.0
    if rig.noise.theta_j_rad > 0.0 and "theta_j_rad" in guess:
        guess["theta_j_rad"] = rig.noise.theta_j_rad**2
    if rig.noise.current_A > 0.0 and "current_A" in guess:
        guess["current_A"] = rig.noise.current_A**2
    return np.array([max(guess[name], 1e-16) for name in band_channels])
