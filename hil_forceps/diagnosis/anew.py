"""What hangs on a model and is taken anew with a better one: what noise does to it, and the course of each run."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.assemble import Setting
from hil_forceps.diagnosis.course import Course
from hil_forceps.diagnosis.extension import Model, Refresh
from hil_forceps.diagnosis.load_errors import with_dwells
from hil_forceps.diagnosis.predict import ClosedLoop
from hil_forceps.diagnosis.predict_driven import Driven
from hil_forceps.diagnosis.problem import Problem
from hil_forceps.diagnosis.shaking import with_encoder_errors
from hil_forceps.diagnosis.spectrum import JAW, MOTOR
from hil_forceps.rig import Rig

Vector = NDArray[np.float64]


def refresher(rig: Rig) -> Refresh:
    """Return what takes anew with a better model what the encoder's rounding, or the noise of what drives, does."""
    quantum = quantum_of(rig)

    def refresh(problem: Problem, u: Vector) -> Problem:
        loop = problem.simulate_runs
        if isinstance(loop, Driven):
            driven = loop.with_motion_noise(problem.theta(u), problem.nuisances(u), problem.mapper)
            return replace(problem, simulate_runs=driven)
        if quantum <= 0.0 or not isinstance(loop, ClosedLoop):
            return problem
        found = with_encoder_errors(loop, problem.theta(u), problem.nuisances(u), quantum, problem.mapper)
        errors = [dict(zip((MOTOR, JAW), slow.errors_rad, strict=True)) for slow in found.slow]
        return replace(problem, simulate_runs=found, layout=with_dwells(problem.layout, errors))

    return refresh


def quantum_of(rig: Rig) -> float:
    """Return the encoder's step in rad, 0 for an ideal one."""
    return 2.0 * np.pi / rig.encoder.counts_per_rev if rig.encoder.counts_per_rev else 0.0


def courses_of(setting: Setting, model: Model) -> list[Course]:
    """Return what each run went through, without the encoder's shaking and without what is quick in the load."""
    simulator = setting.simulator
    still = simulator.calmed() if isinstance(simulator, ClosedLoop) else simulator
    theta = model.problem.theta(model.fit.u)
    nuisances = model.problem.nuisances(model.fit.u)
    return [still.course(k, theta, nuisance) for k, nuisance in enumerate(nuisances)]
