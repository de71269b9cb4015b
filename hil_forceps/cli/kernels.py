"""Compiled kernels made ready before anything is timed, and said so when it takes a while."""

import sys
import threading

from hil_forceps.estimation.interface import Sample
from hil_forceps.estimation.registry import ESTIMATOR_IDS, make_estimator
from hil_forceps.rig import Rig

PATIENCE_S = 0.7
MESSAGE = "Compiling numerical kernels; they are cached, so this happens once ...\n"


def ready_kernels(rig: Rig, sample_time_s: float) -> None:
    """Call every kernel of the estimators once; tell the user on standard error when that means compiling."""
    timer = threading.Timer(PATIENCE_S, sys.stderr.write, (MESSAGE,))
    timer.start()
    try:
        for name in ESTIMATOR_IDS:
            estimator = make_estimator(name, rig, sample_time_s)
            state = estimator.start(Sample(0, 0.0, 0.0))
            estimator.estimate(estimator.step(state, Sample(round(sample_time_s * 1e9), 0.0, 0.0)))
    finally:
        timer.cancel()
