"""Which entries of the catalogue join the model: forward by the highest gain, then backward and by exchange.

Every entry is looked for at several shapes by its linear sensitivity; the best few are refitted without linearising.
All models that come within `SET_DROP` of the best are kept: the data can't tell them apart.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.entries import Probe, Scene, free_names, probes
from hil_forceps.diagnosis.fit import Fit, Held, chi2_of, fit, gram, hold
from hil_forceps.diagnosis.probing import sized_columns
from hil_forceps.diagnosis.problem import Matrix, Problem
from hil_forceps.diagnosis.result import Candidate
from hil_forceps.diagnosis.robust import inflations
from hil_forceps.diagnosis.score import COST_PER_COLUMN, Group, Scores, score
from hil_forceps.diagnosis.spectrum import Flat, Noise, Whitener, measure_noise, whitening
from hil_forceps.model import parameters
from hil_forceps.rig.catalogue import effect

Vector = NDArray[np.float64]

MAX_EFFECTS = 3
SHORTLIST = 7
MAX_HALVINGS = 6
SHORTLIST_DROP = 40.0  # of the linear gain below the best
SET_DROP = 6.0
ACCURACY = 0.004  # of the misfit already explained: a further effect must gain more than numerics and smoothing leave
CHANCE = 0.005  # family-wise, of naming something where nothing is
# Chance under exact noise gives 14 or 15. What is not exact (noise of the load below its smoothing, friction that the
# encoder's rounding shakes loose) gave up to 36 in runs without any effect. An effect of d = 8 gives 64 on average.
LEAST_GAIN = 28.0


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """Effects and the fit with them."""

    effects: tuple[str, ...]
    problem: Problem
    fit: Fit
    at_bound: bool = False

    @property
    def worth(self) -> float:
        """Return χ² and what chance takes off it for each unknown: the lower the better."""
        return self.fit.chi2 + COST_PER_COLUMN * len(self.problem.shared.items)


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """One look at the whole catalogue beside a model."""

    probes: tuple[Probe, ...]
    groups: tuple[Group, ...]
    columns: Matrix
    scores: Scores


class Rival(NamedTuple):
    """A model that the data can't tell from the chosen one."""

    model: Model
    behind: float  # how far its χ² is above the best one's, both with the same noise


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """What was chosen, and what was looked at."""

    model: Model
    rivals: tuple[Rival, ...]  # of as many effects, the best first, the chosen one among them
    candidates: tuple[Candidate, ...]
    scan: Scan  # the last one: beside the chosen model
    whitener: Whitener
    noise: Noise
    inflation: Mapping[str, float]  # of each entry: how much more than white noise chance gives it


def noise_of(model: Model, scan_columns: Matrix, whitener: Whitener, floor: Vector) -> tuple[Noise, Flat]:
    """Return the noise, no less than `floor`, and its course: what no fitted unknown and no entry explains."""
    problem, found = model.problem, model.fit
    columns = np.concatenate((found.jacobian, scan_columns), axis=1)
    white = whitener.apply(columns)
    norms = np.sqrt(np.maximum(np.einsum("ij,ij->j", white, white, dtype=np.float64), 1e-30)).astype(np.float32)
    white /= norms
    values, vectors = np.linalg.eigh(gram(white, white))
    kept = values > 1e-7 * float(values.max())
    white = white @ (vectors[:, kept] / np.sqrt(values[kept])).astype(np.float32)  # orthonormal now
    left = whitener.apply(found.residual)
    left -= white @ (white.T @ left)
    leverage = np.einsum("ij,ij->i", white, white)
    course = whitener.undo(left)
    noise = measure_noise(problem.layout, course, leverage)
    return noise._replace(power=np.maximum(noise.power, floor)), course


