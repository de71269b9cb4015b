"""What no sensor shows is as wide as the rig's bounds; what does show keeps its interval."""

import re
from pathlib import Path

import numpy as np
import pytest

from hil_forceps.diagnosis.driven.gauge import K, with_scale
from hil_forceps.diagnosis.driven.jaw_zero import jaw_zero_rad, without_jaw_zero
from hil_forceps.diagnosis.driven.rows import DrivenRows, Smoothed
from hil_forceps.diagnosis.driven.starting_values import R_J, R_M
from hil_forceps.diagnosis.result import Estimate, Shift
from hil_forceps.diagnosis.validation.rows import Rows
from hil_forceps.rig import load_rig

RIG = load_rig(Path(__file__).parents[4] / "configs" / "paper.yaml")
UNKNOWN = RIG.with_changes(
    {
        R_M: {"value": 2e-3, "sd": 1e-3, "min": 1e-3, "max": 8e-3},
        R_J: {"value": 1.5e-3, "sd": 1e-3, "min": 1e-3, "max": 3e-3},
        K: {"value": 2e4, "sd": 1e4, "min": 1e2, "max": 1e7},
    }
)
SHIFTS = {
    R_J: Shift(None, Estimate(1.5e-3, 1.49e-3, 1.51e-3, "m")),
    K: Shift(None, Estimate(2e4, 1.9e4, 2.1e4, "N_per_m")),
}


def test_radii_and_stiffness_are_as_wide_as_the_bounds_and_their_products_are_not() -> None:
    found, reasons = with_scale(SHIFTS, UNKNOWN)
    # r_j can't be below 1 mm, so the scale is 2/3 at least; nor above 3 mm, so it is 2 at most.
    assert (found[R_M].fitted.low, found[R_M].fitted.high) == pytest.approx((2e-3 / 1.5, 4e-3))
    assert (found[R_J].fitted.low, found[R_J].fitted.high) == pytest.approx((1.49e-3 / 1.5, 3.02e-3))
    assert (found[K].fitted.low, found[K].fitted.high) == pytest.approx((1.9e4 / 4, 2.1e4 * 2.25))
    ratio, turned = (float(value) for value in re.findall(r"= ([0-9.]+)", reasons[0]))
    assert ratio == pytest.approx(2.0 / 1.5, rel=1e-3)
    assert turned == pytest.approx(2e4 * 1.5e-3**2, rel=1e-3)
    assert "[1.325, 1.342]" in reasons[0]


def test_a_rig_that_knows_a_radius_or_fits_none_is_left_alone() -> None:
    assert with_scale(SHIFTS, RIG) == (SHIFTS, ())
    assert with_scale({K: SHIFTS[K]}, UNKNOWN) == ({K: SHIFTS[K]}, ())
    assumed = SHIFTS | {K: Shift(2e4, SHIFTS[K].fitted)}
    assert with_scale(assumed, UNKNOWN) == (assumed, ())


def record_of(zero: float, level: float, *, driving: bool = False) -> DrivenRows:
    time = np.arange(500, dtype=np.float64) * 0.01
    theta = np.asarray(0.5 * np.sin(3.0 * time))
    jaw = np.asarray(0.9 * theta - 1.3 * level - 0.02 * np.sign(np.cos(3.0 * time)) + zero)
    torque = {"tau_m_N_m": np.zeros(500)}
    load = None if driving else np.full(500, level)
    channels = torque if driving else torque | {"theta_j_rad": jaw}
    other = jaw if driving else None
    rows = Rows("a", 0.01, time, theta, channels, load, np.ones(500), driven=True)
    return DrivenRows(rows, other, Smoothed(theta, load, other), {})


def test_a_far_zero_of_the_jaw_is_taken_out_of_every_run_and_said() -> None:
    records = [record_of(1.27, level) for level in (0.01, 0.05, 0.1)]
    found, held, notes = without_jaw_zero(records, records[:1])
    assert jaw_zero_rad(records) == pytest.approx(1.27, abs=1e-3)
    assert "1.27" in notes[0]
    assert len(found) == 3
    assert len(held) == 1
    for record in (*found, *held):
        assert jaw_zero_rad([record]) == pytest.approx(0.0, abs=0.2)
    moved = records[1].rows.channels["theta_j_rad"] - found[1].rows.channels["theta_j_rad"]
    assert moved == pytest.approx(np.full(500, 1.27), abs=1e-3)


def test_a_jaw_that_drives_loses_its_zero_too_and_a_near_zero_stays() -> None:
    found, _, notes = without_jaw_zero([record_of(-2.0, 0.0, driving=True)], [])
    assert found[0].theta_j_rad is not None
    assert abs(float(np.mean(found[0].theta_j_rad))) < 0.1
    assert found[0].smoothed is not None
    assert found[0].smoothed.theta_j_rad == pytest.approx(found[0].theta_j_rad)
    assert notes
    near = [record_of(0.01, level) for level in (0.0, 0.02)]
    assert without_jaw_zero(near, []) == (near, [], ())
    none = [near[0]._replace(rows=near[0].rows._replace(channels={"tau_m_N_m": np.zeros(500)}))]
    assert without_jaw_zero(none, []) == (none, [], ())
