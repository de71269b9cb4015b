"""The one call: runs and a rig in, a whole diagnosis out, and the rig with what was found in it."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hil_forceps.audit.audit import audit
from hil_forceps.audit.finding import Finding
from hil_forceps.control.trajectories import Trajectory
from hil_forceps.data.run import ANGLE_FROM_SPEED, Run
from hil_forceps.diagnosis.driven.conclusion import conclude_driven
from hil_forceps.diagnosis.options import Options
from hil_forceps.diagnosis.result import Diagnosis
from hil_forceps.diagnosis.validation.conclusion import conclude as by_filter
from hil_forceps.diagnosis.validation.conclusion import even_runs
from hil_forceps.rig import Rig
from hil_forceps.rig.catalogue import EFFECTS

FEWEST_QUANTA = 20  # an angle that moves over fewer counts has not moved


class Conclusion(NamedTuple):
    """A diagnosis, the rig as extended by it, and the motion of the experiment to make next."""

    diagnosis: Diagnosis
    extended: Rig
    trajectory: Trajectory | None = None  # of the next experiment


def diagnose(runs: Sequence[Run], rig: Rig, options: Options) -> Conclusion:
    """Diagnose runs; UserError when they can't be used at all, verdict `undetermined` when they say nothing."""
    findings = audit(runs, rig)
    if reasons := silent(runs, rig):
        return _undetermined(f"No verdict is possible: {reasons[0]}.", reasons, findings, rig)
    # Units, signs or a rig that can't be right look like marvellous effects, and the fit may not even end.
    if wrong := [finding.text for finding in findings if finding.severity == "problem"]:
        said = "No verdict is possible: the audit found errors in the data."
        return _undetermined(said, tuple(dict.fromkeys(wrong)), findings, rig)
    if any(ANGLE_FROM_SPEED in run.notes for run in runs):
        by_angle = sorted(effect.id for effect in EFFECTS if effect.by_angle)
        options = replace(options, without=options.without | frozenset(by_angle))
        left_out = f"the angle's zero differs from run to run; left out are the effects {', '.join(by_angle)}"
        findings.append(Finding("angle", "note", "", "theta_m_rad", left_out))
    even = even_runs(runs, rig)
    if even is not None:
        return Conclusion(*by_filter(even, rig, findings, options))
    return Conclusion(*conclude_driven(runs, rig, findings, options))


def _undetermined(said: str, reasons: tuple[str, ...], findings: Sequence[Finding], rig: Rig) -> Conclusion:
    return Conclusion(Diagnosis("undetermined", said, data_audit=tuple(findings), reasons=reasons), rig)


def silent(runs: Sequence[Run], rig: Rig) -> tuple[str, ...]:
    """Return why runs can't show anything; empty when they can."""
    reasons = []
    quantum = 2.0 * np.pi / rig.encoder.counts_per_rev if rig.encoder.counts_per_rev else 1e-6
    if all(float(np.ptp(run.columns["theta_m_rad"])) < FEWEST_QUANTA * quantum for run in runs):
        reasons.append("the motor does not move in any run; move the jaw over its range, both ways, at several speeds")
    if not any("theta_j_rad" in run.columns or "tau_w_N_m" in run.columns for run in runs):
        reasons.append(
            "neither the jaw's angle nor its load was measured, so any torque at the motor may be load; "
            "measure one of them, or leave the jaw free and set tau_w_N_m to 0"
        )
    if not all({"current_A", "tau_m_N_m"} & set(run.columns) for run in runs):
        reasons.append("some runs have neither the current nor the motor's torque; record one of them in every run")
    elif even_runs(runs, rig) is None and len({"tau_m_N_m" in run.columns for run in runs}) > 1:
        reasons.append("some runs have the motor's torque and others the current; use runs with the same channel")
    return tuple(reasons)
