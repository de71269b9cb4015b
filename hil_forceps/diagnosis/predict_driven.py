"""What the model says that was measured where the drive's law isn't known: the measured motion drives the simulation.

Motor torque (or current) is predicted and, where the load was measured, the jaw's angle; without the load the measured
jaw angle drives the simulation, too.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.interpolate import CubicSpline

from hil_forceps.diagnosis.course import Course
from hil_forceps.diagnosis.experiment import Calm, Record
from hil_forceps.diagnosis.experiment_driven import still_rad_per_s
from hil_forceps.diagnosis.linear import Place, Response
from hil_forceps.diagnosis.mapper import Mapper
from hil_forceps.diagnosis.problem import Nuisance, Outputs
from hil_forceps.model import driven
from hil_forceps.model.driven import Inputs
from hil_forceps.rig.plant import PlantParameters

Vector = NDArray[np.float64]

BANDWIDTH_SHARE = 0.45  # of the frequency of steps: records are smoothed already, this only differentiates
LONGEST_STEP_S = 0.51e-3  # the jaw's inertia comes half a step late
MOST_STEPS = 100_000  # of all runs together; steps are longer beyond


class Predicted(NamedTuple):
    """Channels of a run by the names that they have in it; `theta_m_rad` as measured."""

    theta_m_rad: Vector
    current_A: Vector
    tau_m_N_m: Vector
    theta_j_rad: Vector
    tension_N: Vector
    elongation_m: Vector


@dataclass(frozen=True, slots=True, eq=False)
class Driven:
    """Simulates runs whose motion is as measured.

    The noise of what drives is in the residual, so whatever depends on how the model answers to it would depend on the
    residual: counting alone made a jaw's inertia come out at an eighth. So the motion without its noise drives, and
    what the noise does besides is a fixed offset, taken anew with each better model (`with_motion_noise`).
    """

    records: tuple[Record, ...]
    inputs: tuple[Inputs, ...]  # of each run, on a grid of steps
    calm: tuple[Inputs, ...]  # the same without noise
    substeps: int  # of a row
    offset: tuple[dict[str, Vector], ...] = ()  # of each run: what the noise of what drives does; empty: not yet taken
    integral_per_s: float = 0.0  # no law is known that would have summed the angle

    def __call__(self, theta: Vector, nuisances: Sequence[Nuisance], mapper: Mapper = map) -> Outputs:
        """Return the channels of each run."""

        def of_run(k: int) -> dict[str, Vector]:
            if not self.offset:
                return self._channels(k, self.raw(k, theta, nuisances[k]))
            found = self._channels(k, self.raw(k, theta, nuisances[k], calm=True))
            return {name: values + self.offset[k][name] for name, values in found.items()}

        return list(mapper(of_run, range(len(nuisances))))

    def with_motion_noise(self, theta: Vector, nuisances: Sequence[Nuisance], mapper: Mapper = map) -> "Driven":
        """Return the same with what the noise of what drives does, at `theta` and `nuisances`, as the offset."""

        def of_run(k: int) -> dict[str, Vector]:
            own, calm = (self._channels(k, self.raw(k, theta, nuisances[k], calm=calm)) for calm in (False, True))
            return {name: own[name] - calm[name] for name in own}

        return replace(self, offset=tuple(mapper(of_run, range(len(nuisances)))))

    def raw(self, run: int, theta: Vector, nuisance: Nuisance, *, calm: bool = False) -> Predicted:
        """Simulate a run, with its noise or `calm`; the nuisance `integral_rad_s` is the zero of torque or current."""
        record = self.records[run]
        bandwidth = BANDWIDTH_SHARE * self.substeps / record.period_s
        still = still_rad_per_s(record.reference_rad, record.period_s)
        given = self.calm[run] if calm else self.inputs[run]
        fine = driven.simulate(theta, given, bandwidth_Hz=bandwidth, still_rad_per_s=still)
        found = driven.Channels(*(values[:: self.substeps] for values in fine))
        zero = nuisance.integral_rad_s
        return Predicted(
            record.reference_rad,
            found.current_A + zero,
            found.motor_torque_N_m + zero,
            found.theta_j_rad + nuisance.theta_j_zero_rad,
            found.tension_N,
            found.elongation_m,
        )

    def _channels(self, run: int, predicted: Predicted) -> dict[str, Vector]:
        return {name: getattr(predicted, name) for name in self.records[run].channels}

    def measured(self) -> Outputs:
        """Return the channels as measured."""
        return [dict(record.channels) for record in self.records]

    def unshaken(self) -> "Driven":
        """Return the same."""
        return self

    def calmed(self) -> "Driven":
        """Return the same."""
        return self

    def only(self, run: int) -> "Driven":
        """Return the same of one run."""
        one = slice(run, run + 1)
        return replace(
            self,
            records=self.records[one],
            inputs=self.inputs[one],
            calm=self.calm[one],
            offset=self.offset[one],
        )

    def coarse(self) -> "Driven":
        """Return the same."""
        return self

    def course(self, run: int, theta: Vector, nuisance: Nuisance) -> Course:
        """Return what a run went through inside, without noise."""
        record = self.records[run]
        found = self.raw(run, theta, nuisance, calm=True)
        given = calm_of(record)
        load = given.tau_w_N_m if given.tau_w_N_m is not None else np.zeros(record.time_s.size)
        return Course(
            given.motor_rad,
            np.gradient(given.motor_rad, record.period_s),
            found.theta_j_rad,
            np.gradient(found.theta_j_rad, record.period_s),
            found.elongation_m,
            found.tension_N,
            load,
            found.current_A,
            record.time_s,
            record.period_s,
        )


def make_driven(records: Sequence[Record]) -> Driven:
    """Return the simulator of these runs: steps fine enough between rows, their motion by cubic splines."""
    rows = sum(record.time_s.size for record in records)
    wanted = max(int(np.ceil(record.period_s / LONGEST_STEP_S)) for record in records)
    substeps = max(1, min(wanted, MOST_STEPS // rows))
    as_measured = (Calm(record.reference_rad, record.tau_w_N_m, record.theta_j_rad) for record in records)
    noisy = tuple(_inputs(r, given, substeps) for r, given in zip(records, as_measured, strict=True))
    return Driven(tuple(records), noisy, tuple(_inputs(r, calm_of(r), substeps) for r in records), substeps)


def calm_of(record: Record) -> Calm:
    """Return what drives a run without its noise."""
    if record.calm is None:
        raise ValueError(f"{record.name}: no record of mode 'driven'")
    return record.calm


def _inputs(record: Record, given: Calm, substeps: int) -> Inputs:
    time = record.time_s
    fine = np.arange((time.size - 1) * substeps + 1, dtype=np.float64) * (record.period_s / substeps)

    def between(values: Vector | None) -> Vector | None:
        return None if values is None else np.asarray(CubicSpline(time, values)(fine))

    motion = np.asarray(CubicSpline(time, given.motor_rad)(fine))
    return Inputs(fine, motion, between(given.tau_w_N_m), between(given.theta_j_rad))


def responses(plant: PlantParameters, record: Record) -> Response:
    """Return what a motor torque [N m], a wire force [N] and a jaw load [N m] do to the channels.

    As at rest: with the motor held to its motion the wire's mode lies far above what is compared.
    """
    torque = "tau_m_N_m" if "tau_m_N_m" in record.channels else "current_A"
    per_N_m = 1.0 if torque == "tau_m_N_m" else 1.0 / plant.torque_constant_N_m_per_A
    give = 1.0 / (plant.wire_stiffness_N_per_m * plant.jaw_pulley_radius_m)
    known_load = record.tau_w_N_m is not None
    lever = plant.motor_pulley_radius_m
    gains: dict[Place, dict[str, float]] = {
        "motor": {torque: per_N_m},
        "wire": {"theta_j_rad": give} if known_load else {torque: lever * per_N_m},
        "jaw": {
            torque: lever / plant.jaw_pulley_radius_m * per_N_m,
            "theta_j_rad": -give / plant.jaw_pulley_radius_m,
        }
        if known_load
        else {},
    }
    bins = fft.rfftfreq(record.time_s.size).size
    return Response(
        {
            place: {channel: np.full(bins, gain, dtype=np.complex128) for channel, gain in of.items()}
            for place, of in gains.items()
        }
    )
