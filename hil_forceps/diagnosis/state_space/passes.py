"""Passes over a set of runs, reduced to what inference needs: a Gram matrix and scores."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.advance import Regimes, regimes
from hil_forceps.diagnosis.state_space.filter_pass import filter_run
from hil_forceps.diagnosis.state_space.forcing_pass import COLUMNS_AT_ONCE, forced
from hil_forceps.diagnosis.state_space.layout import (
    CHANNELS,
    CURRENT,
    OMEGA_M,
    PREDICTED_CURRENT,
    THETA_M,
    Filtered,
    Series,
)
from hil_forceps.diagnosis.state_space.response_pass import response_run
from hil_forceps.model.physics import Physics

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Deviations: 1 in 370 by chance. A load that bends within a row or a mass that stops for one are not in the model; what
# is seldom and large is to say little (Huber, Robust Statistics, 1981).
HUBER = 3.0
_WILD = 1e15  # in deviations; its square is still a number in single precision
_ROWS_AT_ONCE = 16384

Mapper = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]


class Filterable(Protocol):
    """A run that can be filtered (`preparation.records.Record`)."""

    @property
    def ringing(self) -> Mask:
        """Rows behind a jump of the load whose instant isn't known."""

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
    def residual(self) -> Matrix:
        """Whitened innovations (n × CHANNELS), 0 where they don't count."""
        return np.where(self.counts, self.filtered.residual, 0.0)

    @property
    def influence(self) -> Matrix:
        """Root of Huber's weights (n × CHANNELS), 0 where nothing counts; with it, squares are his loss."""
        return np.where(self.counts, np.sqrt(HUBER / np.maximum(np.abs(self.filtered.residual), HUBER)), 0.0)

    @property
    def log_likelihood(self) -> Matrix:
        """Log likelihood of the measurements (n × CHANNELS) by Huber's loss: beyond `HUBER` deviations, a line."""
        beyond = np.maximum(np.abs(self.filtered.residual) - HUBER, 0.0)
        return np.asarray(self.filtered.log_likelihood + 0.5 * beyond**2)


class Passes(NamedTuple):
    """A set of runs filtered with the same parameters."""

    theta: Vector
    plants: Regimes
    runs: tuple[Passed, ...]


class Direction(NamedTuple):
    """Parameters beside those of a pass, and by what the difference they make is multiplied."""

    theta: Vector
    per: float


class Wave(NamedTuple):
    """A torque on the motor that recurs with its angle: a direction that needs no step of the model for each."""

    harmonic: float
    cosine: bool
    with_current: bool  # `amplitude` is a share of the current's torque, else in N m
    amplitude: float

    def torque_N_m(self, p: Physics, run: Passed) -> Vector:
        """Return the torque from each row to the next, in the middle between them."""
        course = run.filtered.course
        phase = self.harmonic * (course[:, THETA_M] + 0.5 * run.series.period_s * course[:, OMEGA_M])
        torque = self.amplitude * (np.cos(phase) if self.cosine else np.sin(phase))
        if self.with_current:
            torque[:-1] *= p.K_t * course[1:, PREDICTED_CURRENT]
        return np.asarray(torque)


class Gram(NamedTuple):
    """Of the answers J of the innovations r to m directions: JᵀJ, and Jᵀr."""

    information: Matrix
    score: Vector


def counting(run: Filterable, d: Series, f: Filtered) -> Mask:
    """Return what of a pass is evidence of the parameters (n × CHANNELS).

    The current is, everywhere. The other channels are not while the start is forgotten, where dry friction may hold a
    mass or did so a moment ago, where the encoder dwells, and behind a jump of the load at an unknown instant.
    """
    counts = f.log_likelihood != 0.0
    held = (f.doubtful > 0) | run.dwelling
    for level, free in zip(d.friction_level_N_m, (d.friction_free_m, d.friction_free_j), strict=True):
        if level > 0.0:
            held = held | free
    # What friction did is Gaussian by name only, until the wire's slowest mode has died away.
    held[1:] = held[:-1].copy()
    for row in np.flatnonzero(held[:-1] & ~held[1:]):
        held[row + 1 : row + 1 + d.fading_rows] = True
    counts[:, :CURRENT] &= ~held[:, np.newaxis]
    counts[run.ringing, :CURRENT] = False
    counts[: run.settling_rows] = False
    return np.asarray(counts)


def pass_all(runs: Sequence[Filterable], theta: Vector, mapper: Mapper) -> Passes:
    """Filter runs with a vector of parameters (`model.parameters.NAMES`)."""
    plants = regimes(theta)
    return Passes(theta, plants, tuple(mapper(lambda run: pass_one(run, plants), runs)))


def pass_one(run: Filterable, plants: Regimes) -> Passed:
    """Filter a run with plants of a vector of parameters."""
    filtered = filter_run(plants, run.series)
    return Passed(run.series, filtered, counting(run, run.series, filtered))


def gram(passes: Passes, directions: Sequence[Direction], mapper: Mapper, waves: Sequence[Wave] = ()) -> Gram:
    """Return how the innovations answer to some directions, and behind them to `waves`."""
    plants = [(regimes(d.theta), d.per) for d in directions]
    base = passes.plants.sliding

    def one(run: Passed) -> Gram:
        influence = run.influence
        answers = np.empty((run.filtered.residual.size, len(plants) + len(waves)), dtype=np.float32)
        for at, (plant, per) in enumerate(plants):
            answer = response_run(plant, base, run.series, run.filtered, per)
            answer = np.where(run.counts, influence * answer, 0.0).ravel()
            # A plant that goes out of bounds within a row says nothing: no information, instead of an infinite one.
            answers[:, at] = answer if np.max(np.abs(answer)) < _WILD else 0.0
        for first in range(0, len(waves), COLUMNS_AT_ONCE):
            some = waves[first : first + COLUMNS_AT_ONCE]
            motor = np.column_stack([wave.torque_N_m(base, run) for wave in some])
            nothing = np.zeros((motor.shape[0], CHANNELS, motor.shape[1]))
            answer = forced(base, run.series, run.filtered, motor, np.zeros_like(motor), nothing)
            answer *= influence[:, :, np.newaxis]
            at = len(plants) + first
            answers[:, at : at + len(some)] = answer.reshape(answers.shape[0], -1)
        return gram_of(answers, (influence * run.residual).ravel())

    return total(list(mapper(one, passes.runs)))


def gram_of(columns: NDArray[np.float32], residual: Vector) -> Gram:
    """Return the Gram matrix of columns, summed in double precision: what is left beside parameters is a difference."""
    size = columns.shape[1]
    information, score = np.zeros((size, size)), np.zeros(size)
    for first in range(0, columns.shape[0], _ROWS_AT_ONCE):
        part = columns[first : first + _ROWS_AT_ONCE].astype(np.float64)
        information += part.T @ part
        score += part.T @ residual[first : first + _ROWS_AT_ONCE]
    return Gram(information, score)


def total(parts: Sequence[Gram]) -> Gram:
    """Return the sum over runs."""
    return Gram(np.sum([g.information for g in parts], axis=0), np.sum([g.score for g in parts], axis=0))
