"""Whether a parameter changes over sessions: a likelihood ratio over all onsets, and what it reaches by chance.

A change is a step at a session, or a bend: from a session on the parameter goes up or down by as much each session. The
statistic is the largest gain of the log likelihood by any of them, with the scatter between sessions fitted anew on
both sides (a generalised likelihood ratio). What it reaches without a change hangs on that scatter, so it is drawn: by
a parametric bootstrap from the model without the change.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.drift.regression import Beside, beside, likelihoods
from hil_forceps.drift.scatter import Scatter, drawn, scatters

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Kind = Literal["step", "slope"]

FEWEST_BEYOND = 3  # sessions on both sides of an onset: one or two that differ are no drift
FEWEST_SESSIONS = 8  # that measure a parameter, for a test of it
MOST_ONSETS = 64  # of each kind in the test; the onset itself is then looked for among all sessions
DRAWS = 999
BLOCK = 250  # of the draws, between two looks at whether the answer hangs on more
UNLIKELY = 5.0  # log likelihood below the best: 1 in 1000 draws of the best is likelier with such a scatter


class Change(NamedTuple):
    """A change: the first session that it touches, by its place in the series."""

    kind: Kind
    onset: int


class Tested(NamedTuple):
    """A test for one more change."""

    best: Change
    gain: float  # of the log likelihood
    p_value: float  # of the whole series; where it can't be significant any more, of as many draws as told that
    draws: int
    scatter: Scatter  # without the change


def column_of(change: Change, sessions: int) -> Vector:
    """Return a change of size 1 (step), or of 1 a session (slope), over sessions."""
    after = np.arange(sessions) - change.onset
    return np.where(after >= 0, 1.0 if change.kind == "step" else after + 1.0, 0.0)


def design(changes: Sequence[Change], sessions: int) -> Matrix:
    """Return the columns of a level with changes."""
    return np.column_stack([np.ones(sessions), *(column_of(change, sessions) for change in changes)])


def onsets(sessions: int, most: int) -> list[int]:
    """Return places at which a change may begin, spread evenly where there are more than `most`."""
    count = sessions - 2 * FEWEST_BEYOND + 1
    spread = np.linspace(FEWEST_BEYOND, sessions - FEWEST_BEYOND, min(count, most))
    return [int(place) for place in np.unique(spread.astype(int))]


def possible(sessions: int, most: int = MOST_ONSETS) -> list[Change]:
    """Return the changes that are tested."""
    places = onsets(sessions, most)
    first = Change("slope", 1)  # from the beginning on
    return [first, *(Change("slope", place) for place in places), *(Change("step", place) for place in places)]


def change_test(
    series: Vector, deviations: Vector, known: Sequence[Change], rate: float, rng: np.random.Generator
) -> Tested:
    """Test a series for one more change beside those known, at a rate of false alarms of the whole series.

    `series`, `deviations`: estimates of the sessions in their order and the deviations of their own errors (n each).
    """
    changes = possible(series.size)
    further = np.column_stack([column_of(change, series.size) for change in changes])
    models = beside(design(known, series.size), further, deviations, scatters(deviations))
    told = likelihoods(series[:, np.newaxis], deviations, models)
    likely = _likely(told.model[:, 0]) | _likely((told.model + told.gains)[:, 0])
    models = [model for model, keep in zip(models, likely, strict=True) if keep]
    told = likelihoods(series[:, np.newaxis], deviations, models)
    place = int(np.argmax((told.model + told.gains)[:, 0]))
    gain = float((told.model + told.gains)[:, 0].max() - told.model[:, 0].max())
    scatter = models[int(np.argmax(told.restricted[:, 0]))].scatter
    p_value, draws = _by_chance(gain, models, deviations, scatter, rate, rng)
    return Tested(changes[int(told.best[place, 0])], gain, p_value, draws, scatter)


def _likely(values: Vector) -> NDArray[np.bool_]:
    return np.asarray(values > values.max() - UNLIKELY)


def _by_chance(
    gain: float,
    models: Sequence[Beside],
    deviations: Vector,
    scatter: Scatter,
    rate: float,
    rng: np.random.Generator,
) -> tuple[float, int]:
    """Return how often series without the change gain as much, and of how many; ends where it is no alarm any more."""
    above, done = 0, 0
    most = int(rate * (DRAWS + 1)) - 1  # exceedances with which the whole number of draws is an alarm
    while done < DRAWS and above <= most:
        count = min(BLOCK, DRAWS - done)
        told = likelihoods(drawn(rng, deviations, scatter, count), deviations, models)
        gains = (told.model + told.gains).max(axis=0) - told.model.max(axis=0)
        above += int(np.count_nonzero(gains >= gain))
        done += count
    return (above + 1) / (done + 1), done
