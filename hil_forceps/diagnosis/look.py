"""A look at the whole catalogue beside a model: columns, the noise that no entry explains, and what each would gain.

Beside a model with effects the columns of the first look serve again, as long as the known parameters' sensitivities
are still much what they were; what then stands out is simulated beside the model itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.entries import Probe, Scene, probes
from hil_forceps.diagnosis.error_rates import FALSE_ALARMS, LEAST_GAIN_BESIDE
from hil_forceps.diagnosis.extension import Model
from hil_forceps.diagnosis.fit import gram
from hil_forceps.diagnosis.probing import columns_of, sized_columns
from hil_forceps.diagnosis.problem import Matrix, Problem
from hil_forceps.diagnosis.robust import inflations
from hil_forceps.diagnosis.score import Group, Scores, score
from hil_forceps.diagnosis.spectrum import Flat, Noise, Whitener, measure_noise

Vector = NDArray[np.float64]

STILL_GOOD = 0.9  # mean cos² between the known parameters' sensitivities then and now
TELLING_NORM = 5.0  # of a whitened sensitivity; shorter ones say nothing
STANDS_OUT = 0.5  # of the threshold: from here on it is looked at again


class Seen(NamedTuple):
    """What each place of the catalogue does to the channels."""

    places: tuple[Probe, ...]
    columns: Matrix
    groups: tuple[Group, ...]
    jacobian: Matrix  # of the model beside which it was seen
    borrowed: bool  # from a look beside another model


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """One look at the whole catalogue beside a model."""

    probes: tuple[Probe, ...]
    groups: tuple[Group, ...]
    columns: Matrix
    scores: Scores


def noise_of(model: Model, scan_columns: Matrix, whitener: Whitener, floor: Vector) -> tuple[Noise, Flat]:
    """Return the noise, no less than `floor`, and its course: what no fitted unknown and no entry explains."""
    problem, found = model.problem, model.fit
    columns = np.concatenate((found.jacobian, scan_columns), axis=1)
    white = whitener.apply(columns)
    norms = np.sqrt(np.maximum(np.einsum("ij,ij->j", white, white, dtype=np.float64), 1e-30)).astype(np.float32)
    white /= norms
    values, vectors = np.linalg.eigh(gram(white, white, problem.mapper))
    kept = values > 1e-7 * float(values.max())
    white = white @ (vectors[:, kept] / np.sqrt(values[kept])).astype(np.float32)  # orthonormal now
    left = whitener.apply(found.residual)
    left -= white @ (white.T @ left)
    noise = measure_noise(problem.layout, whitener, left, white)
    return noise._replace(power=np.maximum(noise.power, floor)), whitener.undo(left)


def no_columns(problem: Problem) -> Matrix:
    """Return a matrix without columns."""
    return np.empty((problem.layout.size, 0), dtype=np.float32)


class Looker:
    """Looks at the catalogue; remembers the first look and the noise."""

    def __init__(self, scene: Scene, without: frozenset[str], floor: Vector, seed: int) -> None:
        self._probes = probes(scene, without)
        self._floor = floor
        self._seed = seed
        self._first: Seen | None = None
        self._course: Flat | None = None  # of the noise, as the last look left it
        self.inflation: dict[str, float] = {}  # of each entry: how much more than white noise chance gives it

    def see(self, model: Model, whitener: Whitener) -> Seen:
        """Return the columns of every entry that isn't in the model, simulated or from the first look."""
        if self._first is not None and model.effects and _still_good(self._first, model, whitener):
            kept = [i for i, probe in enumerate(self._first.places) if probe.effect_id not in model.effects]
            return _some(self._first, kept)._replace(borrowed=True)
        places = [p for p in self._probes if p.effect_id not in model.effects]
        fitted = whitener.apply(model.fit.jacobian)
        sized, columns, groups = sized_columns(model.problem, model.fit.u, places, fitted, whitener)
        seen = Seen(tuple(sized), columns, tuple(groups), model.fit.jacobian, borrowed=False)
        if not model.effects:
            self._first = seen
        return seen

    def noise(self, model: Model, seen: Seen, whitener: Whitener) -> Noise:
        """Return the noise that neither the model nor any entry explains."""
        noise, self._course = noise_of(model, seen.columns, whitener, self._floor)
        return noise

    def scan(self, model: Model, seen: Seen, whitener: Whitener) -> Scan:
        """Score every entry; what stands out by columns from another look is simulated first."""
        found = self._scored(model, seen, whitener)
        if not seen.borrowed:
            return found
        high = np.flatnonzero(found.scores.gains > STANDS_OUT * found.scores.threshold)
        names = {seen.places[i].effect_id for i in high}
        which = [i for i, probe in enumerate(seen.places) if probe.effect_id in names]
        if not which:
            return found
        fitted = whitener.apply(model.fit.jacobian)
        sized, columns, groups = sized_columns(
            model.problem, model.fit.u, [seen.places[i] for i in which], fitted, whitener
        )
        places, all_columns = list(seen.places), seen.columns.copy()
        for i, probe, group in zip(which, sized, groups, strict=True):
            places[i] = probe
            all_columns[:, seen.groups[i].first : seen.groups[i].stop] = columns[:, group.first : group.stop]
        return self._scored(model, seen._replace(places=tuple(places), columns=all_columns), whitener)

    def _scored(self, model: Model, seen: Seen, whitener: Whitener) -> Scan:
        fitted, white = whitener.apply(model.fit.jacobian), whitener.apply(seen.columns)
        assert self._course is not None
        found = score(
            fitted,
            model.problem.prior_weights(),
            model.fit.u,
            white,
            seen.groups,
            whitener.apply(model.fit.residual),
            FALSE_ALARMS,
            self._seed,
            gram(white, white, model.problem.mapper),
        )
        gains = found.gains.copy()
        threshold = max(found.threshold, LEAST_GAIN_BESIDE) if model.effects else found.threshold
        high = [int(i) for i in np.flatnonzero(gains > STANDS_OUT * threshold)]
        if high:
            some = _some(seen._replace(columns=white), high)
            inflation = inflations(
                model.problem.layout,
                fitted,
                some.columns,
                some.groups,
                whitener.apply(self._course),
            )
            gains[high] /= inflation
            for name, much in of_best_places([seen.places[i].effect_id for i in high], gains[high], inflation).items():
                self.inflation[name] = max(self.inflation.get(name, 1.0), much)
        return Scan(seen.places, seen.groups, seen.columns, found._replace(gains=gains, threshold=threshold))


