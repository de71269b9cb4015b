"""`simulate`: along a motion and beside a run, with the same simulation behind both."""

from pathlib import Path

import numpy as np
import pandas
import pytest

import hil_forceps as hf
from hil_forceps.identification.simulation import simulate_beside

RIG = hf.load_rig(Path(__file__).parents[3] / "configs" / "realistic.yaml")
MOTION = hf.Trajectory((0.0, 0.1, 0.5), (1.5, 1.5, 1.1))
LOAD = hf.Trajectory((0.0, 0.2, 0.3), (0.0, 0.0, 1e-3))


def test_a_motion_is_followed_under_its_load() -> None:
    result = hf.simulate(RIG, MOTION, load_N_m=LOAD)
    assert len(result["time_s"]) == 1001
    assert result["time_s"][-1] == pytest.approx(0.5)
    assert result["tau_w_N_m"][-1] == 1e-3
    wanted = np.array([MOTION(t) for t in result["time_s"]])
    assert np.max(np.abs(result["theta_j_rad"] - wanted)) < 0.06  # the wire gives by 0.04 rad under the load
    assert result["theta_j_rad"][-1] - wanted[-1] == pytest.approx(-1e-3 / (2.6e4 * 1.4e-3**2), abs=5e-3)
    assert dict(result.measured) == {}
    assert hf.simulate(RIG, MOTION, load_N_m=1e-3, duration_s=0.1)["tau_w_N_m"].tolist() == [1e-3] * 201


def test_what_a_motion_gives_is_a_run_that_is_simulated_again() -> None:
    run = hf.simulate(RIG, MOTION, load_N_m=LOAD).to_run()
    again = hf.simulate(RIG, run)
    assert again.is_closed_loop
    assert again.rmse("theta_m_rad") < 2 * np.pi / 16384
    other = hf.simulate(RIG.with_changes({"forceps.motor_viscous_N_m_s_per_rad": 2e-4}), run)
    assert other.rmse("current_A") > 3 * again.rmse("current_A")


def test_beside_a_run_it_is_the_command_lines_simulation() -> None:
    run = hf.simulate(RIG, MOTION, load_N_m=LOAD).to_run()
    own, below = hf.simulate(RIG, run), simulate_beside(run, RIG)
    assert list(own.measured) == list(below.measured)
    for channel in own.measured:
        np.testing.assert_array_equal(own[channel], below.simulated[channel])
        assert (own.rmse(channel), own.scatter(channel)) == (below.rmse(channel), below.scatter(channel))
    pandas.testing.assert_frame_equal(own.to_pandas(), pandas.DataFrame(dict(own.columns)))
    driven = hf.simulate(RIG.with_changes({"drive": None}), run)
    assert not driven.is_closed_loop
    with pytest.raises(hf.UserError, match="the measured motion was the input"):
        driven.to_run()


def test_what_is_refused() -> None:
    run = hf.simulate(RIG, MOTION).to_run()
    with pytest.raises(ValueError, match="load_N_m and duration_s: a run brings its load and duration"):
        hf.simulate(RIG, run, load_N_m=1e-3)
    with pytest.raises(ValueError, match=r"can't last 0\.0 s"):
        hf.simulate(RIG, hf.Trajectory((0.0,), (1.5,)))
    with pytest.raises(hf.UserError, match="drive: the section is missing"):
        hf.simulate(RIG.with_changes({"drive": None}), MOTION)
    with pytest.raises(KeyError, match="voltage_V was not measured and simulated; there are theta_m_rad"):
        hf.simulate(RIG, run).rmse("voltage_V")
    with pytest.raises(hf.UserError, match=r"nowhere\.yaml: can't be read"):
        hf.simulate("nowhere.yaml", run)
