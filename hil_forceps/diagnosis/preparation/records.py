"""A run as the filter takes it: command, load's prior, regimes of friction and noise, put together."""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.data.even_rows import EvenRun
from hil_forceps.diagnosis.preparation.command import driven, mean_reference
from hil_forceps.diagnosis.preparation.contact import contact
from hil_forceps.diagnosis.preparation.load_prior import LoadPrior, load_prior
from hil_forceps.diagnosis.preparation.regimes import DWELL_ROWS, dwelling, may_stick, may_stick_by_sensor
from hil_forceps.diagnosis.preparation.skewed_channels import moved_back, rows_late, rows_later, with_unseen_counts
from hil_forceps.diagnosis.state_space.advance import friction_at_rest_N_m, physics_of
from hil_forceps.diagnosis.state_space.layout import (
    CHANNELS,
    COMMAND_ERROR,
    CURRENT_NOISE,
    ENCODER,
    INTEGRAL_ERROR,
    JAW_NOISE,
    JAW_ZERO,
    LAW_STATES,
    LOAD,
    LOAD_CELL,
    LOAD_NOISE,
    LOAD_SLOPE,
    OMEGA_J,
    OMEGA_M,
    RECORDED_STATES,
    STATES,
    THETA_J,
    THETA_M,
    Filtered,
    Noise,
    Series,
    Switching,
    undecided_switching,
)
from hil_forceps.diagnosis.state_space.passes import Passed, pass_one
from hil_forceps.model import parameters
from hil_forceps.model.composition import Physics
from hil_forceps.model.linear.two_inertia import poles_per_s
from hil_forceps.rig import Rig

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Mask = NDArray[np.bool_]

