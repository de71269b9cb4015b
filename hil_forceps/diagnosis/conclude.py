"""The one call: runs and a rig in, a whole diagnosis out, and the rig with what was found in it."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.control.trajectories import Trajectory
from hil_forceps.diagnosis.anew import quantum_of
from hil_forceps.diagnosis.audit import audit
from hil_forceps.diagnosis.diagnose import Findings, Options, investigate
from hil_forceps.diagnosis.estimates import estimate_gains
from hil_forceps.diagnosis.experiment import mode_of
from hil_forceps.diagnosis.gauge import with_scale
from hil_forceps.diagnosis.heldout import Played, evidence, floors_of, gains, no_more_than_left, play, play_fitted
from hil_forceps.diagnosis.judge import audit_findings, balances, detectable, judge, parameter_shifts, trends
from hil_forceps.diagnosis.ladder import ladder
from hil_forceps.diagnosis.next_experiment import propose
from hil_forceps.diagnosis.result import Detectable, Diagnosis, Gain, Rung
from hil_forceps.diagnosis.strokes import floors_with_strokes, repetition
from hil_forceps.diagnosis.validation.conclusion import conclude as by_filter
from hil_forceps.diagnosis.validation.conclusion import even_runs
from hil_forceps.model import parameters
from hil_forceps.rig import Rig
from hil_forceps.runs.table import Run

Vector = NDArray[np.float64]

FEWEST_QUANTA = 20  # an angle that moves over fewer counts has not moved


class Conclusion(NamedTuple):
    """A diagnosis, the rig as extended by it, and the motion of the experiment to make next."""

    diagnosis: Diagnosis
    extended: Rig
    trajectory: Trajectory | None = None  # of the next experiment


def diagnose(runs: Sequence[Run], rig: Rig, options: Options) -> Conclusion:
    """Diagnose runs; UserError when they can't be used at all, verdict `undetermined` when they say nothing."""
    findings = audit(runs, rig)
    told = tuple(finding.told() for finding in findings)
    if reasons := silent(runs, rig):
        said = "These data cannot tell: " + reasons[0] + "."
        return Conclusion(Diagnosis("undetermined", said, data_audit=told, reasons=reasons), rig)
    # Units, signs or a rig that can't be right look like marvellous effects, and the fit may not even end.
    if wrong := [finding.text for finding in findings if finding.severity == "problem"]:
        said = "These data cannot tell: they can't be right as they are."
        return Conclusion(Diagnosis("undetermined", said, data_audit=told, reasons=tuple(dict.fromkeys(wrong))), rig)
    even = even_runs(runs, rig)
    if even is not None:
        return Conclusion(*by_filter(even, rig, told, options))
    found = investigate(runs, rig, options)
    return _conclude(found, options)


def silent(runs: Sequence[Run], rig: Rig) -> tuple[str, ...]:
    """Return why runs can't show anything; empty when they can."""
    reasons = []
    quantum = 2.0 * np.pi / rig.encoder.counts_per_rev if rig.encoder.counts_per_rev else 1e-6
    if all(float(np.ptp(run.columns["theta_m_rad"])) < FEWEST_QUANTA * quantum for run in runs):
        reasons.append("the motor does not move in any run; move the jaw over its range, both ways, at several speeds")
    if not any("theta_j_rad" in run.columns or "tau_w_N_m" in run.columns for run in runs):
        reasons.append(
            "neither the jaw's angle nor its load was measured, so whatever is seen at the motor may be load; "
            "measure one of them, or leave the jaw free and give tau_w_N_m as 0"
        )
    if not all({"current_A", "tau_m_N_m"} & set(run.columns) for run in runs):
        reasons.append("neither the current nor the motor's torque was measured in every run; record one of them")
    elif mode_of(runs, rig) == "driven" and len({"tau_m_N_m" in run.columns for run in runs}) > 1:
        reasons.append("some runs have the motor's torque and others the current; give runs of one kind")
    return tuple(reasons)


