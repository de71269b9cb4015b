"""The inverse model of an axis: on one made by equations of this file's own, and on EMPS as published."""

import json
import math
import os
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.io import loadmat, savemat

from hil_forceps.cli.main import main
from hil_forceps.data.readers.csv_table import write_csv
from hil_forceps.data.run import Run
from hil_forceps.identification.axis.axis import AxisRun, read_axis, to_axis
from hil_forceps.identification.axis.comparison import compare_axis
from hil_forceps.identification.axis.evidence import response, roll_off, stiffness
from hil_forceps.identification.axis.force_terms import Law, Shape
from hil_forceps.identification.axis.inverse_model import Fit, at_bound, decimated, delayed, fit, relative_error
from hil_forceps.identification.axis.open_loop import open_loop
from hil_forceps.identification.axis.open_loop_runs import needed, position_error, rms
from hil_forceps.identification.axis.ripple import shifted, zero_m
from hil_forceps.identification.axis.term_selection import Rung, chosen, climb, intervals, jackknife
from hil_forceps.rig import load_rig
from hil_forceps.rig.errors import UserError

pytestmark = pytest.mark.xdist_group("axis")  # what they look at is made once, for all

ROOT = Path(__file__).parents[3]
EMPS = Path(os.environ.get("HIL_FORCEPS_DATA", ROOT.parent / "shared" / "data")) / "emps"
RIG = ROOT / "configs" / "emps.yaml"
RADIUS_M = 5e-3
STEP_s = 1e-3
FINER = 20  # steps of the made axis in a sample
MASS_kg = 95.0

Vector = NDArray[np.float64]


def reference(duration_s: float) -> Vector:
    """Strokes of several speeds, there and back, with halts in between, by constant accelerations."""
    speeds = np.array([0.05, 0.12, 0.03, -0.03, -0.12, -0.05, 0.08, 0.02, -0.08, -0.02])
    ways = np.array([0.03, 0.10, 0.01, 0.01, 0.10, 0.03, 0.05, 0.01, 0.05, 0.01])
    course: list[float] = []
    while len(course) * STEP_s < duration_s:
        for speed, way in zip(speeds, ways, strict=True):
            rise = np.arange(0.0, 1.0, 0.02)
            course += [*(speed * rise), *np.full(int(way / abs(speed) / STEP_s), speed), *(speed * rise[::-1])]
    return np.cumsum(course[: round(duration_s / STEP_s)]) * STEP_s


def made(
    name: str = "made",
    *,
    duration_s: float = 12.0,
    backward_more: float = 0.0,
    dead_time_s: float = 0.0,
    low_N: float = 0.0,
    ripple_N: float = 0.0,
    zero_m: float = 0.0,
    friction: float = 1.0,
    pushes: bool = False,
    seed: int = 1,
    wanted: Vector | None = None,
) -> Run:
    """An axis held by a sampled position and speed loop, by Euler's steps; the force acts after dead time and hold."""
    wanted = reference(duration_s) if wanted is None else wanted
    generator = np.random.default_rng(seed)
    late = round(dead_time_s / STEP_s * FINER)
    step = STEP_s / FINER
    position = speed = before = 0.0
    positions, forces = np.empty(len(wanted)), np.empty(len(wanted))
    waiting = [0.0] * (late + 1)
    for row, target in enumerate(wanted):
        seen = position + 2e-8 * generator.normal()
        force = 1.3e6 * (target - seen) - 8.5e3 * (seen - before) / STEP_s
        force += (170.0 if row % 1000 < 500 else 0.0) if pushes else 0.0
        before = seen
        positions[row], forces[row] = seen, force
        for _ in range(FINER):
            waiting.append(force)
            push = waiting.pop(0)
            sign = speed / math.sqrt(speed**2 + 1e-8)
            dry = (20.0 + low_N * math.exp(-((speed / 0.012) ** 2))) * sign
            viscous = (200.0 + (backward_more if speed < 0.0 else 0.0)) * speed
            wave = ripple_N * math.sin(2.0 * math.pi * (position - zero_m) / 2e-3)
            speed += step * (push - friction * (dry + viscous) - wave) / MASS_kg
            position += step * speed
    columns = {
        "time_s": np.arange(len(wanted), dtype=np.float64) * STEP_s,
        "theta_m_ref_rad": wanted / RADIUS_M,
        "theta_m_rad": positions / RADIUS_M,
        "tau_m_N_m": forces * RADIUS_M,
    }
    return Run(name, columns)


