"""Models beside driven runs; only the zeros of their sensors are fitted to them."""

from collections.abc import Sequence

import numpy as np

from hil_forceps.diagnosis.driven.passed import DrivenPassed, DrivenRun
from hil_forceps.diagnosis.evidence import Mapper, pass_all
from hil_forceps.diagnosis.validation.heldout import Played
from hil_forceps.model.parameters import Vector


def play(runs: Sequence[DrivenRun], theta: Vector, mapper: Mapper) -> Played:
    """Simulate runs with a vector of parameters."""
    adapted = list(mapper(lambda run: run.adapted(theta, run.white), runs))
    passes = pass_all(adapted, theta, mapper)
    courses = [passed.course(passes.plant, before=False) for passed in passes.runs]
    return Played([_channels(passed) for passed in passes.runs], courses)


def _channels(passed: DrivenPassed) -> dict[str, Vector]:
    rows = passed.run.rows
    said = {name: values - passed.raw[name] + passed.zeros[name] for name, values in rows.channels.items()}
    span = {name: max(float(np.ptp(values)), 1e-12) for name, values in rows.channels.items()}
    # A simulation that goes further has left the run.
    kept = {name: np.nan_to_num(said[name], nan=10.0 * span[name], posinf=10.0 * span[name]) for name in said}
    return {"theta_m_rad": rows.reference_rad, **kept}
