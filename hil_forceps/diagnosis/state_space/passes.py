"""A run as the filter passes over it: its innovations as evidence of the parameters, and how they answer."""

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.course import Course
from hil_forceps.diagnosis.evidence import HUBER, WILD, Columns, Direction, Values, Wave, answers_of, huber_weight
from hil_forceps.diagnosis.state_space.advance import physics_of
from hil_forceps.diagnosis.state_space.filter_pass import filter_run
from hil_forceps.diagnosis.state_space.forcing_pass import COLUMNS_AT_ONCE, forced
from hil_forceps.diagnosis.state_space.layout import (
    CHANNELS,
    CURRENT,
    ENCODER,
    JAW,
    LAW_STATES,
    LOAD,
    LOAD_CELL,
    OMEGA_J,
    OMEGA_M,
    PREDICTED_CURRENT,
    PREDICTED_OMEGA_J,
    PREDICTED_OMEGA_M,
    PREDICTED_THETA_J,
    PREDICTED_THETA_M,
    THETA_J,
    THETA_M,
    Filtered,
    Series,
)
from hil_forceps.diagnosis.state_space.response_pass import response_run
from hil_forceps.model.composition import Physics

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Mask = NDArray[np.bool_]

# exp(−3) is left of what the filter's load was off by. Twice as many hide what shows behind holds only.
LOAD_TIME_CONSTANTS = 3.0  # tuned: presliding friction of the jaw
MAX_SQUARED_DEVIATIONS = 1e6  # deviations: their square has four digits left beside a likelihood of 1
MAX_MEMORY_ROWS = 100  # a load that is forgotten more slowly wanders little, and is little off

# Longer than the filter remembers an error of its load or the wire rings. Between 0.1 and 1 s it makes no difference.
BLOCK_S = 0.25

CHANNEL_OF = {"theta_m_rad": ENCODER, "theta_j_rad": JAW, "current_A": CURRENT}


class Filterable(Protocol):
    """A run that can be filtered (`preparation.records.Record`)."""

    @property
    def ringing(self) -> Mask:
        """Rows behind a jump of the load whose instant isn't known, or at a contact of unknown stiffness."""

    @property
    def dwelling(self) -> Mask:
        """Rows at which the encoder dwells: its counts say the same again and again."""

    @property
    def settling_rows(self) -> int:
        """Rows at the start that don't count."""

    @property
    def series(self) -> Series:
        """What the filter takes of it."""


class Passed(NamedTuple):
    """A run filtered with some parameters."""

    series: Series
    filtered: Filtered
    counts: Mask  # n × CHANNELS: what is evidence of the parameters

    @property
    def load_measured(self) -> bool:
        """Whether the run has a load cell."""
        return bool(np.isfinite(self.series.load_N_m).any())

    @property
    def block_rows(self) -> int:
        """Rows over which innovations may hang together."""
        return max(1, round(BLOCK_S / self.series.period_s))

    @property
    def residual(self) -> Matrix:
        """Whitened innovations (n × CHANNELS), 0 where they don't count."""
        return np.where(self.counts, self.filtered.residual, 0.0)

    @property
    def influence(self) -> Matrix:
        """Root of Huber's weights (n × CHANNELS), 0 where nothing counts; with it, squares are his loss."""
        return np.where(self.counts, huber_weight(self.filtered.residual), 0.0)

    @property
    def log_likelihood(self) -> Matrix:
        """Log likelihood of the measurements (n × CHANNELS) by Huber's loss: beyond `HUBER` deviations, a line.

        Far out the line alone: of two squares that nearly cancel nothing is left but rounding.
        """
        away = np.abs(self.filtered.residual)
        beyond = np.clip(away - HUBER, 0.0, MAX_SQUARED_DEVIATIONS)
        line = -HUBER * np.minimum(away, WILD)
        return np.asarray(np.where(away < MAX_SQUARED_DEVIATIONS, self.filtered.log_likelihood + 0.5 * beyond**2, line))

    def as_recorded(self, values: Values) -> Values:
        """Return values (n × CHANNELS) at the rows at which they were recorded; 0 where none was measured."""
        if not self.series.shifted_s.any():
            return values
        recorded, n = np.zeros_like(values), values.shape[0]
        for channel, shifted_s in enumerate(self.series.shifted_s):
            at = np.arange(n) + round(shifted_s / self.series.period_s)
            inside = (at >= 0) & (at < n)
            recorded[at[inside], channel] = values[inside, channel]
        return recorded

    def answers(self, base: Physics, directions: Sequence[Direction], waves: Sequence[Wave] = ()) -> Columns:
        """Return how the innovations answer to directions and behind them to waves (n·CHANNELS × columns)."""
        influence = self.influence
        answers = np.empty((influence.size, len(directions) + len(waves)), dtype=np.float32)

        def response(theta: Vector, per: float) -> Matrix:
            return response_run(physics_of(theta), base, self.series, self.filtered, per)

        for at, (there, own) in enumerate(answers_of(base, directions, response)):
            change = there if own is None else there - directions[at].per * own
            answer = np.where(self.counts, influence * change, 0.0).ravel()
            # A plant that goes out of bounds within a row says nothing: no information, instead of an infinite one.
            answers[:, at] = answer if np.max(np.abs(answer)) < WILD else 0.0
        for first in range(0, len(waves), COLUMNS_AT_ONCE):
            some = waves[first : first + COLUMNS_AT_ONCE]
            torques = [("motor", self._torque_N_m(wave, base)) for wave in some]
            at = len(directions) + first
            answers[:, at : at + len(some)] = self.curves(base, torques)
        return answers

    def _torque_N_m(self, wave: Wave, p: Physics) -> Vector:
        """Return a wave's torque from each row to the next, in the middle between them."""
        course = self.filtered.course
        phase = wave.harmonic * (course[:, THETA_M] + 0.5 * self.series.period_s * course[:, OMEGA_M])
        torque = wave.amplitude * (np.cos(phase) if wave.cosine else np.sin(phase))
        if wave.with_current:
            torque[:-1] *= p.K_t * course[1:, PREDICTED_CURRENT]
        return np.asarray(torque)

    def curves(self, base: Physics, columns: Sequence[tuple[str, Vector]]) -> Columns:
        """Return how the innovations answer to courses of torques, of a wire's force, of errors of sensors."""
        p, n = base, self.series.encoder_rad.size
        influence = self.influence[:, :, np.newaxis]
        answers = np.empty((n * CHANNELS, len(columns)), dtype=np.float32)
        for first in range(0, len(columns), COLUMNS_AT_ONCE):
            some = columns[first : first + COLUMNS_AT_ONCE]
            motor, jaw = np.zeros((n, len(some))), np.zeros((n, len(some)))
            shown = np.zeros((n, CHANNELS, len(some)))
            for at, (place, unit) in enumerate(some):
                if place == "motor":
                    motor[:, at] = unit
                elif place == "jaw":
                    jaw[:, at] = unit
                elif place == "wire":
                    motor[:, at], jaw[:, at] = -p.r_m * unit, p.r_j * unit
                else:
                    shown[:, CHANNEL_OF[place], at] = unit
            answer = influence * forced(p, self.series, self.filtered, motor, jaw, shown)
            answers[:, first : first + len(some)] = answer.reshape(n * CHANNELS, -1)
        return answers

    def course(self, base: Physics, *, before: bool) -> Course:
        """Return what happened, by the filter: what was known up to each row, or `before` its measurements.

        What acts behind a row may hang on its measurements; an error of its sensors may not, for they hold its
        innovation.
        """
        p, c = base, self.filtered.course
        angles = (PREDICTED_THETA_M, PREDICTED_OMEGA_M, PREDICTED_THETA_J, PREDICTED_OMEGA_J)
        after = (THETA_M, OMEGA_M, THETA_J, OMEGA_J)
        theta_m, omega_m, theta_j, omega_j = (c[:, i] for i in (angles if before else after))
        stretch = p.r_m * theta_m - p.r_j * theta_j
        return Course(
            theta_m=theta_m,
            omega_m=omega_m,
            theta_j=theta_j,
            omega_j=omega_j,
            stretch_m=stretch,
            tension_N=p.k * stretch,
            load_N_m=c[:, LOAD],
            current_A=c[:, PREDICTED_CURRENT],
            time_s=self.series.begin_s + np.arange(c.shape[0], dtype=np.float64) * self.series.period_s,
            period_s=self.series.period_s,
        )


