"""Runs as the search takes them, with what is known of their sensors' zeros."""

from collections.abc import Sequence

import numpy as np

from hil_forceps.diagnosis.driven.passed import DrivenRun
from hil_forceps.diagnosis.driven.rows import DrivenRows
from hil_forceps.diagnosis.driven.simulation import driven_models
from hil_forceps.diagnosis.driven.whitening import white

ZERO_SHARE = 0.02  # of the jaw's range: zero of its sensor from run to run
LEAST_ZERO_RAD = 2e-3
OFFSET_SHARE = 0.1  # of the torque or current seen: zero of its sensor from run to run


def driven_runs(rows: Sequence[DrivenRows]) -> list[DrivenRun]:
    """Return runs as the search takes them; what they leave is taken for white until a model has been fitted."""
    seen = max(float(np.sqrt(np.mean(run.rows.channels[run.torque_channel] ** 2))) for run in rows)
    angles = [run.rows.channels["theta_j_rad"] for run in rows if "theta_j_rad" in run.rows.channels]
    zero = max([LEAST_ZERO_RAD, *(ZERO_SHARE * float(np.ptp(angle)) for angle in angles)])
    zeros = {"theta_j_rad": zero, "current_A": OFFSET_SHARE * seen, "tau_m_N_m": OFFSET_SHARE * seen}
    found = []
    for model in driven_models(rows):
        channels = model.rows.rows.channels
        first = {name: white(max(model.rows.noise[name], 1e-3 * float(np.ptp(v)))) for name, v in channels.items()}
        nothing = {name: np.zeros(values.size) for name, values in channels.items()}
        found.append(DrivenRun(model, {name: zeros[name] for name in channels}, first, nothing))
    return found
