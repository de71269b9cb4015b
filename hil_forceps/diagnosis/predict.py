"""What the model says that was measured, for any values of the unknowns: simulated channels and their transforms.

In closed loop the current is compared through the drive's law: what was measured less what the law commands from the
recorded angles. The same is done to the simulated channels. That makes the noise of the current independent of the
encoder's, which the loop feeds into it, and shows what happens between command and current in a channel of its own.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import uniform_filter1d

from hil_forceps.diagnosis.course import Course
from hil_forceps.diagnosis.experiment import Record
from hil_forceps.diagnosis.mapper import Mapper
from hil_forceps.diagnosis.problem import Nuisance, Outputs
from hil_forceps.diagnosis.spectrum import MOTOR
from hil_forceps.model import closed_loop, drive_law, parameters
from hil_forceps.model.closed_loop import Channels, DriveState, Inputs, Start
from hil_forceps.rig.catalogue import effect

Vector = NDArray[np.float64]

LONGEST_SUBSTEP_S = 2.6e-4
LONGEST_COARSE_SUBSTEP_S = 5.2e-4
CALM_S = 0.04
CURRENT_PATH = (
    "current_offset",
    "current_gain",
    "amplifier_deadband",
    "electrical_lag",
    "actuation_delay",
    "channel_skew",
    "current_saturation",
)  # what changes the current between the law and its sensor
_PATH = tuple(
    (parameters.index(f"effects.{name}.{p.name}"), parameters.off_value(f"effects.{name}.{p.name}"))
    for name in CURRENT_PATH
    for p in effect(name).parameters
)

CLIPS = "current_saturation"
LIMIT = parameters.index(f"effects.{CLIPS}.limit_A")
DEADBAND = parameters.index("effects.amplifier_deadband.half_width_A")

# What a drive follows that samples between rows: what the bus brought last, straight lines or its own course.
Reference = Literal["held", "straight", "smooth"]
REFERENCES: tuple[Reference, ...] = ("held", "straight", "smooth")


class Slow(NamedTuple):
    """What the encoder's rounding does slowly in a run."""

    theta_m_rad: Vector
    theta_j_rad: Vector
    errors_rad: Vector  # what dwells leave open of both channels: (2, k, rows)


class Offset(NamedTuple):
    """What is added to simulated channels of a run."""

    theta_m_rad: Vector
    theta_j_rad: Vector
    current_A: Vector
    seen_rad_s: Vector  # to the integral of what the drive reads


