"""Compiled kernels made ready before anything is timed, and said so when that means compiling."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from numba.core import event

from hil_forceps.cli.terminal.notes import is_quiet
from hil_forceps.estimation.interface import Sample
from hil_forceps.estimation.registry import ESTIMATOR_IDS, make_estimator
from hil_forceps.rig import Rig

MESSAGE = "Compiling numerical kernels; they are cached, so this happens once ...\n"


class _Announcer(event.Listener):
    """Says so when the first kernel is compiled and not found in the cache."""

    def __init__(self) -> None:
        self._has_said = False

    def on_start(self, event: event.Event) -> None:  # noqa: ARG002
        """Say it once."""
        if not self._has_said:
            self._has_said = True
            if not is_quiet():
                sys.stderr.write(MESSAGE)

    def on_end(self, event: event.Event) -> None:
        """Nothing to say."""


@contextmanager
def telling_when_compiling() -> Iterator[None]:
    """Tell the user on standard error when something inside has to be compiled."""
    with event.install_listener("numba:compile", _Announcer()):
        yield


def ready_kernels(rig: Rig, sample_time_s: float) -> None:
    """Call every kernel of the estimators once; tell the user on standard error when that means compiling."""
    with telling_when_compiling():
        for name in ESTIMATOR_IDS:
            estimator = make_estimator(name, rig, sample_time_s)
            state = estimator.start(Sample(0, 0.0, 0.0))
            estimator.estimate(estimator.step(state, Sample(round(sample_time_s * 1e9), 0.0, 0.0)))