EDGE_SHARE = 0.03  # of a count: how sharp an edge is  # tuned: holds and four kinds of motion at 16384 counts
IDEAL_SHARE = 2e-5  # of an angle's span: what an encoder without counts is taken to be off
INTEGRATION_SHARE = 1e-4  # of the speed: what the model's step leaves over a row
# The equations of model and world, each with its own steps, agree to 5e-4 of what an effect does; of the largest torque
# that is some 1e-4. What a finer encoder sees beyond it is not told apart from a load that wanders off by as much.
TORQUE_ACCURACY = 1e-4
# No rounding hides that from an encoder without counts, and it is alike for seconds: a hundred errors that are alike
# add up to ten times as much as independent ones.
IDEAL_TORQUE_ACCURACY = 10.0 * TORQUE_ACCURACY
ACCURACY_TIME_S = 0.1
SETTLING_S = 0.15  # from the start of a run: its start is forgotten by then
FADING_TIME_CONSTANTS = 6.0  # exp(−6) of a ring is left
MAX_FADING_ROWS = 50
MAX_TOUCHED_SHARE = 0.8  # tuned: of the rows; a torque constant that is 25 % off beside no load cell
JAW_ZERO_SD_RAD = 0.01  # of the jaw sensor, from run to run
COLOURED_NOISES = [JAW_NOISE, LOAD_NOISE, CURRENT_NOISE]


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """A run, ready to be filtered."""

    name: str
    series: Series
    ringing: Mask  # n: the wire rings from a jump of the load, or a contact's stiffness isn't known: no evidence
    dwelling: Mask  # n: the encoder dwells
    load_open_sd_N_m: float  # what is left open of the load
    load_course_N_m: Vector  # n: smoothed
    jaw_course_rad: Vector  # n: likewise
    step_rad: float  # of the encoder, or what is taken for one where it is ideal
    least_slope_variance: float  # [(N m/s)²]: what the equations leave open, as a wandering load
    settling_rows: int
    command_span_A: float
    rows_late: tuple[int, int, int, int] | None = None  # by how many rows channels are moved; None: as suits the model

    @property
    def load_measured(self) -> bool:
        """Whether it has a load cell."""
        return bool(np.isfinite(self.series.load_N_m).any())

    @property
    def jaw_measured(self) -> bool:
        """Whether it has a sensor at the jaw."""
        return bool(np.isfinite(self.series.jaw_rad).any())

    def passed(self, theta: Vector, plant: Physics) -> Passed:
        """Return a pass of the filter with the plant of parameters `theta`."""
        del theta
        run, late = self, self.rows_late or rows_late(plant, self.series.period_s)
        if any(late) or plant.channel_skew_tau_w_s != 0.0:
            dwelling, ringing = rows_later(self.dwelling, late[ENCODER]), rows_later(self.ringing, late[LOAD_CELL])
            run = replace(
                run,
                series=moved_back(self.series, late, plant.channel_skew_tau_w_s),
                dwelling=dwelling,
                ringing=ringing,
            )
        if plant.channel_skew_theta_m_s != 0.0:
            run = replace(run, series=with_unseen_counts(run.series))
        return pass_one(run, plant)

    def with_rows_of(self, plant: Physics) -> "Record":
        """Return the record with late channels moved by whole rows as suits a model, and held there for all others."""
        late = rows_late(plant, self.series.period_s)
        return self if self.rows_late == late else replace(self, rows_late=late)

    def with_friction_of(self, p: Physics) -> "Record":
        """Return the record for a plant whose dry friction is about that of `p`, nothing decided yet.

        Where it is less than the load leaves open, it is no state, and rows where a mass may stick are evidence as any.
        Models that are compared must be so by records with the same friction.
        """
        levels = np.empty((self.load_course_N_m.size, 2))
        resolved = (self.step_rad, self.step_rad * p.r_m / p.r_j)
        friction_at_rest_N_m(p, self.load_course_N_m / p.r_j, self.jaw_course_rad, resolved, levels)
        levels[levels <= self.load_open_sd_N_m * np.array([p.r_m / p.r_j, 1.0])] = 0.0
        undecided = undecided_switching(self.series.encoder_rad.size)
        return replace(self, series=self.series._replace(friction_level_N_m=levels, switching=undecided))

    def with_timing(self, timing: Matrix) -> "Record":
        """Return the record where the drive follows references between rows as `timing` says (n × 3)."""
        reference_rad = mean_reference(self.series.references_rad, timing)
        return replace(self, series=self.series._replace(reference_rad=reference_rad, timing=timing))

    def with_noise(self, noise: Noise) -> "Record":
        """Return the record with another noise of its sensors; what was prepared with the noise before stays."""
        first = self.series.first_variance.copy()
        first[COLOURED_NOISES] = _coloured_variance(noise)
        return replace(
            self,
            series=self.series._replace(
                noise_variance=noise.deviation**2, noise_correlation=noise.correlation, first_variance=first
            ),
        )

    def with_less_load_noise(self, share: float) -> "Record":
        """Return the record with a share of the variance by which the load wanders; its breaks and jumps stay."""
        variance = self.series.load_slope_variance
        lowest = float(variance.min())
        less = variance - lowest + max(share * lowest, self.least_slope_variance)
        return replace(self, series=self.series._replace(load_slope_variance=less))

    def decided_by(self, filtered: Filtered) -> "Record":
        """Return the record with what a pass over it decided, for all models that are compared with that pass's."""
        return replace(
            self, series=self.series._replace(switching=Switching(True, filtered.doubtful, filtered.surprised))
        )


