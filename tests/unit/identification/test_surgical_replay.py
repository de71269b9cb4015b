"""The real instrument's data, cut small: signs, and that the estimates are as poor as the documentation says.

The data are others' and not part of this repository; they are looked for at $HIL_FORCEPS_DATA, then beside the
repository in `../shared/data`.
"""

import os
import zipfile
from pathlib import Path

import numpy as np
import pytest

from hil_forceps.data.readers.surgical_tool.reader import read_surgical_tool
from hil_forceps.identification.instrument.evaluation import replay_instrument
from hil_forceps.identification.instrument.report import WHOLE
from hil_forceps.rig import load_rig

ROOT = Path(__file__).parents[3]
DATA = Path(os.environ.get("HIL_FORCEPS_DATA", ROOT.parent / "shared" / "data")) / "surgical_tool"
SETS = {"left": "Tool_4_Maryland_L_4", "right": "Tool_4_Maryland_R_5"}
MEMBERS = ("20.TXT", "23.TXT", "42.TXT")
KEPT_LINES = 8000  # of 20,000: two periods and more at 0.3 Hz

pytestmark = [
    pytest.mark.shared_data,
    pytest.mark.skipif(not DATA.is_dir(), reason=f"no surgical-tool data at {DATA}; set HIL_FORCEPS_DATA to read them"),
]


@pytest.fixture(params=SETS)
def side(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def cut_out(side: str, tmp_path: Path) -> Path:
    small = tmp_path / f"{side}.zip"
    name = SETS[side]
    with zipfile.ZipFile(DATA / f"{name}.zip") as whole, zipfile.ZipFile(small, "w", zipfile.ZIP_DEFLATED) as part:
        for member in MEMBERS:
            lines = whole.read(f"{name}/{member}").split(b"\n")[:KEPT_LINES]
            part.writestr(f"{name}/{member}", b"\n".join(lines))
    return small


def test_power_flows_from_spindle_to_jaw_to_load(side: str, cut_out: Path) -> None:
    for run in read_surgical_tool(cut_out):
        assert run.notes[0] == f"{side} jaw"
        columns = run.columns
        spindle, jaw = np.gradient(columns["theta_m_rad"]), np.gradient(columns["theta_j_rad"])
        given, taken = float(columns["tau_m_N_m"] @ spindle), float(columns["tau_w_N_m"] @ jaw)
        # over whole periods the load takes back most of what it gave; friction never does
        assert given > 0
        assert given > 2 * abs(taken)
        assert np.corrcoef(columns["theta_m_rad"], columns["theta_j_rad"])[0, 1] > 0.97
        assert np.corrcoef(columns["tau_m_N_m"], columns["current_A"])[0, 1] > 0.9
        assert np.mean(columns["tau_w_N_m"]) > 0
        assert np.mean(columns["tau_m_N_m"]) > 0 or run.name.endswith("0")


def test_estimates_from_the_motor_side_are_as_poor_as_documented(cut_out: Path, tmp_path: Path) -> None:
    report = replay_instrument(cut_out, load_rig(ROOT / "configs" / "surgical_tool.yaml"), tmp_path / "out")
    assert [round(run.frequency_Hz, 1) for run in report.runs] == [0.3, 0.3, 0.5]
    assert 0.8 < report.fitted.radius_ratio < 0.95
    assert (report.fitted.torque_constant_N_m_per_A or 0.0) == pytest.approx(0.7, rel=0.2)
    torque = {(s.method, s.source): s.tau_w_rmse_N_m for s in report.overall if s.part == WHOLE}
    angle = {(s.method, s.source): s.theta_j_rmse_rad for s in report.overall if s.part == WHOLE}
    trivial_torque, trivial_angle = torque["constant", ""], angle["constant", ""]
    assert trivial_torque is not None
    assert trivial_angle is not None
    for method in ("previous", "improved", "kalman"):
        for source in ("tau_m_N_m", "current_A"):
            found, found_angle = torque[method, source], angle[method, source]
            assert found is not None
            assert found_angle is not None
            assert found > trivial_torque  # friction that the model does not have
            assert found_angle < 0.4 * trivial_angle