def counting(run: Filterable, d: Series, f: Filtered) -> Mask:
    """Return what of a pass is evidence of the parameters (n × CHANNELS).

    The current is, everywhere, but for one behind counts that no row shows. It and the other channels are not while the
    start is forgotten, where dry friction may hold a mass or did so a moment ago, where the encoder dwells, behind a
    jump of the load at an unknown instant, and where the jaw touches something of unknown stiffness.
    """
    counts = f.log_likelihood != 0.0
    held = f.doubtful > 0
    for mass, free in enumerate((d.friction_free_m, d.friction_free_j)):
        held = held | (free & (d.friction_level_N_m[:, mass] > 0.0))
    # What friction did is Gaussian by name only, until the wire's slowest mode has died away. And a mass breaks away
    # when the load has just moved in that direction. The filter's load lags behind, so it is biased there at first.
    left_out = _and_rows_behind(held, max(d.fading_rows, load_memory_rows(d)))
    left_out |= _and_rows_behind(run.dwelling, d.fading_rows)
    counts[:, :CURRENT] &= ~left_out[:, np.newaxis]
    if d.states > LAW_STATES:  # what the drive counted between rows is told by the motion
        counts[left_out, CURRENT] = False
    counts[run.ringing, :CURRENT] = False
    counts[: run.settling_rows] = False
    return np.asarray(counts)


def _and_rows_behind(held: Mask, rows: int) -> Mask:
    """Return a mask a row later, with so many rows behind each of its stretches."""
    later = np.zeros_like(held)
    later[0], later[1:] = held[0], held[:-1]
    for row in np.flatnonzero(later[:-1] & ~later[1:]):
        later[row + 1 : row + 1 + rows] = True
    return later


def load_memory_rows(d: Series) -> int:
    """Return the rows after which the filter's load has forgotten an error; 0 without a load cell.

    Of an integrated random walk measured in white noise the filter's error has poles of −(q/R)^¼ (1 ± i)/√2 a row, with
    R the variance of the load cell and q that of the change of slope from row to row, times the period squared.
    """
    if not np.isfinite(d.load_N_m).any():
        return 0
    correlation = float(d.noise_correlation[LOAD_CELL - 1])
    noise = float(d.noise_variance[LOAD_CELL - 1]) * (1.0 + correlation) / (1.0 - correlation)
    wander = float(np.median(d.load_slope_variance)) * d.period_s**2
    if not wander > 0.0:
        return MAX_MEMORY_ROWS
    rows_per_time_constant = math.sqrt(2.0 * math.sqrt(noise / wander))
    return min(MAX_MEMORY_ROWS, math.ceil(LOAD_TIME_CONSTANTS * rows_per_time_constant))


def pass_one(run: Filterable, plant: Physics) -> Passed:
    """Filter a run with a plant."""
    filtered = filter_run(plant, run.series)
    return Passed(run.series, filtered, counting(run, run.series, filtered))