def of_best_places(names: Sequence[str], gains: Vector, inflation: Vector) -> dict[str, float]:
    """Return the inflation of each entry at the one of its places that gains most: from there it is refitted.

    Another place may hang on one instant, as a limit half a percent off does, and the scatter of one block is anything.
    """
    return {name: float(inflation[i]) for name, i in best_places(names, gains).items()}


def best_places(names: Sequence[str], gains: Vector) -> dict[str, int]:
    """Return the place of each entry that gains most; `names`: of the entry of each place."""
    best: dict[str, int] = {}
    for i, name in enumerate(names):
        if name not in best or gains[i] > gains[best[name]]:
            best[name] = i
    return best


def _some(seen: Seen, which: Sequence[int]) -> Seen:
    """Return some of the places with their columns."""
    columns, groups = columns_of(seen.columns, seen.groups, which)
    return seen._replace(places=tuple(seen.places[i] for i in which), columns=columns, groups=tuple(groups))


def _still_good(seen: Seen, model: Model, whitener: Whitener) -> bool:
    """Tell whether the known parameters' sensitivities are much what they were."""
    known = model.problem.shared.known
    then, now = whitener.apply(seen.jacobian[:, :known]), whitener.apply(model.fit.jacobian[:, :known])
    products, old, new = (np.einsum("ij,ij->j", *pair) for pair in ((then, now), (then, then), (now, now)))
    telling = (old > TELLING_NORM**2) & (new > TELLING_NORM**2)
    return bool(telling.any() and np.mean(products[telling] ** 2 / (old * new)[telling]) >= STILL_GOOD)