def axis(run: Run) -> AxisRun:
    return to_axis(run, RADIUS_M)


@pytest.fixture(scope="module")
def everything() -> tuple[AxisRun, tuple[Rung, ...]]:
    run = axis(made(backward_more=70.0, dead_time_s=0.6e-3, low_N=-8.0, ripple_N=1.0))
    return run, climb(run)


def test_what_is_hidden_in_an_axis_is_found(everything: tuple[AxisRun, tuple[Rung, ...]]) -> None:
    run, rungs = everything
    kept = {rung.term for rung in rungs if rung.kept}
    assert {"asymmetric", "dead_time", "low_speed", "ripple"} <= kept
    assert all(rung.left_out_error > 1.002 * rung.error for rung in rungs)  # what was left out was not fitted
    best = next(rung.fit for rung in rungs if rung.term == "ripple")
    found = intervals(best, jackknife(run, best))
    assert found["mass_kg"].value == pytest.approx(MASS_kg, rel=0.01)
    assert found["viscous_forward_N_s_per_m"].value == pytest.approx(200.0, rel=0.05)
    assert found["viscous_backward_N_s_per_m"].value == pytest.approx(270.0, rel=0.05)
    assert found["low_speed_N"].value == pytest.approx(-8.0, rel=0.2)
    # Half a sample of hold comes on top of the dead time.
    assert found["dead_time_s"].value == pytest.approx(1.1e-3, abs=0.1e-3)
    assert found["dead_time_s"].low < found["dead_time_s"].value < found["dead_time_s"].high
    assert best.shape.ripple_period_m == pytest.approx(2e-3, rel=0.01)
    assert math.hypot(found["ripple_cos_N"].value, found["ripple_sin_N"].value) == pytest.approx(1.0, abs=0.25)


def test_a_plain_axis_is_left_plain() -> None:
    rungs = climb(axis(made()))
    assert [rung.term for rung in rungs if rung.kept] == ["", "dead_time"]
    low = next(rung for rung in rungs if rung.term == "low_speed")
    assert at_bound(low.fit)  # else the smoothed step of the friction would have passed for one


def test_the_ripple_of_another_run_begins_elsewhere(everything: tuple[AxisRun, tuple[Rung, ...]]) -> None:
    _, rungs = everything
    best = next(rung.fit for rung in rungs if rung.term == "ripple")
    other = axis(made("other", backward_more=70.0, dead_time_s=0.6e-3, low_N=-8.0, ripple_N=1.0, zero_m=0.7e-3, seed=2))
    way, error = zero_m(other, best)
    assert way == pytest.approx(0.7e-3, abs=0.1e-3)
    assert error < relative_error(other.rows, best)
    assert relative_error(other.rows, shifted(best, way)) == pytest.approx(error, rel=1e-9)


def test_mass_and_delay_over_frequency() -> None:
    pushed = axis(made(pushes=True, dead_time_s=0.3e-3))
    found = fit(pushed.rows, Law(dead_time=True), Shape())
    told = stiffness(response(pushed, found), pushed.sample_time_s)
    assert told is not None
    assert told.up_to_Hz > 60.0
    assert told.delay_s == pytest.approx(0.8e-3, abs=0.05e-3)
    # A rigid axis: the mass rises by less than 2 % up to 100 Hz, and nothing else is claimed.
    assert abs(told.rise_per_Hz2) * 100.0**2 < 0.02
    assert told.low_per_Hz2 < 0.0 < told.high_per_Hz2