def record_of(even: EvenRun, rig: Rig, noise: Noise) -> Record:
    """Return a run with equally spaced rows as a record; any reference between rows is equally likely."""
    run, lost = even.run, even.lost
    columns, plant = run.columns, rig.plant()
    time_s, encoder = columns["time_s"], columns["theta_m_rad"]
    n = time_s.size
    period_s = float(time_s[-1] - time_s[0]) / (n - 1)
    missing = np.full(n, np.nan)
    jaw, load = columns.get("theta_j_rad", missing), columns.get("tau_w_N_m", missing)
    drive, current = driven(run, lost, rig, float(noise.deviation[2])), columns["current_A"]
    torque = plant.torque_constant_N_m_per_A * drive.span_A
    told, told_noise, grasped = load, noise, np.zeros(n, dtype=np.bool_)
    by_stretch = not np.isfinite(load).any() and bool(np.isfinite(jaw).all())
    if by_stretch:
        told, told_noise = _load_by_stretch(encoder, jaw, rig, noise)
    touched = _touched(encoder, jaw, told, rig, told_noise)
    if by_stretch and touched is not None:
        grasped, touched = _grasped(touched), None
    outside = told if touched is None else told - touched.load_N_m
    reach = torque * plant.jaw_pulley_radius_m / plant.motor_pulley_radius_m
    prior = _load_prior(outside, told_noise, period_s, float(np.std(told)), reach)
    if touched is not None:
        # Where in a row it begins isn't known: a jump of the load by what the jaw moves in a row, and a bend.
        prior = prior._replace(
            slope_variance=prior.slope_variance + (touched.open_N_m / period_s) ** 2 / 12.0,
            jump_variance=prior.jump_variance + touched.open_N_m**2 / 12.0,
            course_N_m=prior.course_N_m + touched.load_N_m,
        )
    count = rig.encoder.quantum_rad
    least = least_slope_variance(reach, period_s, TORQUE_ACCURACY if count else IDEAL_TORQUE_ACCURACY)
    prior = prior._replace(slope_variance=np.maximum(prior.slope_variance, least))
    step = count or 1e-4 * max(float(np.ptp(encoder)), 1e-6)
    # Edges that are softer than they are by a tenth of a count already pass for a delay.
    edge_sd = EDGE_SHARE * count or IDEAL_SHARE * max(float(np.ptp(encoder)), 1e-6)
    ratio = plant.motor_pulley_radius_m / plant.jaw_pulley_radius_m
    jaw_smooth = _followed_angle(encoder, prior.course_N_m, jaw, ratio * encoder)
    stiffness = np.zeros(n) if touched is None else touched.stiffness_N_m_per_rad
    dwells = dwelling(encoder, step)
    # Where it dwells, all counts of a while say the same once.
    edge = np.where(dwells, step * math.sqrt(DWELL_ROWS / 12.0), edge_sd)
    speed = float(np.std(np.diff(encoder))) / period_s
    state, variance = _start(encoder, jaw, load, prior, period_s, ratio, step)
    timing = np.full((n, 3), 1.0 / 3.0)
    states = STATES if drive.samples > 1 else LAW_STATES if lost.any() else RECORDED_STATES
    variance[COMMAND_ERROR if states == RECORDED_STATES else INTEGRAL_ERROR] = drive.integral_sd_A**2
    variance[COLOURED_NOISES] = _coloured_variance(noise)
    jaw_free = may_stick(jaw_smooth, step * ratio, 2)
    if np.isfinite(jaw).all():  # where the motor has turned round, friction holds the jaw for a while more
        jaw_free |= may_stick_by_sensor(jaw, float(noise.deviation[0]), 2)
    fading = _fading_rows(period_s, rig)
    series = Series(
        period_s,
        even.begin_s,
        count,
        edge**2,
        np.where(lost, np.nan, encoder),
        np.zeros(CHANNELS),
        np.where(lost, np.nan, encoder),
        np.where(lost, np.nan, jaw),
        np.where(lost, np.nan, load),
        np.where(lost, np.nan, current),
        states,
        drive.samples,
        drive.law,
        drive.first_integral_rad_s,
        float(current[0]),
        mean_reference(drive.references_rad, timing),
        drive.reference_variance,
        drive.references_rad,
        timing,
        drive.command_variance,
        drive.integral_variance,
        may_stick(encoder, step, 1),
        jaw_free,
        fading,
        np.zeros((n, 2)),
        stiffness,
        prior.slope_variance,
        prior.jump_variance,
        (float(np.std(prior.course_N_m)) / 0.2) ** 2,
        undecided_switching(n),
        noise.deviation**2,
        noise.correlation,
        noise.resolution,
        (INTEGRATION_SHARE * speed * np.array([1.0, ratio])) ** 2,
        state[:states],
        variance[:states],
    )
    found = Record(
        run.name,
        series,
        _ringing(prior.jump_variance, fading) | grasped,
        dwells,
        prior.open_sd_N_m,
        prior.course_N_m,
        jaw_smooth,
        step,
        least,
        min(n // 4, max(5, round(SETTLING_S / period_s))),
        drive.span_A,
    )
    return found.with_friction_of(physics_of(parameters.vector(rig)))


def _coloured_variance(noise: Noise) -> Vector:
    """Return the variance of the sensors' coloured noise; 0 of what is white."""
    return np.where(noise.correlation != 0.0, noise.deviation**2, 0.0)


def least_slope_variance(reach_N_m: float, period_s: float, accuracy: float) -> float:
    """Return the variance per row of a load's slope that wanders off by `accuracy` within `ACCURACY_TIME_S`."""
    rows = ACCURACY_TIME_S / period_s
    return float((accuracy * reach_N_m / period_s) ** 2 * 3.0 / rows**3)


def _fading_rows(period_s: float, rig: Rig) -> int:
    """Return the rows over which the slowest of the wire's modes dies away."""
    poles = poles_per_s(rig.plant())
    slowest = min(-float(pole.real) for pole in poles if abs(pole) > 1e-6)
    return min(MAX_FADING_ROWS, math.ceil(FADING_TIME_CONSTANTS / (slowest * period_s)))


def _ringing(jump_variance: Vector, fading_rows: int) -> Mask:
    """Return the rows behind a jump over which the wire rings."""
    ringing = np.zeros(jump_variance.size, dtype=np.bool_)
    for row in np.flatnonzero(jump_variance > 0.0):
        ringing[row + 1 : row + 1 + fading_rows] = True
    return ringing


def _jaw_angle_rad(encoder: Vector, load: Vector, rig: Rig) -> Vector:
    """Return where the jaw is by the motor's angle and the wire's stretch under the load, both as the rig has them."""
    p = rig.plant()
    stretch = load / (p.jaw_pulley_radius_m**2 * p.wire_stiffness_N_per_m)
    return np.asarray(p.motor_pulley_radius_m / p.jaw_pulley_radius_m * encoder - stretch)


def _followed_angle(encoder: Vector, load: Vector, jaw: Vector, unmeasured: Vector) -> Vector:
    """Return the jaw's angle without its sensor's noise, `unmeasured` where there is none.

    The motor's angle and the load tell it, in proportions that are fitted: they hang on no value of the rig.
    """
    if not np.isfinite(jaw).all():
        return unmeasured
    both = np.column_stack((encoder, load, np.ones(load.size)))
    return np.asarray(both @ np.linalg.lstsq(both, jaw, rcond=None)[0])


class _Touched(NamedTuple):
    """What a contact does in a run, n each."""

    load_N_m: Vector
    stiffness_N_m_per_rad: Vector  # from row k to k + 1
    open_N_m: Vector  # how far the load may be off over a row in which the contact begins or ends


def _touched(encoder: Vector, jaw: Vector, load: Vector, rig: Rig, noise: Noise) -> _Touched | None:
    if not np.isfinite(load).all():
        return None
    measured = bool(np.isfinite(jaw).all())
    by_motor = _jaw_angle_rad(encoder, load, rig)
    count = rig.encoder.quantum_rad
    angle, variance = (jaw, float(noise.deviation[0]) ** 2) if measured else (by_motor, count**2)
    found = contact(load, angle, float(noise.deviation[1]) ** 2, variance)
    if found is None:
        return None
    smooth = _followed_angle(encoder, load, angle, angle)
    way = smooth - found.angle_rad
    beyond = np.maximum(way, 0.0) if found.upward else np.minimum(way, 0.0)
    near = np.abs(way) < 2.0 * math.sqrt(variance) + np.abs(np.gradient(smooth))
    stiffness = np.where(beyond != 0.0, found.stiffness_N_m_per_rad, 0.0)
    open_N_m = np.where(near, found.stiffness_N_m_per_rad * np.abs(np.gradient(smooth)), 0.0)
    return _Touched(found.stiffness_N_m_per_rad * beyond, stiffness, open_N_m)


def _load_prior(load: Vector, noise: Noise, period_s: float, whole_sd_N_m: float, reach_N_m: float) -> LoadPrior:
    if np.isfinite(load).all():
        return load_prior(load, float(noise.deviation[1]) ** 2, period_s, whole_sd_N_m)
    n = load.size
    # Any load that the motor could hold, within some tenths of a second.
    slope = (reach_N_m / 0.2) ** 2 * (period_s / 0.2)
    return LoadPrior(np.full(n, slope), np.zeros(n), np.zeros(n), reach_N_m)


def _load_by_stretch(encoder: Vector, jaw: Vector, rig: Rig, noise: Noise) -> tuple[Vector, Noise]:
    """Return a load that no cell measures by the stretch of the wire, and its noise.

    It only tells how such a load changes: the filter doesn't take it for a measurement.
    """
    p = rig.plant()
    stiffness = p.wire_stiffness_N_per_m * p.jaw_pulley_radius_m**2
    rounding = p.motor_pulley_radius_m / p.jaw_pulley_radius_m * rig.encoder.quantum_rad / math.sqrt(12.0)
    deviation = noise.deviation.copy()
    deviation[1] = stiffness * math.hypot(float(noise.deviation[0]), rounding)
    unloaded = _jaw_angle_rad(encoder, np.zeros(encoder.size), rig)
    return stiffness * (unloaded - jaw), noise._replace(deviation=deviation)


def _grasped(touched: _Touched) -> Mask:
    """Return the rows at which the jaw touches something, by a load that the stretch tells (n).

    Without a cell nothing says how stiff that is. Taken for a load that wanders, it passes for a softer wire.
    """
    touches = np.asarray(touched.stiffness_N_m_per_rad > 0.0)
    # Where pulleys are not quite as the rig has them, such a load follows the angle everywhere: that is no contact.
    return touches if np.mean(touches) < MAX_TOUCHED_SHARE else np.zeros_like(touches)


def _start(
    encoder: Vector, jaw: Vector, load: Vector, prior: LoadPrior, period_s: float, ratio: float, step: float
) -> tuple[Vector, Vector]:
    """Return mean and variance of the first state."""
    ahead = min(5, encoder.size - 1)
    speed = float(encoder[ahead] - encoder[0]) / (ahead * period_s)
    state, variance = np.zeros(STATES), np.zeros(STATES)
    state[THETA_M], state[OMEGA_M] = encoder[0], speed
    state[THETA_J] = jaw[0] if math.isfinite(jaw[0]) else ratio * encoder[0]
    state[OMEGA_J] = ratio * speed
    known = math.isfinite(load[0])
    state[LOAD] = prior.course_N_m[0] if known else 0.0
    speed_sd = max(abs(speed), 2.0 * step / (ahead * period_s))
    variance[THETA_M], variance[OMEGA_M] = (2.0 * step) ** 2, speed_sd**2
    variance[THETA_J], variance[OMEGA_J] = (2.0 * JAW_ZERO_SD_RAD) ** 2, (2.0 * ratio * speed_sd) ** 2
    reach = max(float(np.std(prior.course_N_m)), prior.open_sd_N_m)
    variance[LOAD] = (10.0 * prior.open_sd_N_m) ** 2
    variance[LOAD_SLOPE] = (reach / 0.1) ** 2
    variance[JAW_ZERO] = JAW_ZERO_SD_RAD**2 if math.isfinite(jaw[0]) else 0.0
    return state, variance
