"""Which entries of the catalogue join the model: forward by the highest gain, then backward and by exchange.

Every entry is looked for at several shapes by its linear sensitivity; the best few are refitted without linearising.
All models that come within `SET_DROP` of the best are kept: the data can't tell them apart.

Where the measured motion drives, what is left is many times the noise, and an entry that joins early keeps what others
would say better: there several ways up are gone, each from another first entry, and the likeliest at its end is taken.
"""

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.extension import Model, Refresh, extend, without_effect
from hil_forceps.diagnosis.fit import AGAIN_STEPS, Held, fit, fit_again, hold, hold_beside, hold_nuisances
from hil_forceps.diagnosis.look import Looker, Scan
from hil_forceps.diagnosis.problem import Problem
from hil_forceps.diagnosis.result import Candidate
from hil_forceps.diagnosis.ringing import at_the_rig_s_word, in_valley_of, out_of_a_wrong_valley, vertex
from hil_forceps.diagnosis.score import COST_PER_COLUMN
from hil_forceps.diagnosis.shortlist import (
    NEAR_DROP,
    aliases,
    best_of_each,
    promising,
    shortlists,
    to_try,
    with_aliases,
)
from hil_forceps.diagnosis.spectrum import Noise, Whitener
from hil_forceps.diagnosis.whole import with_whole_harmonics
from hil_forceps.diagnosis.widths import at_better_widths

Vector = NDArray[np.float64]

MAX_EFFECTS = 6
MAX_EXCHANGED = 3  # with more, only forward and backward: each exchange looks at the whole catalogue again
# The truth is this far behind its likest neighbour in 2.3 % of cases at most, however well the data tell the two apart:
# its χ² differs from the neighbour's by δ² ± 2δ, and (4 + δ²) / 2δ is no less than 2.
SET_DROP = 4.0
MOST_REFRESHES = 8
TURNS_FOLLOWED = 20.0  # of fit and rounding, by what the first gains: what is further from the best isn't followed
BEYOND = 4.0  # steps of a fit with its rounding taken anew, tried where one such step still helps
ONWARD = 0.25  # of the whole way of fit and rounding in turn: how far beyond its end is looked at
MOST_STRIDES = 6  # of that
WAYS = 3  # up, from another first entry each, where the motion drives
CLEARLY = 4.0  # times what an effect must gain: no better fit without it takes that away
SETTLED = 10.0  # of χ²: where friction holds, the rounding as it was for one speed of its film keeps that speed
ACCURACY = 0.004  # of the misfit already explained: a further effect must gain more than numerics and smoothing leave
# The same where the motion drives: what is left of other causes is no noise, and some entry follows a little of it
# (0.7 % by a weight on an axis that lies flat, for the worse in the runs held out).
ACCURACY_DRIVEN = 0.01


Look = tuple[Model, Scan, Whitener, Noise]  # the catalogue beside a model, which is refitted for it, and the noise


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


def no_longer_named(
    candidates: Iterable[Candidate], dropped: Collection[str], state: Literal["below threshold", "weaker"]
) -> list[Candidate]:
    """Return the candidates with those that were named and are dropped in another state."""
    return [replace(c, state=state) if c.state == "named" and c.id in dropped else c for c in candidates]


def _from(problem: Problem, u: Vector, model: Model, whitener: Whitener) -> Model:
    """Return a model fitted to a problem from u on; the model itself where that is its problem."""
    if problem is model.problem:
        return model
    return replace(model, problem=problem, fit=fit(problem, u, whitener, steps=AGAIN_STEPS))


def _moved(model: Model, stride: Vector) -> Model:
    """Return a model with its unknowns moved, to be taken anew there: χ² isn't known, and infinite."""
    low, high = model.problem.bounds()
    return replace(model, fit=model.fit._replace(u=np.clip(model.fit.u + stride, low, high), chi2=math.inf))


def _named_instead(
    candidates: Iterable[Candidate], step: int, name: str, state: Literal["weaker", "at a bound"] = "weaker"
) -> list[Candidate]:
    """Return the candidates with this one as the one that was named in a step; the one that was, in another state."""
    return [
        c if c.step != step else replace(c, state="named" if c.id == name else state if c.state == "named" else c.state)
        for c in candidates
    ]


def _unlikeliness(choice: Choice) -> float:
    """Return −2 log of the likelihood of a model with its own noise (Whittle), but for a constant."""
    return choice.model.worth - 2.0 * float(np.sum(np.log(choice.whitener.factor, dtype=np.float64)))