def test_a_spring_shows_as_a_mass_that_rises() -> None:
    spring_Hz, share = 150.0, 0.4  # of the load held still, and of the mass
    time_s = np.arange(24_000, dtype=np.float64) * STEP_s
    generator = np.random.default_rng(5)
    frequencies = np.fft.rfftfreq(len(time_s), STEP_s) + 1e-6  # no bin on the spring's own
    shape = np.where((frequencies > 1.0) & (frequencies < 120.0), 1.0, 0.0)
    acceleration = np.fft.rfft(generator.normal(size=len(time_s))) * shape
    mass = MASS_kg * (1.0 - share + share / (1.0 - (frequencies / spring_Hz) ** 2))
    turned = -((2.0 * np.pi * frequencies) ** 2)
    position = np.fft.irfft(acceleration / turned * shape, len(time_s))
    force = np.fft.irfft(acceleration * mass * shape, len(time_s))
    run = axis(Run("spring", {"time_s": time_s, "theta_m_rad": position / RADIUS_M, "tau_m_N_m": force * RADIUS_M}))
    alone = Fit(Law(), Shape(), {"mass_kg": MASS_kg, "viscous_N_s_per_m": 0.0, "coulomb_N": 0.0, "offset_N": 0.0})
    told = stiffness(response(run, alone), run.sample_time_s)
    assert told is not None
    assert told.low_per_Hz2 > 0.0
    assert told.rise_per_Hz2 == pytest.approx(share / spring_Hz**2, rel=0.6)  # the square alone, of a pole's series


def test_the_open_loop_is_the_axis(everything: tuple[AxisRun, tuple[Rung, ...]]) -> None:
    run, rungs = everything
    plain, best = rungs[0].fit, rungs[-1].fit
    assert rms(position_error(run, best)) < 0.5 * rms(position_error(run, plain))
    # Constant force on a mass alone, held, and late by the dead time: F t²/2m from then on.
    mass = Fit(Law(), Shape(dead_time_s=2.5e-3), {"mass_kg": 2.0, "viscous_N_s_per_m": 0.0, "coulomb_N": 0.0})
    mass.coefficients["offset_N"] = 0.0
    force = np.where(np.arange(200) >= 10, 3.0, 0.0)
    moved = open_loop(mass, force, (0.1, 0.0), STEP_s)
    late_s = np.maximum(0.0, np.arange(200) * STEP_s - 12e-3)
    np.testing.assert_allclose(moved, 0.1 + 0.5 * 3.0 / 2.0 * late_s**2, atol=1e-12)


def test_a_friction_that_another_run_has_more_of_is_told(everything: tuple[AxisRun, tuple[Rung, ...]]) -> None:
    _, rungs = everything
    best = next(rung.fit for rung in rungs if rung.term == "low_speed")
    more = axis(made("more", backward_more=70.0, dead_time_s=0.6e-3, low_N=-8.0, ripple_N=1.0, friction=1.05))
    same = axis(made("same", backward_more=70.0, dead_time_s=0.6e-3, low_N=-8.0, ripple_N=1.0, seed=3))
    told = needed(more, best)
    assert told.friction_scale / needed(same, best).friction_scale == pytest.approx(1.05, abs=0.02)
    assert told.rmse_m < told.rmse_scale_only_m < rms(position_error(more, best))


