"""Compile kernels before anything is timed, with a note to the user if they have to be compiled."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from numba.core import event

from hil_forceps.cli.terminal.notes import is_quiet
from hil_forceps.estimation.interface import Sample
from hil_forceps.estimation.registry import ESTIMATOR_IDS, make_estimator
from hil_forceps.kernels.library import COMPILING
from hil_forceps.rig import Rig

MESSAGE = "Compiling numerical kernels; they are cached, so this happens once ...\n"


class _Announcer(event.Listener):
    """Writes the message when the first kernel is compiled, not loaded from the cache."""

    def __init__(self) -> None:
        self._has_said = False

    def on_start(self, event: event.Event) -> None:  # noqa: ARG002
        """Write the message once."""
        if not self._has_said:
            self._has_said = True
            if not is_quiet():
                sys.stderr.write(MESSAGE)

    def on_end(self, event: event.Event) -> None:
        """Do nothing."""


@contextmanager
def telling_when_compiling() -> Iterator[None]:
    """Write a message to standard error if a kernel has to be compiled within the block."""
    announcer = _Announcer()
    with event.install_listener("numba:compile", announcer), event.install_listener(COMPILING, announcer):
        yield


def ready_kernels(rig: Rig, sample_time_s: float) -> None:
    """Call every kernel of the estimators once; write a message to standard error if one has to be compiled."""
    with telling_when_compiling():
        for name in ESTIMATOR_IDS:
            estimator = make_estimator(name, rig, sample_time_s)
            state = estimator.start(Sample(0, 0.0, 0.0))
            estimator.estimate(estimator.step(state, Sample(round(sample_time_s * 1e9), 0.0, 0.0)))