@dataclass(frozen=True, slots=True, eq=False)
class ClosedLoop:
    """Simulates runs whose drive law is known."""

    records: tuple[Record, ...]
    law: Vector
    starts: tuple[Start, ...]
    encoder_error_rad: tuple[Vector, ...]  # of each run, one for each sample of the drive; empty: none
    slow: tuple[Slow, ...] = ()  # of each run
    offset: tuple[Offset, ...] = ()  # of each run: what its rounding does more than those that stand in for it
    stand_ins: tuple["ClosedLoop", ...] = ()  # the same, shaken by a rounding of another time with either sign
    longest_substep_s: float = LONGEST_SUBSTEP_S
    clips_as_recorded: bool = False  # a limit takes off what it took off the commands of the recorded angles
    reference: Reference = "smooth"

    def __call__(self, theta: Vector, nuisances: Sequence[Nuisance], mapper: Mapper = map) -> Outputs:
        """Return the transformed channels of each run.

        The rounding as it happened is taken from the residual, so whatever depends on how the motor answers to it would
        depend on the residual: inertia and friction came out at half and at three times as much again. So the motor is
        shaken by a rounding of the same kind at another time, once as it is and once with the other sign: the mean
        holds what shaking does to dry friction, and nothing else of it. What the rounding as it happened does besides
        is a fixed offset, taken anew with each better model. Only the current's own path answers to it, where it is a
        signal.
        """
        loops = self.stand_ins or (self,)
        runs = range(len(nuisances))

        def answer(task: tuple[int, ClosedLoop]) -> dict[str, Vector]:
            run, loop = task
            offset = self.offset[run] if self.offset else None
            return loop.outputs(run, loop.raw(run, theta, nuisances[run]), offset)

        each = list(mapper(answer, [(run, loop) for run in runs for loop in loops]))
        together = [each[run * len(loops) : (run + 1) * len(loops)] for run in runs]
        found = [{name: np.mean([one[name] for one in ones], axis=0) for name in ones[0]} for ones in together]
        if self.stand_ins and path_differs(theta):
            own = replace(self, slow=(), offset=(), stand_ins=())
            followed = [run for run in runs if follows_law(self.records[run], self.law)]
            shown = mapper(lambda run: own.outputs(run, own.raw(run, theta, nuisances[run])), followed)
            for run, outputs in zip(followed, shown, strict=True):
                found[run]["current_A"] = outputs["current_A"]
        return found

    def raw(self, run: int, theta: Vector, nuisance: Nuisance, quantum_rad: float = 0.0) -> Channels:
        """Simulate a run: recorded channels and what is inside."""
        record, start = self.records[run], self.starts[run]
        samples = samples_per_row(record, self.law)
        integral = start.drive.integral_rad_s + nuisance.integral_rad_s + _sensor_share(theta, start, self.law)
        drive = start.drive._replace(integral_rad_s=integral)
        plant = _settled(theta, start, record)
        rows = record.time_s.size
        tau_w = record.tau_w_N_m if record.tau_w_N_m is not None else np.zeros(rows)
        inputs = Inputs(
            record.time_s,
            between_rows(record.reference_rad, samples, self.reference),
            tau_w,
            record.edge_rows.astype(np.int64),
            np.ascontiguousarray(nuisance.edge_fractions, dtype=np.float64),
            self.encoder_error_rad[run],
        )
        if self.clips_as_recorded and math.isfinite(theta[LIMIT]) and record.evenly_logged:
            angle = between_rows(record.channels["theta_m_rad"], samples, "smooth")
            inputs = inputs._replace(added_A=_clipped_off(theta, self.law, drive, inputs.reference_rad, angle))
            theta = theta.copy()
            theta[LIMIT] = math.inf
        substeps = samples * max(1, int(np.ceil(record.period_s / samples / self.longest_substep_s)))
        found = closed_loop.simulate(theta, self.law, quantum_rad, inputs, Start(plant, drive), substeps, samples)
        jaw = found.theta_j_rad + nuisance.theta_j_zero_rad
        if not self.slow or quantum_rad > 0.0:
            return found._replace(theta_j_rad=jaw)
        slow = self.slow[run]
        return found._replace(theta_m_rad=found.theta_m_rad + slow.theta_m_rad, theta_j_rad=jaw + slow.theta_j_rad)

    def outputs(self, run: int, channels: Channels, offset: Offset | None = None) -> dict[str, Vector]:
        """Transform simulated channels, with an offset added to them."""
        angle = channels.theta_m_rad
        error = self.error_at_rows(run)
        seen = angle + error if error.size else angle
        found = {name: np.asarray(getattr(channels, name)) for name in self.records[run].channels}
        if offset is not None:
            law = follows_law(self.records[run], self.law)
            found |= {
                name: values + getattr(offset, name)
                for name, values in found.items()
                if not (law and name == "current_A")
            }
        found = self.transformed(run, found, seen)
        if offset is not None:
            found[MOTOR] = found[MOTOR] + self.integral_per_s * offset.seen_rad_s
        return found

    def error_at_rows(self, run: int) -> Vector:
        """Return the encoder's rounding of a run at its rows; empty: none."""
        return self.encoder_error_rad[run][:: samples_per_row(self.records[run], self.law)]

    def transformed(self, run: int, channels: dict[str, Vector], seen_rad: Vector) -> dict[str, Vector]:
        """Put what the law does not explain in place of the current; `seen_rad`: angle with the encoder's rounding."""
        record = self.records[run]
        found = dict(channels)
        if follows_law(record, self.law):
            command = drive_law.law_current(self.law, record.reference_rad, seen_rad, self.starts[run].drive)
            found["current_A"] = channels["current_A"] - np.concatenate((channels["current_A"][:1], command[:-1]))
        if share := self.integral_per_s * record.period_s:
            found[MOTOR] = channels[MOTOR] + share * np.cumsum(seen_rad - record.reference_rad)
        return found

    @property
    def integral_per_s(self) -> float:
        """Return what of the error's integral is added to θ_m: as much as the law takes; 0 where it can't be said.

        The drive's integral holds the angle against every steady torque, so what is steady hardly shows in the angle
        and its noise there is low, in a handful of bins; in proportional and integral part together it shows evenly.
        """
        if not all(follows_law(record, self.law) for record in self.records) or self.law[drive_law.KP] <= 0.0:
            return 0.0
        return float(self.law[drive_law.KI] / self.law[drive_law.KP])

    def measured(self) -> Outputs:
        """Return the transformed channels as measured."""
        return [self.transformed(k, r.channels, r.channels["theta_m_rad"]) for k, r in enumerate(self.records)]

    def unshaken(self) -> "ClosedLoop":
        """Return the same without the encoder's rounding."""
        none = (np.empty(0),) * len(self.records)
        return replace(self, encoder_error_rad=none, slow=(), offset=(), stand_ins=())

    def calmed(self) -> "ClosedLoop":
        """Return the same without the rounding and without what is quick in the load, which is noise for the most part.

        What depends on a course of it isn't tied to the load's noise, as the residual is: else friction that holds the
        simulated motor against that noise would seem to explain something.
        """
        return replace(self.unshaken(), records=tuple(with_calm_load(record) for record in self.records))

    def only(self, run: int) -> "ClosedLoop":
        """Return the same of one run."""
        one = slice(run, run + 1)
        return replace(
            self,
            records=self.records[one],
            starts=self.starts[one],
            encoder_error_rad=self.encoder_error_rad[one],
            slow=self.slow[one],
            offset=self.offset[one],
            stand_ins=tuple(loop.only(run) for loop in self.stand_ins),
        )

    def coarse(self) -> "ClosedLoop":
        """Return the same in longer steps: good for a look, not for a fit."""
        stand_ins = tuple(replace(loop, longest_substep_s=LONGEST_COARSE_SUBSTEP_S) for loop in self.stand_ins)
        return replace(self, stand_ins=stand_ins, longest_substep_s=LONGEST_COARSE_SUBSTEP_S)

    def as_shaken(self) -> "ClosedLoop":
        """Return the same for a look: shaken by each run's own rounding alone, in longer steps."""
        return replace(self, offset=(), stand_ins=(), longest_substep_s=LONGEST_COARSE_SUBSTEP_S)

    def course(self, run: int, theta: Vector, nuisance: Nuisance) -> Course:
        """Return what a run went through inside."""
        record = self.records[run]
        c = self.raw(run, theta, nuisance)
        load = record.tau_w_N_m if record.tau_w_N_m is not None else np.zeros(record.time_s.size)
        return Course(
            c.theta_m_rad,
            c.omega_m_rad_per_s,
            c.theta_j_rad,
            c.omega_j_rad_per_s,
            c.elongation_m,
            c.tension_N,
            load,
            c.current_A,
            record.time_s,
            record.period_s,
        )