def _conclude(found: Findings, options: Options) -> Conclusion:
    least = detectable(found)
    options.progress("playing the models beside the runs, looking for the next experiment")
    # One core plays while the others look for the next experiment; a ladder shares out its own runs.
    mapper = map if found.records[0].mode == "driven" else options.mapper
    told = mapper(lambda _: _told(found, least, options), (None,))
    proposal = propose(found, least)
    diagnosis, extended = next(iter(told))
    if proposal is None:
        return Conclusion(diagnosis, extended)
    return Conclusion(replace(diagnosis, next_experiment=proposal.result), extended, proposal.trajectory)


def _told(found: Findings, least: dict[str, Detectable], options: Options) -> tuple[Diagnosis, Rig]:
    """Return the diagnosis but for the next experiment, and the rig as extended by it."""
    verdict, rig = judge(found), found.rig
    model, baseline = found.choice.model, found.baseline
    theta_before = baseline.problem.theta(baseline.fit.u)
    theta_after = theta_before if verdict.verdict != "effects" else model.problem.theta(model.fit.u)
    theta_nominal = parameters.vector(rig)
    layout = model.problem.layout
    unexplained = floors_of(found.choice.noise, layout, found.setting.simulator.integral_per_s)
    if found.records[0].mode == "driven":
        unexplained = no_more_than_left(unexplained, model)
    floors, repeated = floors_with_strokes((*found.records, *found.held_out), unexplained)
    held_floors, _ = floors_with_strokes(found.held_out, unexplained)
    named = [effect.id for effect in verdict.effects]
    extended = parameters.rig_with(rig, theta_after if verdict.verdict != "consistent" else theta_nominal, named)
    refitted = parameters.rig_with(rig, theta_before, ())
    gain = {}
    runs = []
    models = (found.nominal, baseline, model if verdict.verdict == "effects" else baseline)
    for records, held, played in (
        (found.records, False, [play_fitted(each) for each in models]),
        (found.held_out, True, _play_unseen(found, (theta_nominal, theta_before, theta_after), options)),
    ):
        if not records:
            continue
        estimated: list[dict[str, Vector]] = [{} for _ in records]
        estimate_gain: dict[str, Gain] = {}
        if records[0].mode == "closed_loop":  # else no current goes with every angle
            rigs = (refitted, extended if named else refitted)
            estimated, estimate_gain = estimate_gains(records, rigs, played[2].channels, floors, options.seed)
        runs += evidence(records, held, played[0], played[1], played[2], estimated)
        if held:
            gain = gains(records, played[1], played[2], held_floors, options.seed) | estimate_gain
    shifts = verdict.shifts
    rungs: tuple[Rung, ...] = ()
    scale: tuple[str, ...] = ()
    if found.records[0].mode == "driven":
        options.progress("climbing the ladder")
        if verdict.verdict == "unnamed":  # what the extended rig holds, then
            shifts = parameter_shifts(baseline)
        shifts, scale = with_scale(shifts, rig)
        there = held_floors if found.held_out else floors
        rungs = ladder(found.held_out or found.records, rig, found, options.mapper, there)
    diagnosis = Diagnosis(
        verdict.verdict,
        verdict.sentence,
        verdict.effects,
        verdict.sets,
        shifts,
        gain,
        tuple(record.name for record in found.held_out),
        (*audit_findings(found), *map(repetition, repeated)),
        least,
        None,
        verdict.varies_over,
        (*verdict.reasons, *scale),
        found.choice.candidates,
        balances(found.before, found.after),
        trends(tuple(floors), found.before, found.after),
        floors,
        tuple(runs),
        rungs,
    )
    options.to_draw(diagnosis)
    return diagnosis, extended


def _play_unseen(found: Findings, thetas: tuple[Vector, Vector, Vector], options: Options) -> list[Played]:
    """Play models beside the runs held out, the last only once where it is the one before."""
    if not found.held_out:
        return []
    quantum = quantum_of(found.rig)
    which = thetas if thetas[2] is not thetas[1] else thetas[:2]
    played = list(options.mapper(lambda theta: play(found.held_out, found.rig, theta, quantum, map), which))
    return [played[0], played[1], played[-1]]
