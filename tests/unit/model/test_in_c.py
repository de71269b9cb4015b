"""The rollout in C that speed is measured against: the same numbers, so that it is the same work."""

from pathlib import Path

import numpy as np
import pytest

from hil_forceps.model import closed_loop
from tests.bench.test_rollout import CASES, LAW, SUBSTEPS, built, in_c, inputs_of, theta_of


@pytest.mark.parametrize("name", CASES)
def test_the_rollout_in_c_gives_the_same_numbers(name: str, tmp_path: Path) -> None:
    theta, inputs = theta_of(CASES[name]), inputs_of()
    ours = closed_loop.simulate(theta, LAW, 0.0, inputs, closed_loop.rest(theta, 0.6), SUBSTEPS)
    call, theirs = in_c(built(tmp_path), theta, inputs)
    call()
    for column, channel in zip(theirs, ours, strict=True):
        assert np.abs(column - channel).max() <= 1e-7 * np.abs(channel).max()