def _clipped_off(theta: Vector, law: Vector, drive: DriveState, reference_rad: Vector, angle_rad: Vector) -> Vector:
    """Return what a limit adds to the commands that the law makes of recorded angles.

    Where a limit clips, the loop is open: a simulation that clips by itself clips other tips and goes astray by the
    load's noise. This one is held to the recorded angles by its law, there as everywhere.
    """
    commands = drive_law.law_current(law, reference_rad, angle_rad, drive)
    commands -= np.clip(commands, -theta[DEADBAND], theta[DEADBAND])
    return np.asarray(np.clip(commands, -theta[LIMIT], theta[LIMIT]) - commands)


def with_calm_load(record: Record) -> Record:
    """Return a record without what is quick in its load; jumps are kept."""
    load = record.tau_w_N_m
    if load is None:
        return record
    width = max(1, round(CALM_S / record.period_s))
    pieces = np.split(load, record.edge_rows + 1)
    return record._replace(
        tau_w_N_m=np.concatenate([low_pass(piece, width) if piece.size else piece for piece in pieces])
    )


def path_differs(theta: Vector) -> bool:
    """Tell whether something changes the current between the law and its sensor."""
    return any(theta[place] != off for place, off in _PATH)


def low_pass(values: Vector, width: int) -> Vector:
    """Return two moving averages, one after the other."""
    return np.asarray(uniform_filter1d(uniform_filter1d(values, width), width))


def samples_per_row(record: Record, law: Vector) -> int:
    """Return how many samples a drive takes from row to row."""
    return round(record.period_s / float(law[drive_law.SAMPLE_TIME]))


def between_rows(values: Vector, samples: int, reference: Reference) -> Vector:
    """Return a reference, or an angle, at each sample of the drive, from that of rows; the last row's is held."""
    if samples == 1:
        return values
    if reference == "held":
        return np.repeat(values, samples)
    rows = np.arange(values.size)
    at = np.minimum(np.arange(values.size * samples) / samples, rows[-1])
    return np.asarray(np.interp(at, rows, values) if reference == "straight" else CubicSpline(rows, values)(at))


def follows_law(record: Record, law: Vector) -> bool:
    """Tell whether the law can be followed row by row: every sample of the drive is a row, none is missing."""
    samples = record.period_s / float(law[drive_law.SAMPLE_TIME])
    return record.evenly_logged and abs(samples - 1.0) < 0.02


def _sensor_share(theta: Vector, start: Start, law: Vector) -> float:
    """Return what to add to the integral where the current that it was taken from is read by a wrong sensor."""
    ki = float(law[drive_law.KI])
    offset = float(theta[parameters.index("effects.current_offset.offset_A")])
    gain = 1.0 + float(theta[parameters.index("effects.current_gain.relative_error")])
    if ki <= 0.0:
        return 0.0
    return (start.plant.current_A - offset) / gain / ki - start.plant.current_A / ki


def _settled(theta: Vector, start: Start, record: Record) -> closed_loop.State:
    """Return the start with the jaw where the wire of these parameters puts it."""
    load = float(record.tau_w_N_m[0]) if record.tau_w_N_m is not None else 0.0
    tension = load / float(theta[parameters.index("forceps.jaw_pulley_radius_m")])
    at_rest = closed_loop.rest(theta, start.plant.theta_m_rad, tension)
    return start.plant._replace(theta_j_rad=at_rest.plant.theta_j_rad)