def test_decimation_keeps_the_last_row_and_delay_moves_a_wave() -> None:
    values = np.arange(2481.0)
    kept = decimated(values, 10)
    assert len(kept) == 249
    loss = 10.0 ** (-0.1 / 20.0)  # the filter's own 0.05 dB at zero frequency, twice
    assert kept[-1] == pytest.approx(loss * 2480.0, rel=1e-3)
    assert np.diff(kept)[50:-50] == pytest.approx(loss * 10.0, rel=1e-3)
    wave = np.sin(2.0 * np.pi * 20.0 * np.arange(2000) * STEP_s)
    late = np.sin(2.0 * np.pi * 20.0 * (np.arange(2000) * STEP_s - 0.3e-3))
    np.testing.assert_allclose(delayed(wave, 0.3)[20:-20], late[20:-20], atol=1e-4)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"theta_j_rad": np.zeros(5000)}, "jaw"),
        ({"tau_w_N_m": np.ones(5000)}, "load"),
        ({"time_s": np.cumsum(np.where(np.arange(5000) == 2000, 0.1, 1e-3))}, "gaps"),
        ({"time_s": np.arange(5000) * 1e-4}, "less than"),
        ({"tau_m_N_m": None, "current_A": np.ones(5000)}, "tau_m_N_m"),
    ],
)
def test_what_is_no_axis_is_refused(change: dict[str, Vector | None], problem: str, tmp_path: Path) -> None:
    columns: dict[str, Vector] = {
        "time_s": np.arange(5000, dtype=np.float64) * STEP_s,
        "theta_m_rad": np.zeros(5000),
        "tau_m_N_m": np.ones(5000),
    }
    wanted = {name: values for name, values in (columns | change).items() if values is not None}
    write_csv(Run("a", wanted), tmp_path / "a.csv")
    with pytest.raises(UserError, match=problem):
        read_axis([tmp_path / "a.csv"], load_rig(RIG))


def test_one_run_is_nothing_to_compare() -> None:
    with pytest.raises(UserError, match="two sources"):
        compare_axis([axis(made(duration_s=5.0))])


@pytest.mark.long
def test_the_command_on_two_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, pushes in (("one", False), ("two", True)):
        run = made(name, duration_s=6.0, backward_more=60.0, dead_time_s=0.6e-3, pushes=pushes)
        write_csv(run, tmp_path / f"{name}.csv")
    sources = [str(tmp_path / "one.csv"), str(tmp_path / "two.csv")]
    with pytest.raises(SystemExit) as ended:
        main(["replay", *sources, "--rig", str(RIG), "--out", str(tmp_path / "out")])
    assert ended.value.code == 0
    told = capsys.readouterr().out
    assert "Force error, terms chosen on one alone" in told
    content = json.loads((tmp_path / "out" / "axis_comparison.json").read_text(encoding="utf-8"))
    assert (content["train"], content["tests"]) == ("one", ["two"])
    assert {error["run"] for error in content["force_errors"]} == {"two"}
    assert len(list((tmp_path / "out").glob("*.png"))) == 3
    with pytest.raises(SystemExit) as ended:
        main(["replay", *sources])
    assert ended.value.code == 2
    assert "need --rig" in capsys.readouterr().err
    with pytest.raises(SystemExit) as ended:
        main(["replay", *sources, "--rig", str(RIG), "--out", str(tmp_path / "out"), "--algorithm", "kalman"])
    assert ended.value.code == 2
    assert "not possible with several sources" in capsys.readouterr().err


def emps(name: str) -> Path:
    path = EMPS / f"{name}.mat"
    if not path.exists():
        pytest.skip(f"{path} is not there; see docs/real-data.md for where to get it")
    return path


