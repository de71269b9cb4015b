"""A drive with coarse counts whose encoder is recorded late or early: the currents tell what it counted."""

import numpy as np
import pytest

from hil_forceps.diagnosis.evidence import pass_all
from hil_forceps.diagnosis.state_space.layout import CURRENT, JAW
from hil_forceps.diagnosis.state_space.passes import Passed
from hil_forceps.model import parameters
from hil_forceps.rig import Rig
from tests.hidden_effects.generator import RIG, true_rig
from tests.unit.diagnosis.simulated_runs import POOL, records_of, runs_of

LAWS = {
    "P": {"drive.ki_A_per_rad_s": 0.0, "drive.kd_A_s_per_rad": 0.0},
    "PD": {"drive.ki_A_per_rad_s": 0.0, "drive.kp_A_per_rad": 0.8, "drive.kd_A_s_per_rad": 0.009},
}


def _skewed(law: str, skew_s: float) -> Rig:
    rig = RIG.with_changes({**LAWS[law], "encoder.counts_per_rev": 2048})
    return true_rig(rig, {"channel_skew": {"theta_m_s": skew_s}}, {})


def _passed(rig: Rig, seed: int) -> list[Passed]:
    records = records_of(runs_of(rig, ("hold", "multisine_mid"), seed), rig)
    return [run for run in pass_all(records, parameters.vector(rig), POOL.map).runs if isinstance(run, Passed)]


@pytest.mark.parametrize(("law", "skew_s"), [("P", 9e-5), ("PD", -4.5e-5), ("PD", 1.4e-3)])
def test_innovations_are_white_though_no_row_shows_what_the_drive_counted(law: str, skew_s: float) -> None:
    for passed in _passed(_skewed(law, skew_s), 10244):
        for channel in (JAW, CURRENT):
            counts, innovations = passed.counts[:, channel], passed.residual[:, channel]
            assert counts.sum() > (500 if channel == CURRENT else 1000)
            assert float(np.mean(innovations[counts] ** 2)) < 1.15
            assert abs(float(np.mean(innovations[counts]))) < 4.0 / np.sqrt(counts.sum())


def test_taken_for_what_the_drive_counted_such_rows_are_wrong_by_whole_counts() -> None:
    """The runs above are hard: without the skew, currents are further off than any noise."""
    true, without = _skewed("PD", -4.5e-5), _skewed("PD", 0.0)
    for record in records_of(runs_of(true, ("multisine_mid",), 10245), true):
        passed = pass_all([record], parameters.vector(without), POOL.map).runs[0]
        counts = passed.counts[:, CURRENT]
        assert float(np.mean(passed.residual[counts, CURRENT] ** 2)) > 2.0
