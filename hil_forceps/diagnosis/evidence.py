"""Evidence of parameters: runs that a model is held to, reduced to what inference needs, a Gram matrix and scores."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.course import Course
from hil_forceps.diagnosis.state_space.advance import physics_of, steps_of
from hil_forceps.model.composition import Physics

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Mask = NDArray[np.bool_]
Columns = NDArray[np.float32]
Answer = TypeVar("Answer")
Values = TypeVar("Values", Matrix, Mask)

# Deviations: 1 in 370 by chance. A load that bends within a row or a mass that stops for one are not in the model; what
# is seldom and large is to say little (Huber, Robust Statistics, 1981).
HUBER = 3.0
WILD = 1e15  # in deviations; its square is still a number in single precision
_ROWS_AT_ONCE = 16384

Mapper = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]


class Direction(NamedTuple):
    """Parameters beside those of a pass, and by what the difference they make is multiplied.

    Where a plant with an effect takes other steps than the pass's, both differ without any effect, by the accuracy of
    the steps. `origin` has the effect with next to nothing of it: the difference is from there then.
    """

    theta: Vector
    per: float
    origin: Vector | None = None


def answers_of(
    base: Physics, directions: Sequence[Direction], answer: Callable[[Vector, float], Answer]
) -> Iterator[tuple[Answer, Answer | None]]:
    """Return what parameters of each direction do, and what those it is a difference from do; None: the pass's own.

    `answer`: of parameters, and by what a difference they make is multiplied: 1 for an origin. Of origins that are
    stepped alike one is looked at.
    """
    origins: dict[tuple[float, ...], Answer | None] = {steps_of(base): None}
    for direction in directions:
        own = None
        if direction.origin is not None:
            steps = steps_of(physics_of(direction.origin))
            if steps not in origins:
                origins[steps] = answer(direction.origin, 1.0)
            own = origins[steps]
        yield answer(direction.theta, direction.per), own


class Wave(NamedTuple):
    """A torque on the motor that recurs with its angle: a direction that needs no step of the model for each."""

    harmonic: float
    cosine: bool
    with_current: bool  # `amplitude` is a share of the current's torque, else in N m
    amplitude: float


class Passed(Protocol):
    """A run beside a model with some parameters; n rows with m channels."""

    @property
    def load_measured(self) -> bool:
        """Whether the run has a load cell."""

    @property
    def block_rows(self) -> int:
        """Rows over which residuals may hang together beside a model that is only nearly right."""

    @property
    def counts(self) -> Mask:
        """What is evidence of the parameters (n × m)."""

    @property
    def residual(self) -> Matrix:
        """Whitened residuals (n × m), 0 where they don't count."""

    @property
    def influence(self) -> Matrix:
        """Root of the weights of the loss (n × m), 0 where nothing counts."""

    @property
    def log_likelihood(self) -> Matrix:
        """Log likelihood (n × m), by the loss that `influence` is of."""

    def as_recorded(self, values: Values) -> Values:
        """Return values (n × m) at the rows at which their measurements were recorded; 0 where there is none."""

    def answers(self, base: Physics, directions: Sequence[Direction], waves: Sequence[Wave] = ()) -> Columns:
        """Return how the residuals answer to directions and behind them to waves (n·m × columns), by influence."""

    def curves(self, base: Physics, columns: Sequence[tuple[str, Vector]]) -> Columns:
        """Return how they answer to courses (place, n) of a torque [N m], a wire's force [N], an error of a sensor."""

    def course(self, base: Physics, *, before: bool) -> Course:
        """Return what happened in the run, by what was known up to each row, or `before` its measurements."""


class Evidence(Protocol):
    """A run that a model can be held to."""

    @property
    def name(self) -> str:
        """Name of the run."""

    @property
    def load_measured(self) -> bool:
        """Whether it has a load cell."""

    def passed(self, theta: Vector, plant: Physics) -> Passed:
        """Return it beside a model."""

    def with_rows_of(self, plant: Physics) -> Self:
        """Return it with channels that are late moved by whole rows as suits a model, and held there for all others."""


class Passes(NamedTuple):
    """A set of runs beside a model with the same parameters."""

    theta: Vector
    plant: Physics
    runs: tuple[Any, ...]  # `Passed`


class Gram(NamedTuple):
    """Of the answers J of the residuals r to m directions: JᵀJ, and Jᵀr."""

    information: Matrix
    score: Vector


def pass_all(runs: Sequence[Evidence], theta: Vector, mapper: Mapper) -> Passes:
    """Hold a model with a vector of parameters (`model.parameters.NAMES`) to runs."""
    plant = physics_of(theta)
    return Passes(theta, plant, tuple(mapper(lambda run: run.passed(theta, plant), runs)))


def gram(passes: Passes, directions: Sequence[Direction], mapper: Mapper, waves: Sequence[Wave] = ()) -> Gram:
    """Return how the residuals answer to some directions, and behind them to `waves`."""

    def one(run: Passed) -> Gram:
        columns = run.answers(passes.plant, directions, waves)
        return gram_of((columns,), (run.influence * run.residual).ravel())

    return total(list(mapper(one, passes.runs)))


def huber_weight(residual: Matrix) -> Matrix:
    """Return the root of Huber's weights."""
    return np.asarray(np.sqrt(HUBER / np.maximum(np.abs(residual), HUBER)))


def gram_of(blocks: Sequence[Columns], residual: Vector) -> Gram:
    """Return the Gram matrix of blocks of columns, in double precision: what parameters leave is a difference."""
    size = sum(block.shape[1] for block in blocks)
    information, score = np.zeros((size, size)), np.zeros(size)
    for first in range(0, residual.size, _ROWS_AT_ONCE):
        part = _part(blocks, first)
        information += part.T @ part
        score += part.T @ residual[first : first + _ROWS_AT_ONCE]
    return Gram(information, score)


def product(blocks: Sequence[Columns], sizes: Matrix) -> Matrix:
    """Return what blocks of columns make with some sizes of each (columns × m), in double precision (rows × m)."""
    found = np.empty((blocks[0].shape[0], sizes.shape[1]))
    for first in range(0, found.shape[0], _ROWS_AT_ONCE):
        found[first : first + _ROWS_AT_ONCE] = _part(blocks, first) @ sizes
    return found


def _part(blocks: Sequence[Columns], first: int) -> Matrix:
    """Return some rows of blocks side by side: all of them at once would take most of the memory."""
    return np.hstack([block[first : first + _ROWS_AT_ONCE] for block in blocks], dtype=np.float64)


def total(parts: Sequence[Gram]) -> Gram:
    """Return the sum over runs."""
    return Gram(np.sum([g.information for g in parts], axis=0), np.sum([g.score for g in parts], axis=0))