class Chooser:
    """Chooses the effects for a problem; keeps what it has fitted."""

    def __init__(
        self,
        scene: Scene,
        without: frozenset[str],
        floor: Vector,
        seed: int,
        progress: Callable[[str], None],
        refresh: Callable[[Problem, Vector], Problem],
    ) -> None:
        self._scene = scene
        self._without = without
        self._floor = floor
        self._seed = seed
        self._progress = progress
        self._refresh = refresh  # what of the problem hangs on the model, taken anew
        self._candidates: list[Candidate] = []
        self._first_chi2 = 0.0
        self._course: Flat | None = None  # of the noise, as the last look left it
        self.inflation: dict[str, float] = {}  # of each entry: how much more than white noise chance gives it

    def choose(self, baseline: Model, whitener: Whitener) -> Choice:
        """Choose from the refitted baseline on; `whitener` is a first guess of the noise."""
        model = baseline
        rivals = [Rival(baseline, 0.0)]
        model, scan, whitener, noise = self._look(model, whitener)
        self._first_chi2 = model.fit.chi2
        for step in range(MAX_EFFECTS):
            refined = self._refined(model, scan, whitener, step)
            if not refined:
                break
            best = refined[0]
            rivals = self._within_reach([Rival(m, m.worth - best.worth) for m in refined])
            model, scan, whitener, noise = self._look(best, whitener)
            if step > 0:
                model, rivals = self._exchange(model, rivals, whitener)
        model, rivals = self._thinned(model, rivals, scan, whitener)
        return Choice(model, tuple(rivals), tuple(self._candidates), scan, whitener, noise, self.inflation)

    def _look(self, model: Model, whitener: Whitener) -> tuple[Model, Scan, Whitener, Noise]:
        """Scan the catalogue beside a model; take the noise anew from what neither explains; refit with it."""
        if model.effects:
            model = replace(model, problem=self._refresh(model.problem, model.fit.u))
            model = replace(model, fit=fit(model.problem, model.fit.u, whitener, steps=3))
        self._progress("looking at " + (" + ".join(model.effects) or "the known parameters"))
        places = self._places(model)
        fitted = whitener.apply(model.fit.jacobian)
        places, columns, groups = sized_columns(model.problem, model.fit.u, places, fitted, whitener)
        noise, self._course = noise_of(model, columns, whitener, self._floor)
        whitener = whitening(model.problem.layout, noise)
        model = replace(model, fit=fit(model.problem, model.fit.u, whitener, steps=3))
        return model, self._scored(model, whitener, places, columns, groups), whitener, noise

    def _refined(self, model: Model, scan: Scan, whitener: Whitener, step: int) -> list[Model]:
        """Refit with each entry that stands out; return the models that gain enough, the best first."""
        best: dict[str, int] = {}
        for i, probe in enumerate(scan.probes):
            so_far = best.get(probe.effect_id)
            if so_far is None or scan.scores.gains[i] > scan.scores.gains[so_far]:
                best[probe.effect_id] = i
        threshold = max(scan.scores.threshold, ACCURACY * (self._first_chi2 - model.fit.chi2))
        order = sorted(best.values(), key=lambda i: -scan.scores.gains[i])
        top = scan.scores.gains[order[0]] if order else 0.0
        drop = max(SHORTLIST_DROP, 0.4 * top)
        short = [i for i in order if scan.scores.gains[i] > max(threshold * 0.7, top - drop)][:SHORTLIST]
        found = []
        gains: dict[str, float] = {}
        held = hold(model.fit.jacobian, len(model.problem.shared.items), whitener)
        for i in short:
            refit = self.refine(model, scan.probes[i], scan.scores.amplitudes[i], whitener, held)
            extra = len(refit.problem.shared.items) - len(model.problem.shared.items)
            gain = (model.fit.chi2 - refit.fit.chi2) / self.inflation[scan.probes[i].effect_id]
            gain -= COST_PER_COLUMN * (extra - 1)
            gains[scan.probes[i].effect_id] = gain
            if gain > threshold and not refit.at_bound:
                found.append(refit)
        found.sort(key=lambda m: m.worth)
        self._note(scan, best, gains, found, step)
        return found

    def refine(
        self, model: Model, probe: Probe, amplitudes: Vector, whitener: Whitener, held: Held, steps: int = 8
    ) -> Model:
        """Refit a model with an entry added, beginning where the linear look found it."""
        self._progress(f"refitting with {probe.effect_id}")
        entry = effect(probe.effect_id)
        start = dict(probe.start)
        for name, amplitude in zip(probe.amplitudes, amplitudes, strict=False):
            start[name] *= float(amplitude)
        for p in entry.parameters:
            start[p.name] = float(np.clip(start.get(p.name, p.neutral or 0.0), p.minimum, p.maximum))
        count = len(model.problem.shared.items)
        for _ in range(MAX_HALVINGS):
            problem, u = _with_effect(model, probe, start)
            residual = problem.measured - problem.predicted(u)
            if not probe.amplitudes or chi2_of(problem, residual, whitener, u) < model.fit.chi2:
                break  # else the linear look has promised too much
            start |= {name: 0.5 * start[name] for name in probe.amplitudes}
        result = fit(problem, u, whitener, held=held, steps=steps)
        return Model((*model.effects, probe.effect_id), problem, result, _at_bound(problem, result, count))

    def _exchange(self, model: Model, rivals: list[Rival], whitener: Whitener) -> tuple[Model, list[Rival]]:
        """Replace each effect but the last by every other that stands out in its place, where that fits better."""
        for place in range(len(model.effects) - 1):
            reduced = without_effect(model, place, whitener)
            scan = self._scan(reduced, whitener, self._places(reduced))
            for other in self._refined(reduced, scan, whitener, len(model.effects)):
                if set(other.effects) == set(model.effects):
                    continue
                behind = other.worth - model.worth
                if behind < -1.0:
                    model = other
                    rivals = [Rival(rival.model, rival.behind - behind) for rival in rivals]
                    behind = 0.0
                rivals.append(Rival(other, behind))
        return model, self._within_reach(rivals)

    def _scan(self, model: Model, whitener: Whitener, places: Sequence[Probe]) -> Scan:
        fitted = whitener.apply(model.fit.jacobian)
        places, columns, groups = sized_columns(model.problem, model.fit.u, places, fitted, whitener)
        return self._scored(model, whitener, places, columns, groups)

    def _scored(
        self, model: Model, whitener: Whitener, places: Sequence[Probe], columns: Matrix, groups: Sequence[Group]
    ) -> Scan:
        fitted, white = whitener.apply(model.fit.jacobian), whitener.apply(columns)
        assert self._course is not None
        inflation = inflations(model.problem.layout, fitted, white, groups, whitener.apply(self._course))
        found = score(
            fitted,
            model.problem.prior_weights(),
            model.fit.u,
            white,
            groups,
            whitener.apply(model.fit.residual),
            CHANCE,
            self._seed,
        )
        found = found._replace(gains=found.gains / inflation, threshold=max(found.threshold, LEAST_GAIN))
        for probe, much in zip(places, inflation, strict=True):
            self.inflation[probe.effect_id] = max(self.inflation.get(probe.effect_id, 1.0), float(much))
        return Scan(tuple(places), tuple(groups), columns, found)

    def _thinned(self, model: Model, rivals: list[Rival], scan: Scan, whitener: Whitener) -> tuple[Model, list[Rival]]:
        """Drop effects that no longer gain enough with the noise as it is known in the end."""
        for place in reversed(range(len(model.effects))):
            less = without_effect(model, place, whitener)
            if less.fit.chi2 - model.fit.chi2 < scan.scores.threshold * self.inflation[model.effects[place]]:
                self._candidates = [
                    replace(c, state="below threshold") if c.id == model.effects[place] and c.state == "named" else c
                    for c in self._candidates
                ]
                model, rivals = less, [Rival(less, 0.0)]
        return model, rivals

    def _within_reach(self, rivals: list[Rival]) -> list[Rival]:
        """Return those that can't be told from the best, the best first, each set of effects once."""
        found: dict[frozenset[str], Rival] = {}
        for rival in sorted(rivals, key=lambda rival: rival.behind):
            if rival.behind <= SET_DROP * max(self.inflation.get(name, 1.0) for name in rival.model.effects):
                found.setdefault(frozenset(rival.model.effects), rival)
        return list(found.values())

    def _places(self, model: Model) -> list[Probe]:
        return [p for p in probes(self._scene, self._without) if p.effect_id not in model.effects]

    def _note(self, scan: Scan, best: dict[str, int], gains: dict[str, float], found: list[Model], step: int) -> None:
        named = found[0].effects[-1] if found else ""
        for effect_id, i in best.items():
            gain = gains.get(effect_id, float(scan.scores.gains[i]))
            if effect_id == named:
                state = "named"
            elif not scan.scores.informative[i]:
                state = "not excited"
            elif gain <= scan.scores.threshold:
                state = "below threshold"
            elif any(m.effects[-1] == effect_id and m.worth - found[0].worth <= SET_DROP for m in found):
                state = "tied"
            elif effect_id in gains and all(m.effects[-1] != effect_id for m in found):
                state = "at a bound"
            else:
                state = "weaker"
            self._candidates.append(Candidate(effect_id, step, gain, scan.scores.threshold, state))  # type: ignore[arg-type]


