"""Score all families of curves at once beside a model: what no entry explains still varies over something."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from hil_forceps.diagnosis.course import Course
from hil_forceps.diagnosis.evidence import Columns, Direction, Gram, Mapper, Passed, gram_of, product, total
from hil_forceps.diagnosis.hypotheses.places import Place
from hil_forceps.diagnosis.hypotheses.score_test import COST_PER_COLUMN, Prior, Tested, score_test
from hil_forceps.diagnosis.inference.dispersion import Scatter, Weigh, scatter, total_scatter
from hil_forceps.diagnosis.inference.fit import Fit, directions_of
from hil_forceps.diagnosis.lack_of_fit.curves import Curve, Scale, all_curves, scale_of
from hil_forceps.model.composition import Physics

Vector = NDArray[np.float64]

SENSORS = frozenset({"theta_m_rad", "theta_j_rad", "current_A"})


class Family(NamedTuple):
    """A family of curves, as tested."""

    place: str
    variable: str
    gain: float  # fall of χ² beyond the cost of its curves, weighed where asked
    curves: int  # that the fitted parameters don't do as well

    @property
    def cost(self) -> float:
        """What chance gains with more than one curve, and is not in the gain."""
        return COST_PER_COLUMN * max(0, self.curves - 1)

    def calibrated(self, replicates: Sequence["Family"]) -> "Family":
        """Return it with the gain that is as unlikely under a central χ² as this one is among replicates.

        Their gains are taken for a noncentral χ² with a degree of freedom for each curve; the mean tells noncentrality.
        """
        chi2, mean = self.gain + self.cost, float(np.mean([each.gain + each.cost for each in replicates]))
        p_value = float(stats.ncx2.sf(chi2, self.curves, mean - self.curves)) if mean > self.curves > 0 else 0.0
        if p_value == 0.0:  # replicates gain no more than chance does, or next to nothing beside this
            return self
        return self._replace(gain=float(stats.chi2.isf(p_value, self.curves)) - self.cost)


class LackOfFit(NamedTuple):
    """What the curves found."""

    threshold: float
    families: tuple[Family, ...]  # the best first

    @property
    def gain(self) -> float:
        """Gain of the best family."""
        return self.families[0].gain

    @property
    def significant(self) -> bool:
        """Whether more is left than chance leaves."""
        return self.gain > self.threshold

    def calibrated(self, replicates: Sequence["LackOfFit"]) -> "LackOfFit":
        """Return it calibrated by the same test of replicates, family by family."""
        simulated = [{(f.place, f.variable): f for f in each.families} for each in replicates]
        families = [f.calibrated([each[f.place, f.variable] for each in simulated]) for f in self.families]
        return self._replace(families=_in_order(families))


def _in_order(families: Sequence[Family]) -> tuple[Family, ...]:
    """Return families, the best first."""
    return tuple(sorted(families, key=lambda family: -family.gain))


def omnibus_test(found: Fit, mapper: Mapper, seed: int, weigh: Weigh | None, prior: Prior | None = None) -> LackOfFit:
    """Test what a model leaves in runs.

    `weigh`: what a gain is worth; None: as the likelihood has it. `prior`: what is known of the parameters; by default
    what they were fitted with.
    """
    base, runs = found.passes.plant, found.passes.runs
    courses = [run.course(base, before=False) for run in runs]
    scale = scale_of(courses)
    tests = _Tests(base, directions_of(found.free, found.passes.theta), curves_for(runs), scale)
    places = _families(tests.curves, courses[0], scale)
    every = list(zip(runs, courses, strict=True))
    summed = total(list(mapper(tests.gram, every)))
    tested = score_test(summed, prior or Prior.of(found.free, found.passes.theta), places, seed)
    gains = tested.gains if weigh is None else _weighed(tested, places, tests, every, weigh, mapper)
    good = np.diag(tested.information) > 0.0
    counts = [int(np.count_nonzero(good[place.first : place.stop])) for place in places]
    families = [
        Family(curve.place, curve.variable, gain, count)
        for curve, gain, count in zip(tests.curves, gains.tolist(), counts, strict=True)
    ]
    return LackOfFit(tested.threshold, _in_order(families))


class _Tests(NamedTuple):
    """What is tested: the directions of the fitted parameters and behind them the curves."""

    base: Physics
    directions: Sequence[Direction]
    curves: Sequence[Curve]
    scale: Scale

    def columns(self, run: Passed, course: Course) -> tuple[Columns, Columns]:
        """Return the answers of a run's residuals to both (n·m × columns each)."""
        shows = run.course(self.base, before=True)
        members = [
            (curve.place, member / max(float(np.abs(member).max()), 1e-300))
            for curve in self.curves
            for member in curve.members(shows if curve.place in SENSORS else course, self.scale)
        ]
        return run.answers(self.base, self.directions), run.curves(self.base, members)

    def gram(self, item: tuple[Passed, Course]) -> Gram:
        """Return their Gram matrix of a run."""
        run, course = item
        return gram_of(self.columns(run, course), (run.influence * run.residual).ravel())


def _weighed(
    tested: Tested,
    places: Sequence[Place],
    tests: _Tests,
    every: Sequence[tuple[Passed, Course]],
    weigh: Weigh,
    mapper: Mapper,
) -> Vector:
    """Return the gains, those beyond the threshold by how their scores scatter."""
    gains, fitted = tested.gains.copy(), len(tests.directions)
    beyond = np.flatnonzero(gains > tested.threshold)
    if not beyond.size:
        return gains
    sizes = np.zeros((fitted + places[-1].stop, beyond.size))
    for at, family in enumerate(beyond.tolist()):
        place = places[family]
        sizes[:fitted, at] = tested.shifts[family] - tested.shift
        sizes[fitted + place.first : fitted + place.stop, at] = tested.sizes[family]

    def scattered(item: tuple[Passed, Course]) -> list[Scatter]:
        run, shape = item[0], item[0].residual.shape
        both = tests.columns(*item)
        before = run.influence * run.residual + product(both[:1], tested.shift[:, np.newaxis]).reshape(shape)
        changes = [change.reshape(shape) for change in product(both, sizes).T]
        return [scatter(change, before + change, run.block_rows) for change in changes]

    by_run = list(mapper(scattered, every))
    for at, family in enumerate(beyond.tolist()):
        gains[family] = weigh(float(gains[family]), total_scatter([run[at] for run in by_run]))
    return gains


def curves_for(runs: Sequence[Passed]) -> tuple[Curve, ...]:
    """Return the families for some runs: without a load cell, a torque on the jaw is a load as any."""
    measured = any(run.load_measured for run in runs)
    return tuple(curve for curve in all_curves() if measured or curve.place != "jaw")


def _families(curves: Sequence[Curve], course: Course, scale: Scale) -> list[Place]:
    places, at = [], 0
    for curve in curves:
        count = len(curve.members(course, scale))
        places.append(Place(curve.variable, {}, {}, at, at + count, False))
        at += count
    return places