@pytest.mark.shared_data
def test_the_published_figures_come_out() -> None:
    train, test = read_axis([emps("DATA_EMPS"), emps("DATA_EMPS_PULSES")], load_rig(RIG))
    found = fit(train.rows, Law(), Shape())
    published = {"mass_kg": 95.1089, "viscous_N_s_per_m": 203.5034, "coulomb_N": 20.3935, "offset_N": -3.1648}
    assert found.coefficients == pytest.approx(published, rel=2e-5)
    assert relative_error(train.rows, found) == pytest.approx(0.040834, abs=1e-6)
    assert relative_error(test.rows, found) == pytest.approx(0.059824, abs=3e-6)
    asymmetric = fit(train.rows, Law(asymmetric=True), Shape())
    published = {
        "mass_kg": 95.1540,
        "viscous_forward_N_s_per_m": 166.7061,
        "coulomb_forward_N": 20.1440,
        "viscous_backward_N_s_per_m": 240.4236,
        "coulomb_backward_N": 20.6277,
    }
    assert asymmetric.coefficients == pytest.approx(published, rel=2e-5)
    assert relative_error(train.rows, asymmetric) == pytest.approx(0.031117, abs=1e-6)


@pytest.mark.slow
@pytest.mark.shared_data
def test_emps_by_the_train_file_alone() -> None:
    train, test = read_axis([emps("DATA_EMPS"), emps("DATA_EMPS_PULSES")], load_rig(RIG))
    best = chosen(climb(train)).fit
    assert best.law == Law(*[True] * 5)
    assert relative_error(test.rows, best) < 0.036
    assert best.shape.dead_time_s == pytest.approx(0.8e-3, abs=0.05e-3)
    assert best.shape.ripple_period_m == pytest.approx(2.5e-3, rel=0.002)
    way, error = zero_m(test, best)
    assert way == pytest.approx(0.57e-3, abs=0.1e-3)
    assert error < relative_error(test.rows, best)
    # The pulses tell the same dead time, by phase instead of least squares; the stored position was filtered.
    told = stiffness(response(test, best), test.sample_time_s)
    assert told is not None
    assert told.delay_s == pytest.approx(best.shape.dead_time_s, abs=0.03e-3)
    assert roll_off(test) > 8.0 > roll_off(train)


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.shared_data
def test_low_speed_friction_left_out_pulls_the_dead_time_on_the_measured_reference() -> None:
    """What the train file's 0.3 ms without and 0.8 ms with that friction would be on an axis that is known."""
    wanted = loadmat(emps("DATA_EMPS"))["qg"][:12_000, 0]
    plain = climb(axis(made(dead_time_s=0.3e-3, wanted=wanted)))
    assert [rung.term for rung in plain if rung.kept] == ["", "dead_time"]
    assert chosen(plain).fit.shape.dead_time_s == pytest.approx(0.8e-3, abs=0.05e-3)
    low = {rung.term: rung for rung in climb(axis(made(dead_time_s=0.3e-3, low_N=-8.0, wanted=wanted)))}
    assert low["dead_time"].fit.shape.dead_time_s < 0.5e-3
    assert low["low_speed"].kept
    assert low["low_speed"].fit.shape.dead_time_s == pytest.approx(0.8e-3, abs=0.05e-3)
    assert low["low_speed"].fit.coefficients["low_speed_N"] == pytest.approx(-8.0, rel=0.1)


@pytest.mark.long
@pytest.mark.shared_data
def test_the_command_on_cut_outs_of_emps(tmp_path: Path) -> None:
    for name in ("DATA_EMPS", "DATA_EMPS_PULSES"):
        whole = {key: value for key, value in loadmat(emps(name)).items() if not key.startswith("_")}
        savemat(tmp_path / f"{name}.mat", {key: value[:6500] for key, value in whole.items()})
    sources = [str(tmp_path / f"{name}.mat") for name in ("DATA_EMPS", "DATA_EMPS_PULSES")]
    with pytest.raises(SystemExit) as ended:
        main(["replay", *sources, "--rig", str(RIG), "--out", str(tmp_path / "out")])
    assert ended.value.code == 0
    content = json.loads((tmp_path / "out" / "axis_comparison.json").read_text(encoding="utf-8"))
    assert content["rungs"][0]["train_error"] > content["rungs"][3]["train_error"]
    assert len(content["runs"][1]["strokes"]) == 4
