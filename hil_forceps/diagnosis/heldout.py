"""Models on runs: what each says beside what was measured, and what extending gained on runs that were never used."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.assemble import assemble
from hil_forceps.diagnosis.course import Course
from hil_forceps.diagnosis.experiment import Record
from hil_forceps.diagnosis.extension import Model
from hil_forceps.diagnosis.fit import fit
from hil_forceps.diagnosis.look import no_columns, noise_of
from hil_forceps.diagnosis.mapper import Mapper
from hil_forceps.diagnosis.predict import ClosedLoop
from hil_forceps.diagnosis.predict_driven import Driven
from hil_forceps.diagnosis.result import Gain, RunEvidence
from hil_forceps.diagnosis.shaking import with_encoder_errors
from hil_forceps.diagnosis.spectrum import JAW, MOTOR, Layout, Noise, power_of_load, white_noise
from hil_forceps.diagnosis.unknowns import Unknowns
from hil_forceps.rig import Rig

Vector = NDArray[np.float64]

BLOCK_S = 0.5  # of the bootstrap: longer than residuals remember
DRAWS = 1000
NUISANCE_STEPS = 4


class Played(NamedTuple):
    """A model played beside runs: simulated channels and courses of each."""

    channels: list[dict[str, Vector]]
    courses: list[Course]


def play(records: Sequence[Record], rig: Rig, theta: Vector, quantum_rad: float, mapper: Mapper) -> Played:
    """Simulate runs with given parameters; only what belongs to each run (zeros, start) is fitted to it."""
    setting = assemble(records, rig, mapper, Unknowns(()))
    simulator = setting.simulator
    if isinstance(simulator, ClosedLoop):  # foretells a limit by its own commands
        simulator = replace(simulator, clips_as_recorded=False)
    problem = replace(setting.problem, base=theta, simulate_runs=simulator)
    whitener = problem.whitener(white_noise(problem.layout, setting.first_power))
    found = fit(problem, np.zeros(problem.size), whitener, steps=NUISANCE_STEPS)
    if quantum_rad > 0.0 and isinstance(simulator, ClosedLoop):
        simulator = with_encoder_errors(simulator, theta, problem.nuisances(found.u), quantum_rad, mapper)
        problem = replace(problem, simulate_runs=simulator)
    noise, _ = noise_of(Model((), problem, found), no_columns(problem), whitener, setting.floor)
    found = fit(problem, found.u, problem.whitener(noise), steps=NUISANCE_STEPS)
    return play_fitted(Model((), problem, found))


def play_fitted(model: Model) -> Played:
    """Simulate the runs that a model was fitted to."""
    simulator = model.problem.simulate_runs
    if not isinstance(simulator, ClosedLoop | Driven):
        raise TypeError("only measured runs are played")
    theta, still = model.problem.theta(model.fit.u), simulator.unshaken()
    channels, courses = [], []
    for k, nuisance in enumerate(model.problem.nuisances(model.fit.u)):
        raw = simulator.raw(k, theta, nuisance)
        channels.append({name: np.asarray(getattr(raw, name)) for name in shown(simulator.records[k])})
        courses.append(still.course(k, theta, nuisance))
    return Played(channels, courses)


def shown(record: Record) -> dict[str, Vector]:
    """Return the channels of a run that figures show: those compared, and the motion that drives it."""
    motion = {"theta_m_rad": record.reference_rad} if record.mode == "driven" else {}
    return motion | dict(record.channels)


def gains(
    records: Sequence[Record], before: Played, after: Played, floors: dict[str, float], seed: int
) -> dict[str, Gain]:
    """Return what the extension gained, channel by channel, with a block bootstrap."""
    rng = np.random.default_rng(seed)
    found = {}
    for name in dict.fromkeys(name for record in records for name in record.channels):
        first, second = [], []
        for k, record in enumerate(records):
            if name in record.channels:
                first += blocks(record, record.channels[name] - before.channels[k][name])
                second += blocks(record, record.channels[name] - after.channels[k][name])
        found[name] = gain_of(np.array(first), np.array(second), floors.get(name, 0.0), rng)
    return found


def blocks(record: Record, residual: Vector) -> list[tuple[float, float]]:
    """Return sum of squares and count of the rows that count, block by block, for `gain_of`."""
    rows = max(1, round(BLOCK_S / record.period_s))
    squares = residual**2 * record.weights
    starts = np.arange(0, residual.size, rows)
    return list(zip(np.add.reduceat(squares, starts), np.add.reduceat(record.weights, starts), strict=True))


def gain_of(first: Vector, second: Vector, floor: float, rng: np.random.Generator) -> Gain:
    """Return the gain from blocks (m×2) before and after, with a bootstrap over the blocks; `floor`: rms of noise."""

    def share(picked: NDArray[np.intp]) -> tuple[float, float, float]:
        count = max(float(first[picked, 1].sum()), 1.0)
        e0, e1 = float(first[picked, 0].sum()) / count, float(second[picked, 0].sum()) / count
        room = e0 - min(floor**2, e0, e1)
        return e0, e1, (e0 - e1) / room if room > 1e-12 * e0 and e0 > 0.0 else 0.0

    whole = np.arange(first.shape[0])
    e0, e1, value = share(whole)
    drawn = [share(rng.choice(whole, whole.size))[2] for _ in range(DRAWS)]
    low, high = np.quantile(drawn, (0.025, 0.975))
    least = float(np.sqrt(min(floor**2, e0, e1)))
    return Gain(float(np.sqrt(e0)), float(np.sqrt(e1)), least, value, float(low), float(high))


def floors_of(noise: Noise, layout: Layout, integral_per_s: float) -> dict[str, float]:
    """Return the rms of the noise of each channel, over all frequencies.

    θ_m counts as it is measured, without the sum of it that the fit adds (`integral_per_s`).
    For the current this is the noise of what the drive's law does not explain: the sensor's alone.
    """
    channels = np.array(layout.band_channel)
    counts = np.bincount(layout.band_of, minlength=channels.size).astype(float)
    motor, jaw = channels == MOTOR, channels == JAW
    power = noise.power.copy()
    if motor.any() and jaw.any() and motor.sum() == jaw.sum():
        power[jaw] += np.abs(noise.mix[jaw]) ** 2 * power[motor]
    power += power_of_load(layout)
    power[motor] /= 1.0 + (integral_per_s / (2.0 * np.pi * layout.band_Hz[motor])) ** 2
    return {
        str(name): float(np.sqrt(np.average(power[channels == name], weights=counts[channels == name])))
        for name in dict.fromkeys(channels)
    }


def no_more_than_left(floors: Mapping[str, float], model: Model) -> dict[str, float]:
    """Return floors [rms] that are no higher than what a model leaves in the runs that it was fitted to.

    Low bands hold few numbers and a catalogue takes most of their freedom: what is reckoned of their noise is unsure.
    """
    played = play_fitted(model).channels
    found = dict(floors)
    for name in floors:
        here = [k for k, record in enumerate(model.problem.records) if name in record.channels]
        records = [model.problem.records[k] for k in here]
        squares = [(r.channels[name] - played[k][name]) ** 2 * r.weights for k, r in zip(here, records, strict=True)]
        count = sum(float(record.weights.sum()) for record in records)
        if count > 0.0:
            found[name] = min(floors[name], float(np.sqrt(sum(float(s.sum()) for s in squares) / count)))
    return found


def evidence(
    records: Sequence[Record],
    held_out: bool,
    nominal: Played,
    before: Played,
    after: Played,
    estimated: Sequence[Mapping[str, Vector]],
) -> list[RunEvidence]:
    """Return the runs for the figures."""
    return [
        RunEvidence(
            record.name,
            held_out,
            record.time_s,
            shown(record) | ({"tau_w_N_m": record.tau_w_N_m} if record.tau_w_N_m is not None else {}),
            before.channels[k],
            after.channels[k],
            nominal.channels[k],
            variables_of(after.courses[k]),
            estimated[k],
        )
        for k, record in enumerate(records)
    ]


def variables_of(course: Course) -> dict[str, Vector]:
    """Return the variables over which residuals are shown."""
    return {
        "theta": course.theta_m,
        "omega": course.omega_m,
        "tension": course.tension_N,
        "time": course.time_s,
        "time_since_reversal": _since_reversal(course.omega_m, course.period_s),
        "load": course.load_N_m,
        "acceleration": np.gradient(course.omega_m, course.period_s),
    }


def _since_reversal(omega: Vector, period_s: float) -> Vector:
    moving = np.abs(omega) > 0.02 * max(float(np.abs(omega).max()), 1e-9)
    sign = np.where(moving, np.sign(omega), 0.0)
    held = np.maximum.accumulate(np.where(moving, np.arange(omega.size), 0))
    sign = sign[held]
    turned = np.concatenate(([0], np.flatnonzero(np.diff(sign) != 0.0) + 1))
    last = np.zeros(omega.size, dtype=np.intp)
    last[turned] = turned
    return np.asarray((np.arange(omega.size) - np.maximum.accumulate(last)) * period_s)
