"""Score all families of curves at once beside a model: what no entry explains still varies over something."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.course import Course
from hil_forceps.diagnosis.hypotheses.places import Place
from hil_forceps.diagnosis.hypotheses.score_test import Prior, score_test
from hil_forceps.diagnosis.inference.fit import Fit, directions_of
from hil_forceps.diagnosis.leftover import Curve, Scale, all_curves, scale_of
from hil_forceps.diagnosis.state_space.advance import regimes
from hil_forceps.diagnosis.state_space.forcing_pass import COLUMNS_AT_ONCE, forced
from hil_forceps.diagnosis.state_space.layout import (
    CHANNELS,
    CURRENT,
    ENCODER,
    JAW,
    LOAD,
    OMEGA_J,
    OMEGA_M,
    PREDICTED_CURRENT,
    PREDICTED_OMEGA_J,
    PREDICTED_OMEGA_M,
    PREDICTED_THETA_J,
    PREDICTED_THETA_M,
    THETA_J,
    THETA_M,
)
from hil_forceps.diagnosis.state_space.passes import Gram, Mapper, Passed, gram_of, total
from hil_forceps.diagnosis.state_space.response_pass import response_run
from hil_forceps.model.physics import Physics

Vector = NDArray[np.float64]

# Of these families some members look a row ahead, into the innovations that are tested.
_AHEAD = {("wire", "rate of stretch"), ("theta_j_rad", "rate")}
_BEHIND = (
    Curve("wire", "rate of stretch", lambda c, _: [np.diff(c.stretch_m, prepend=c.stretch_m[0])]),
    Curve("theta_j_rad", "rate", lambda c, _: [c.omega_j, np.diff(c.omega_j, prepend=c.omega_j[0])]),
)
_STATES = {("theta_j_rad", "constant")}  # the zero of the jaw sensor is a state of the filter
CURVES = (*(curve for curve in all_curves() if (curve.place, curve.variable) not in _AHEAD | _STATES), *_BEHIND)
_CHANNEL = {"theta_m_rad": ENCODER, "theta_j_rad": JAW, "current_A": CURRENT}


class LackOfFit(NamedTuple):
    """What the curves found."""

    gain: float  # of the best family: fall of χ² beyond the cost of its curves
    threshold: float
    families: tuple[tuple[str, str, float], ...]  # place, variable, gain; the best first

    @property
    def significant(self) -> bool:
        """Whether more is left than chance leaves."""
        return self.gain > self.threshold


def course_of(run: Passed, p: Physics, *, before: bool) -> Course:
    """Return what happened in a run, by the filter: what was known up to each row, or `before` its measurements.

    What acts behind a row may hang on its measurements; an error of its sensors may not, for they hold its innovation.
    """
    c = run.filtered.course
    angles = (PREDICTED_THETA_M, PREDICTED_OMEGA_M, PREDICTED_THETA_J, PREDICTED_OMEGA_J)
    theta_m, omega_m, theta_j, omega_j = (c[:, i] for i in (angles if before else (THETA_M, OMEGA_M, THETA_J, OMEGA_J)))
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
        time_s=run.series.begin_s + np.arange(c.shape[0], dtype=np.float64) * run.series.period_s,
        period_s=run.series.period_s,
    )


def omnibus_test(found: Fit, mapper: Mapper, seed: int, prior: Prior | None = None) -> LackOfFit:
    """Test what a model leaves in runs.

    `prior`: what is known of its parameters; by default what they were fitted with.
    """
    p = found.passes.plants.sliding
    courses = [course_of(run, p, before=False) for run in found.passes.runs]
    scale = scale_of(courses)
    directions = directions_of(found.free, found.passes.theta)
    plants = [(regimes(d.theta), d.per) for d in directions]
    curves = curves_for(found.passes.runs)
    places = _families(curves, courses[0], scale)
    count = places[-1].stop

    def one(item: tuple[Passed, Course]) -> Gram:
        run, course = item
        columns = np.empty((run.residual.size, len(plants) + count), dtype=np.float32)
        for at, (plant, per) in enumerate(plants):
            columns[:, at] = response_run(plant, p, run.series, run.filtered, per).ravel()
        at = len(plants)
        for answers in _answers(curves, p, run, course, scale):
            columns[:, at : at + answers.shape[2]] = answers.reshape(columns.shape[0], -1)
            at += answers.shape[2]
        influence = run.influence.ravel()
        columns *= influence[:, np.newaxis].astype(np.float32)
        return gram_of(columns, influence * run.residual.ravel())

    summed = total(list(mapper(one, list(zip(found.passes.runs, courses, strict=True)))))
    tested = score_test(summed, prior or Prior.of(found.free, found.passes.theta), places, seed)
    order = np.argsort(-tested.gains)
    families = tuple((*places[i].effect_id.split("\n"), float(tested.gains[i])) for i in order)
    return LackOfFit(float(tested.gains[order[0]]), tested.threshold, families)


def curves_for(runs: Sequence[Passed]) -> tuple[Curve, ...]:
    """Return the families for some runs: without a load cell, a torque on the jaw is a load as any."""
    measured = any(bool(np.isfinite(run.series.load_N_m).any()) for run in runs)
    return CURVES if measured else tuple(curve for curve in CURVES if curve.place != "jaw")


def _families(curves: Sequence[Curve], course: Course, scale: Scale) -> list[Place]:
    places, at = [], 0
    for curve in curves:
        count = len(curve.members(course, scale))
        places.append(Place(f"{curve.place}\n{curve.variable}", {}, {}, at, at + count, False))
        at += count
    return places


def _answers(
    curves: Sequence[Curve], p: Physics, run: Passed, course: Course, scale: Scale
) -> Iterator[NDArray[np.float64]]:
    """Yield the answers (n × CHANNELS × m) to all curves of all families, some at a time to spare memory."""
    shows = course_of(run, p, before=True)
    members = [
        (curve.place, member)
        for curve in curves
        for member in curve.members(shows if curve.place in _CHANNEL else course, scale)
    ]
    n = course.time_s.size
    for first in range(0, len(members), COLUMNS_AT_ONCE):
        some = members[first : first + COLUMNS_AT_ONCE]
        motor, jaw = np.zeros((n, len(some))), np.zeros((n, len(some)))
        shown = np.zeros((n, CHANNELS, len(some)))
        for at, (place, member) in enumerate(some):
            unit = member / max(float(np.abs(member).max()), 1e-300)
            if place == "motor":
                motor[:, at] = unit
            elif place == "jaw":
                jaw[:, at] = unit
            elif place == "wire":
                motor[:, at], jaw[:, at] = -p.r_m * unit, p.r_j * unit
            else:
                shown[:, _CHANNEL[str(place)], at] = unit
        yield forced(p, run.series, run.filtered, motor, jaw, shown)