def _with_effect(model: Model, probe: Probe, start: dict[str, float]) -> tuple[Problem, Vector]:
    """Return the problem with an entry added, and where to begin: the model with the entry at `start`."""
    count = len(model.problem.shared.items)
    shared = model.problem.shared.with_effect(probe.effect_id, start, free_names(effect(probe.effect_id), probe))
    base = model.problem.base.copy()
    for name, value in start.items():
        base[parameters.index(f"effects.{probe.effect_id}.{name}")] = value
    problem = replace(model.problem.with_shared(shared), base=base)
    return problem, np.concatenate((model.fit.u[:count], np.zeros(len(shared.items) - count), model.fit.u[count:]))


def without_effect(model: Model, place: int, whitener: Whitener) -> Model:
    """Return the model refitted without one of its effects."""
    gone = model.effects[place]
    items = model.problem.shared.items
    keep = [i for i, item in enumerate(items) if not item.name.startswith(f"effects.{gone}.")]
    shared = type(model.problem.shared)(tuple(items[i] for i in keep))
    base = model.problem.base.copy()
    for p in effect(gone).parameters:
        name = f"effects.{gone}.{p.name}"
        base[parameters.index(name)] = parameters.off_value(name)
    problem = replace(model.problem.with_shared(shared), base=base)
    count = len(items)
    u = np.concatenate((model.fit.u[keep], model.fit.u[count:]))
    return Model(tuple(e for e in model.effects if e != gone), problem, fit(problem, u, whitener, steps=4))


def _at_bound(problem: Problem, result: Fit, first: int) -> bool:
    """Tell whether a parameter of the newest effect ended at the end of its physical range."""
    low, high = problem.bounds()
    stop = len(problem.shared.items)
    part = slice(first, stop)
    room = 1e-9 * np.maximum(1.0, np.abs(result.u[part]))
    return bool(np.any((result.u[part] <= low[part] + room) | (result.u[part] >= high[part] - room)))