class Chooser:
    """Chooses the effects for a problem; keeps what it has fitted."""

    def __init__(
        self,
        looker: Looker,
        progress: Callable[[str], None],
        refresh: Refresh,
        *,
        driven: bool = False,
    ) -> None:
        self._looker = looker
        self._progress = progress
        self._refresh = refresh  # what of the problem hangs on the model, taken anew
        self._driven = driven  # by the measured motion
        self._candidates: list[Candidate] = []
        self._first_chi2 = 0.0

    def choose(self, baseline: Model, whitener: Whitener) -> Choice:
        """Choose from the refitted baseline on; `whitener` is a first guess of the noise."""
        model, scan, whitener, noise = self._look(baseline, whitener)
        self._first_chi2 = model.fit.chi2
        start = Choice(model, (Rival(model, 0.0),), (), scan, whitener, noise, self._looker.inflation)
        refined = self._refined(model, scan, whitener, 0)
        return self._likeliest_way(start, refined) if self._driven else self._grown(start, refined)

    def _likeliest_way(self, start: Choice, refined: list[Model]) -> Choice:
        """Let entries join from each of the best first ones on; return the way that is likeliest where it ends."""
        ways: list[tuple[Choice, dict[str, float]]] = []
        noted, inflation = list(self._candidates), dict(self._looker.inflation)
        for first in refined[:WAYS]:
            self._candidates = _named_instead(noted, 0, first.effects[-1])
            self._looker.inflation = dict(inflation)
            others = [model for model in refined if model is not first]
            ways.append((self._grown(start, [first, *others]), self._looker.inflation))
        if not ways:
            return start
        way, self._looker.inflation = min(ways, key=lambda way: _unlikeliness(way[0]))
        self._candidates = list(way.candidates)
        model, scan, whitener, noise = self._look(way.model, way.whitener)
        return self._grown(replace(way, model=model, scan=scan, whitener=whitener, noise=noise), [])

    def further(self, choice: Choice) -> Choice:
        """Go on from a choice beside which something is left; the same choice where that leads nowhere.

        Where friction or a slack is bent to what an entry would do, its linear gain can be 5 and a refit's 90.
        """
        refined = self._refined(choice.model, choice.scan, choice.whitener, len(choice.model.effects), overlooked=True)
        return self._grown(choice, refined) if refined else choice

    def instead(self, choice: Choice) -> Choice:
        """Replace an effect beside which much is left by another, each beside its own rounding; or the same choice.

        What the drive's rounding does is taken from what a model leaves, and with it some of what it lacks: a slack
        gained 44 beside the rounding that was taken without it, and 600 beside its own. Where there is no effect yet,
        one joins by what it gains beside its own. What a first turn brings no nearer isn't followed.
        """
        model, whitener = choice.model, choice.whitener
        if len(model.effects) > MAX_EXCHANGED:
            return choice
        best, gain = model, 0.0
        least = SETTLED if model.effects else choice.scan.scores.threshold
        for reduced, scan in self._with_one_less(choice):
            held = hold(reduced.fit.jacobian, len(reduced.problem.shared.items), whitener)
            for i in promising(scan, model.effects):
                name = scan.probes[i].effect_id
                self._progress(f"refitting with {name} instead")
                first = extend(reduced, scan.probes[i], scan.scores.amplitudes[i], whitener, held)
                other = self._anew(first, whitener)
                if other.worth - best.worth > TURNS_FOLLOWED * max(first.worth - other.worth, SETTLED):
                    continue
                other = self._refitted(other, whitener)
                if not other.newest_at_an_end and other.worth < best.worth - least:
                    best, gain, least = other, reduced.fit.chi2 - other.fit.chi2, SETTLED
        if best is model:
            return choice
        self._candidates = no_longer_named(self._candidates, set(model.effects) - set(best.effects), "weaker")
        step, threshold = len(best.effects) - 1, choice.scan.scores.threshold
        self._candidates.append(Candidate(best.effects[-1], step, gain, threshold, "named"))
        best, scan, whitener, noise = self._look(best, whitener)
        start = replace(choice, model=best, rivals=(Rival(best, 0.0),), scan=scan, whitener=whitener, noise=noise)
        return self._grown(start, self._refined(best, scan, whitener, len(best.effects)))

    def _with_one_less(self, choice: Choice) -> Iterator[tuple[Model, Scan]]:
        """Yield the model without each of its effects, and the catalogue beside that; the model itself without any."""
        if not choice.model.effects:
            yield choice.model, choice.scan
        for place in range(len(choice.model.effects)):
            yield self._without(choice.model, place, choice.whitener)

    def _grown(self, choice: Choice, refined: list[Model]) -> Choice:
        """Let entries join as long as one gains enough, beginning with the first of those refitted."""
        model, rivals = choice.model, list(choice.rivals)
        scan, whitener, noise = choice.scan, choice.whitener, choice.noise
        while refined and len(model.effects) < MAX_EFFECTS:
            best, others, (looked_at, scan, whitener, noise) = self._first_of(refined, whitener)
            model, rivals = self._compared([Rival(looked_at, 0.0)], others, best.worth, whitener)
            if 1 < len(best.effects) <= MAX_EXCHANGED:
                model, rivals = self._exchange(model, rivals, whitener)
            if model is not looked_at:
                model, scan, whitener, noise = self._look(model, whitener)
            more = len(model.effects) < MAX_EFFECTS
            refined = self._refined(model, scan, whitener, len(model.effects)) if more else []
        model, rivals = self._thinned(model, rivals, scan, whitener)
        return Choice(model, tuple(rivals), tuple(self._candidates), scan, whitener, noise, self._looker.inflation)

    def _first_of(self, refined: list[Model], whitener: Whitener) -> tuple[Model, list[Model], Look]:
        """Look at the best of those refitted; where that goes to an end of its range, at one that comes near instead.

        There it is another entry's law, or none that it can follow: a presliding whose length has gone to nothing is
        friction that holds at once.
        """
        best, *others = refined
        look = self._look(best, whitener)
        for other in others if look[0].newest_at_an_end else ():
            if self._near(other, best, best.worth):
                instead = self._look(other, whitener)
                if not instead[0].newest_at_an_end:
                    step = len(other.effects) - 1
                    self._candidates = _named_instead(self._candidates, step, other.effects[-1], "at a bound")
                    return other, [model for model in others if model is not other], instead
        return best, others, look

    def _near(self, other: Model, model: Model, level: float) -> bool:
        """Tell whether a rough fit comes near enough to a level of a model's to be worth a full one."""
        near = NEAR_DROP * self._inflation(other.effects[-1])
        return other.worth - level <= near or aliases(other.effects, model.effects)

    def _look(self, model: Model, whitener: Whitener) -> Look:
        """Scan the catalogue beside a model; take the noise anew from what neither explains; refit with it."""
        if model.effects:
            found = self._refitted(model, whitener)
            # In another valley of the inertia unknowns are counted from another place.
            if found.problem.shared.items == model.problem.shared.items and not self._driven:
                found = self._onward(found, ONWARD * (found.fit.u - model.fit.u), whitener)
            model = found if self._driven else with_whole_harmonics(found, whitener)
        return self._seen(model, whitener)

    def _seen(self, model: Model, whitener: Whitener) -> Look:
        self._progress("looking at " + (" + ".join(model.effects) or "the known parameters"))
        seen = self._looker.see(model, whitener)
        noise = self._looker.noise(model, seen, whitener)
        whitener = model.problem.whitener(noise)
        model = replace(model, fit=fit_again(model.problem, model.fit, whitener))
        return model, self._looker.scan(model, seen, whitener), whitener, noise

    def _refitted(self, model: Model, whitener: Whitener) -> Model:
        """Fit a model to the end; where that leads far from the rig's inertias, from those, too."""
        found = self._settled(model, whitener)
        other = at_the_rig_s_word(found.problem, found.fit.u)
        if other is None:
            return found
        again = self._settled(_from(*other, found, whitener), whitener)
        return min(found, again, key=lambda m: m.worth)

    def _onward(self, model: Model, stride: Vector, whitener: Whitener) -> Model:
        """Go on the way that fit and rounding in turn have come, to where χ² is least with the rounding of each place.

        A rounding that is taken beside a model suits that model: in turn they move a friction by a hundredth each time,
        from above and from below to where neither moves the other, which is 60 to 700 of χ² above the least.
        """
        held = hold(model.fit.jacobian, len(model.problem.shared.items), whitener)
        gone = [model]
        while len(gone) <= MOST_STRIDES and (len(gone) < 2 or gone[-1].worth < gone[-2].worth - SETTLED):
            gone.append(self._anew(_moved(gone[-1], stride), whitener, held))
        if len(gone) > 2:
            aside = vertex([-1.0, 0.0, 1.0], [each.worth for each in gone[-3:]])
            gone.append(self._anew(_moved(gone[-2], aside * stride), whitener, held))
        return min(gone, key=lambda m: m.worth)

    def _settled(self, model: Model, whitener: Whitener) -> Model:
        """Fit a model, what hangs on it taken anew as long as that helps."""
        model = _from(*out_of_a_wrong_valley(model.problem, model.fit.u, whitener), model, whitener)
        model = _from(*at_better_widths(model.problem, model.fit, whitener, self._refresh), model, whitener)
        found = self._anew(model, whitener)
        before, goes_on = model.worth, not self._driven
        for _ in range(MOST_REFRESHES):
            if before - found.worth < SETTLED:
                break
            before = found.worth
            held = hold(found.fit.jacobian, len(found.problem.shared.items), whitener)
            again = self._anew(found, whitener, held)
            if goes_on and found.worth - again.worth > SETTLED:
                beyond = self._anew(_moved(again, BEYOND * (again.fit.u - found.fit.u)), whitener, held)
                goes_on = beyond.worth < again.worth
                again = min(again, beyond, key=lambda m: m.worth)
            found = min(found, again, key=lambda m: m.worth)
        return found

    def _anew(self, model: Model, whitener: Whitener, held: Held | None = None) -> Model:
        """Refit with what hangs on the model taken anew; without `held` sensitivities with those found there, too.

        What is new in the model is found in each step again: known parameters hang on themselves less.
        """
        problem = self._refresh(model.problem, model.fit.u)
        if held is None:
            new = len(problem.shared.items) - problem.shared.known
            held = hold_beside(model.fit, problem, whitener, new)
        return replace(model, problem=problem, fit=fit(problem, model.fit.u, whitener, held=held, steps=5))

    def _refined(
        self, model: Model, scan: Scan, whitener: Whitener, step: int, *, overlooked: bool = False
    ) -> list[Model]:
        """Refit with each entry that stands out; return the models that gain enough, the best first.

        Behind them come those that gain too little to be named, but may be what the best one stands for.
        `overlooked`: with the best of those that don't stand out instead.
        """
        best = best_of_each(scan)
        needed = self._needed(scan, model)
        order = to_try(scan)
        if overlooked:
            order = [i for i in order if scan.probes[i].effect_id not in model.effects]
        # Where the motion drives, nearly all of a large misfit is of causes that aren't in the catalogue; but the ways
        # begin with what does most once refitted.
        widely = not self._driven or not model.effects
        lists = shortlists(order, scan.scores.gains, needed, overlooked=overlooked, widely=widely)
        lists = with_aliases(lists, order, scan)
        found: list[Model] = []
        lesser: list[Model] = []
        gains: dict[str, float] = {}
        held = hold(model.fit.jacobian, len(model.problem.shared.items), whitener)
        # Where all of the best end at a bound or gain too little, those behind them have their turn.
        for short in lists:
            if found:
                break
            for i in short:
                name = scan.probes[i].effect_id
                self._progress(f"refitting with {name}")
                refit = extend(model, scan.probes[i], scan.scores.amplitudes[i], whitener, held)
                extra = len(refit.problem.shared.items) - len(model.problem.shared.items)
                gain = (model.fit.chi2 - refit.fit.chi2) / self._inflation(name)
                gain -= COST_PER_COLUMN * (extra - 1)
                gains[name] = max(gain, gains.get(name, gain))
                if not refit.newest_at_an_end:
                    (found if gain > needed[i] else lesser).append(refit)
        found.sort(key=lambda m: m.worth)
        if found or not overlooked:
            self._note(scan, best, gains, found, step)
        return found + lesser if found else []

    def _exchange(self, model: Model, rivals: list[Rival], whitener: Whitener) -> tuple[Model, list[Rival]]:
        """Replace each effect but the last by every other that stands out in its place, where that fits better."""
        for place in range(len(model.effects) - 1):
            reduced, scan = self._without(model, place, whitener)
            found = self._refined(reduced, scan, whitener, len(model.effects))
            # The model itself, fitted no further than those that are to take its place.
            level = next((m.worth for m in found if set(m.effects) == set(model.effects)), model.worth)
            model, rivals = self._compared(rivals, found, level, whitener)
        return model, rivals

    def _without(self, model: Model, place: int, whitener: Whitener) -> tuple[Model, Scan]:
        """Return the model refitted without one of its effects, and the catalogue beside that."""
        reduced = without_effect(model, place, whitener)
        return reduced, self._looker.scan(reduced, self._looker.see(reduced, whitener), whitener)

    def _compared(
        self, rivals: list[Rival], others: Iterable[Model], level: float, whitener: Whitener
    ) -> tuple[Model, list[Rival]]:
        """Put others beside the first of rivals, the model; return the best and what can't be told from it.

        `level`: where the model was when it was fitted no further than the others. Those that come near are fitted as
        far as the model is now, beside the same noise and rounding: taken anew, the rounding moves χ² by 20 and more.
        """
        model = rivals[0].model
        known = {frozenset(rival.model.effects) for rival in rivals}
        for other in others:
            if frozenset(other.effects) in known or not self._near(other, model, level):
                continue
            refit = self._as_far(other, model, whitener)
            if refit.worth < model.worth - 1.0:
                model, rivals = self._further_too(model, rivals, whitener)
            behind = refit.worth - model.worth
            if model.at_an_end and not refit.at_an_end:  # it would be refused, were it to join now
                leads, kept = behind <= NEAR_DROP * self._inflation(other.effects[-1]), []
            else:
                leads = behind < -1.0 and (model.at_an_end or not refit.at_an_end)
                kept = [Rival(rival.model, rival.behind - behind) for rival in rivals]
            if leads:
                model, rivals, behind = refit, kept, 0.0
            rivals = [*rivals, Rival(refit, max(behind, 0.0))]
        return model, self._within_reach(rivals)

    def _further_too(self, model: Model, rivals: list[Rival], whitener: Whitener) -> tuple[Model, list[Rival]]:
        """Fit the best of rivals on, before another takes its place: it stood 4 of χ² above where it was going."""
        further = self._as_far(model, model, whitener)
        gained = model.worth - further.worth
        if gained <= 0.0:
            return model, rivals
        return further, [
            Rival(further, 0.0) if rival.model is model else Rival(rival.model, rival.behind + gained)
            for rival in rivals
        ]

    def _as_far(self, other: Model, model: Model, whitener: Whitener) -> Model:
        problem = replace(other.problem, simulate_runs=model.problem.simulate_runs)
        beside, u = in_valley_of(model.problem, model.fit.u, problem, other.fit.u)
        held = hold_nuisances(other.fit, problem, whitener) if beside is problem else None
        return replace(other, problem=beside, fit=fit(beside, u, whitener, held=held, steps=5))

    def _thinned(self, model: Model, rivals: list[Rival], scan: Scan, whitener: Whitener) -> tuple[Model, list[Rival]]:
        """Drop effects that no longer gain enough with the noise as it is known in the end."""
        for place in reversed(range(len(model.effects))):
            needed = scan.scores.threshold * self._inflation(model.effects[place])
            less = without_effect(model, place, whitener, roughly=True)
            if less.fit.chi2 - model.fit.chi2 < CLEARLY * needed:
                less = without_effect(model, place, whitener)
            if less.fit.chi2 - model.fit.chi2 < needed:
                self._candidates = no_longer_named(self._candidates, {model.effects[place]}, "below threshold")
                model, rivals = less, [Rival(less, 0.0)]
        return model, rivals

    def _within_reach(self, rivals: list[Rival]) -> list[Rival]:
        """Return those that can't be told from the best, the best first, each set of effects once."""
        found: dict[frozenset[str], Rival] = {}
        for rival in sorted(rivals, key=lambda rival: rival.behind):
            names = (*rival.model.effects, *rivals[0].model.effects)
            if rival.behind <= SET_DROP * max(self._inflation(name) for name in names):
                found.setdefault(frozenset(rival.model.effects), rival)
        return list(found.values())

    def _needed(self, scan: Scan, model: Model) -> Vector:
        """Return what each place must gain; what numerics leave is of χ² itself, whatever chance gives an entry."""
        accuracy = (ACCURACY_DRIVEN if self._driven else ACCURACY) * (self._first_chi2 - model.fit.chi2)
        own = np.array([accuracy / self._inflation(probe.effect_id) for probe in scan.probes])
        return np.asarray(np.maximum(own, scan.scores.threshold))

    def _inflation(self, name: str) -> float:
        return self._looker.inflation.get(name, 1.0)

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
