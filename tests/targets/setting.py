"""How long simulation 2 runs on every target, with what load, and from when it is judged; what of the suite is run.

HIL_FORCEPS_TARGETS_FULL=1: the 20 s of the paper, for figures to publish, and every requirement everywhere. Else 3 s
with one pulse of the same load: the same start from rest, zero, both edges and the same torque, so what a firmware gets
wrong shows as well; and on an emulated machine the suite leaves out what takes minutes there. The same firmware has to
bear that as a process, in both cases.
"""

import os
from typing import Final, NamedTuple

import numpy as np
import pytest

from firmware_protocol.conformance.catalogue import REQUIREMENTS, name_of
from hil_forceps.bench.execute import Executed
from virtual_bus.plant.load import PAPER_TORQUE_N_M, LoadProfile, paper_load, piecewise_linear

FULL: Final = os.environ.get("HIL_FORCEPS_TARGETS_FULL") == "1"

TORQUE_FREE_RUNS: Final = 200 if FULL else 20
LONG: Final = frozenset() if FULL else frozenset((86,))  # a flood of 65536 frames


def without_long() -> list[str]:
    """Return the options of the suite that leave out what takes minutes on an emulated machine."""
    if not LONG:
        return []
    return [word for number in REQUIREMENTS if number not in LONG for word in ("--only", name_of(number))]


class Setting(NamedTuple):
    """How long a run is, what it is loaded with, and from when it is judged."""

    duration_s: float
    load: LoadProfile
    judged_from_s: float


def setting() -> Setting:
    """Return the setting that this run of the tests has."""
    if FULL:
        return Setting(20.0, paper_load(2), 9.0)
    torque_N_m = [0.0, PAPER_TORQUE_N_M, PAPER_TORQUE_N_M, 0.0]
    return Setting(3.0, piecewise_linear([1.0, 1.0, 2.0, 2.0], torque_N_m), 0.9)


def rmse_N_m(executed: Executed) -> float:
    """Return the error of the estimated torque; AssertionError when the run was not long enough, or not under load."""
    traces = executed.traces
    error = (traces.tau_w_est - traces.tau_w_true)[traces.time_s >= setting().judged_from_s]
    assert error.size > 1000, f"{error.size} samples to judge"
    assert np.abs(traces.tau_w_true).max() == pytest.approx(PAPER_TORQUE_N_M, abs=1e-7)
    return float(np.sqrt(np.mean(np.square(error))))
