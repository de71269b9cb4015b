"""Recordings of EPOS Studio: what they hold, what the rig must add, and what is refused with its line."""

from pathlib import Path

import numpy as np
import pytest

from hil_forceps.data.readers.read_run import read_run
from hil_forceps.data.run import ANGLE_FROM_SPEED
from hil_forceps.diagnosis.conclude import diagnose
from hil_forceps.diagnosis.options import Options
from hil_forceps.rig import Rig, UserError, load_rig
from tests.unit.diagnosis.driven.test_identification import DATA, needed

ROOT = Path(__file__).parents[4]
HEAD = (
    "Date:;2026-01-02 03:04:05\r\nEPOS Studio Version:;3.6.1.0\r\nSampling period:;40.000\r\n"
    '"Trigger:;1;0.000000;""Parameter values"";""Channel 1"";""Rising above value"""\r\n'
)
SPEED = ";Velocity actual value averaged;Torque actual value averaged\r\nms;rpm;%\r\n"


@pytest.fixture
def rig() -> Rig:
    return load_rig(ROOT / "configs" / "epos_screw.yaml")


def written(path: Path, text: str) -> Path:
    path.write_bytes(text.encode("cp1252"))
    return path


def test_speed_and_torque_become_angle_and_torque(tmp_path: Path, rig: Rig) -> None:
    rows = "0.000;0;0.0\r\n40.000;30;10.0\r\n80.000;60;-50.0\r\n\r\n"
    (run,) = read_run(written(tmp_path / "run.csv", HEAD + SPEED + rows), rig=rig)
    assert run.name == "run"
    np.testing.assert_allclose(run.columns["time_s"], [0.0, 0.04, 0.08])
    # 15 and 45 turns a minute on average of 40 ms each.
    np.testing.assert_allclose(run.columns["theta_m_rad"], 2.0 * np.pi * np.array([0.0, 0.01, 0.04]))
    np.testing.assert_allclose(run.columns["tau_m_N_m"], 9.84e-3 * np.array([0.0, 0.1, -0.5]))
    np.testing.assert_allclose(run.columns["tau_w_N_m"], 3.0e-4)
    assert ANGLE_FROM_SPEED in run.notes
    assert "load: 0.0003 N m throughout, from the rig file" in run.notes


def test_position_demand_and_current_are_taken_where_they_were_recorded(tmp_path: Path, rig: Rig) -> None:
    names = ";Position actual value;Current actual value;Position demand value;Following error actual value\r\n"
    text = HEAD + names + "ms;qc;mA;qc;qc\r\n0,000;0;0;0;0\r\n1,000;1024;-250,5;2048;7\r\n"
    (run,) = read_run(written(tmp_path / "run.csv", text), rig=rig.with_changes({"encoder": {"counts_per_rev": 4096}}))
    np.testing.assert_allclose(run.columns["theta_m_rad"], [0.0, 0.5 * np.pi])
    np.testing.assert_allclose(run.columns["theta_m_ref_rad"], [0.0, np.pi])
    np.testing.assert_allclose(run.columns["current_A"], [0.0, -0.2505])
    assert "object 'following error actual value' was left out" in run.notes
    assert ANGLE_FROM_SPEED not in run.notes


BAD = {
    "in percent of the motor's rated torque": HEAD + SPEED + "0;0;0\n1;1;1\n",
    "the file does not contain the counts of one turn": HEAD
    + ";Position actual value;Torque actual value\nms;qc;%\n0;0;0\n1;1;1\n",
    ":6: velocity actual value averaged is in 'rad'; rpm or": HEAD + SPEED.replace("rpm", "rad") + "0;0;0\n1;1;1\n",
    ":7: 'was -8.9' is not a finite number; correct the row": HEAD + SPEED + "0;0;was -8.9\n1;1;1\n",
    ":8: 2 cells for 3 columns; correct the row": HEAD + SPEED + "0;0;0\n1;1\n",
    ":8: time_s: 0 does not come after 0": HEAD + SPEED + "0;0;0\n0;1;1\n",
    ":7: 'nan' is not a finite number": HEAD + SPEED + "0;nan;0\n1;1;1\n",
    "1 samples are too few": HEAD + SPEED + "0;0;0\n",
    "no row of units": HEAD,
    "3 units for 2 objects": HEAD + ";Velocity actual value\nms;rpm;%\n0;0;0\n1;1;1\n",
    "neither position nor velocity": HEAD + ";Torque actual value\nms;%\n0;0\n1;1\n",
    "neither current nor torque": HEAD + ";Velocity actual value\nms;rpm\n0;0\n1;1\n",
}


@pytest.mark.parametrize("told", BAD)
def test_what_cannot_be_used_is_refused_with_its_line(told: str, tmp_path: Path, rig: Rig) -> None:
    known = None if "does not contain" in told or "percent" in told else rig
    with pytest.raises(UserError) as caught:
        read_run(written(tmp_path / "run.csv", BAD[told]), rig=known)
    assert told in str(caught.value)


def test_any_bytes_behind_the_mark_give_a_run_or_one_line(tmp_path: Path, rig: Rig) -> None:
    whole = (HEAD + SPEED + "".join(f"{40 * n}.000;{n};{n}.5\r\n" for n in range(20))).encode()
    generator = np.random.default_rng(5)
    refused = 0
    for _ in range(300):
        data = bytearray(whole)
        for _ in range(int(generator.integers(1, 6))):
            data[int(generator.integers(60, len(data)))] = int(generator.integers(0, 256))
        (tmp_path / "run.csv").write_bytes(data[: int(generator.integers(60, len(data) + 1))])
        try:
            read_run(tmp_path / "run.csv", rig=rig)
        except UserError:
            refused += 1
    assert 30 < refused < 300


# Friction of a start-stop run by the parameters that the authors published for their three drives (sd_1dof.m of their
# repository, through their equation of a screw with Stribeck friction), N m at 50 rpm.
PUBLISHED_AT_50_RPM_N_M = {1: 2.89e-3, 2: 5.07e-3, 3: 1.48e-3}


@pytest.mark.shared_data
@pytest.mark.parametrize("drive", [1, 2, 3])
def test_friction_of_measured_screw_drives_is_near_what_their_authors_published(drive: int, rig: Rig) -> None:
    runs = read_run(needed(DATA / "epos_screw" / f"driveNo{drive}" / "start_stop"), rig=rig)
    told = diagnose(runs, rig, Options()).diagnosis
    shifts = told.parameter_shifts
    coulomb = shifts["forceps.motor_coulomb_N_m"].fitted.value
    viscous = shifts["forceps.motor_viscous_N_m_s_per_rad"].fitted.value
    # Friction that builds up over a hundredth of a radian is dry friction to rows of 0.2 rad.
    built_up = sum(e.parameters["level_N_m"].value for e in told.effects if e.id == "presliding_friction")
    at_50_rpm = coulomb + built_up + viscous * 50.0 * 2.0 * np.pi / 60.0
    assert at_50_rpm == pytest.approx(PUBLISHED_AT_50_RPM_N_M[drive], rel=0.2)
    (note,) = (finding for finding in told.data_audit if finding.kind == "angle")
    assert "cogging" in note.text
