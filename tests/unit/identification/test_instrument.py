"""Replay of instrument runs: what is fitted, what it is judged by, what is written, what is refused."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.data.readers.csv_table import write_csv
from hil_forceps.data.run import Run
from hil_forceps.identification.instrument.evaluation import evaluate, replay_instrument
from hil_forceps.identification.instrument.report import CLOSING, WHOLE, InstrumentReport, Score
from hil_forceps.identification.instrument.score import Estimated, Tally, parts_of
from hil_forceps.report.identification.instrument import loops_figure, map_figure, traces_figure
from hil_forceps.rig import Rig, UserError, load_rig

pytestmark = pytest.mark.xdist_group("instrument")  # what they look at is made once, for all

CONFIG = Path(__file__).parents[3] / "configs" / "surgical_tool.yaml"
RATIO, CONSTANT_N_m_per_A = 0.87, 0.7
JAW_ZERO_RAD, TORQUE_ZERO_N_m = 0.4, 0.012
Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(CONFIG)


def ideal_run(rig: Rig, name: str = "00", frequency_Hz: float = 0.3, load_N_m: float = 0.05, zero: float = 0.0) -> Run:
    """Make a run that obeys (1)-(3) at rest of all inertia, with zeros on jaw angle and spindle torque."""
    r_j = rig.forceps.jaw_pulley_radius_m.value
    k = rig.forceps.wire_stiffness_N_per_m.value
    viscous = rig.forceps.motor_viscous_N_m_s_per_rad.value
    assert r_j is not None
    assert k is not None
    assert viscous is not None
    time_s = np.linspace(0.0, 9.999, 10_000)
    omega = 2 * np.pi * frequency_Hz
    theta_m = -0.5 * np.cos(omega * time_s)
    tau_w = load_N_m * (1.0 + 0.5 * np.sin(2 * np.pi * 0.1 * time_s))
    tau_m = RATIO * tau_w + viscous * 0.5 * omega * np.sin(omega * time_s)
    return Run(
        name,
        {
            "time_s": time_s,
            "theta_m_rad": theta_m,
            "theta_j_rad": RATIO * theta_m - tau_w / (k * r_j**2) + JAW_ZERO_RAD + zero,
            "tau_w_N_m": tau_w,
            "tau_m_N_m": tau_m + TORQUE_ZERO_N_m,
            "current_A": tau_m / CONSTANT_N_m_per_A,
        },
    )


@pytest.fixture(scope="module")
def report(rig: Rig) -> InstrumentReport:
    loads = {"00": (0.3, 0.03), "01": (0.3, 0.06), "10": (0.5, 0.03), "11": (0.5, 0.06)}
    return evaluate("ideal", [ideal_run(rig, name, f, load) for name, (f, load) in loads.items()], rig)


def score(report: InstrumentReport, method: str, source: str = "tau_m_N_m", part: str = WHOLE) -> Score:
    (found,) = [s for s in report.overall if (s.method, s.source, s.part) == (method, source, part)]
    return found


def numbers(found: Score) -> tuple[float, float]:
    assert found.tau_w_rmse_N_m is not None
    assert found.theta_j_rmse_rad is not None
    return found.tau_w_rmse_N_m, found.theta_j_rmse_rad


@pytest.mark.parametrize("method", ["previous", "improved", "kalman"])
@pytest.mark.parametrize("source", ["tau_m_N_m", "current_A"])
def test_an_instrument_that_obeys_the_equations_is_estimated_well(
    method: str, source: str, report: InstrumentReport
) -> None:
    torque, angle = numbers(score(report, method, source))
    trivial_torque, trivial_angle = numbers(score(report, "constant", ""))
    rigid_torque, rigid_angle = numbers(score(report, "rigid", source))
    assert torque < 0.1 * trivial_torque
    assert rigid_torque < 0.1 * trivial_torque
    assert angle < 0.01 * trivial_angle
    assert angle < 0.2 * rigid_angle  # the wire's stretch was seen, with the right sign


def test_ratio_constant_and_zeros_are_found(report: InstrumentReport) -> None:
    fitted = report.fitted
    assert fitted.radius_ratio == pytest.approx(RATIO, rel=5e-3)
    assert fitted.torque_constant_N_m_per_A == pytest.approx(CONSTANT_N_m_per_A, rel=1e-9)
    assert "all runs" in fitted.radius_ratio_from
    torque_zero, angle_zero = fitted.zeros["tau_m_N_m/kalman/whole"]
    assert torque_zero == pytest.approx(-TORQUE_ZERO_N_m / RATIO, rel=0.05)
    assert angle_zero is not None
    torque_zero, _ = fitted.zeros["current_A/kalman/whole"]
    assert torque_zero == pytest.approx(0.0, abs=3e-4)


def test_what_the_rig_knows_is_not_fitted(rig: Rig) -> None:
    changes = {"forceps.motor_pulley_radius_m": 2e-3, "motor.torque_constant_N_m_per_A": 0.5}
    report = evaluate("known", [ideal_run(rig)], rig.with_changes(changes))
    assert report.fitted.radius_ratio == pytest.approx(2e-3 / 2.75e-3)
    assert report.fitted.torque_constant_N_m_per_A == 0.5
    assert report.fitted.radius_ratio_from == report.fitted.torque_constant_from == "rig"
    assert "motor_pulley_radius_m = 0.002" in report.assumed


def test_zeros_are_shared_by_the_data_set(rig: Rig) -> None:
    runs = [ideal_run(rig, "00"), ideal_run(rig, "01", zero=0.2)]
    _, angle = numbers(score(evaluate("two zeros", runs, rig), "improved"))
    assert angle == pytest.approx(0.1, rel=0.05)


def test_the_constant_is_the_spread_of_what_was_measured(rig: Rig, report: InstrumentReport) -> None:
    run = ideal_run(rig)
    rows = parts_of(run)[WHOLE]
    alone = numbers(score(evaluate("one", [run], rig), "constant", ""))
    expected = np.std(run.columns["tau_w_N_m"][rows]), np.std(run.columns["theta_j_rad"][rows])
    assert alone == pytest.approx(expected, rel=1e-9)
    assert score(report, "constant", "").samples == 4 * int(np.sum(rows))


def test_parts_leave_out_ends_and_opening(rig: Rig) -> None:
    run = ideal_run(rig)
    parts = parts_of(run)
    time_s = run.columns["time_s"]
    assert time_s[parts[WHOLE]][[0, -1]].tolist() == pytest.approx([1.0, 8.999])
    speed = 0.5 * 2 * np.pi * 0.3 * np.sin(2 * np.pi * 0.3 * time_s)
    closing = parts[CLOSING]
    assert np.all(speed[closing] > 0.24)
    assert np.all(speed[parts[WHOLE] & ~closing] < 0.26)


def test_a_tally_agrees_with_numpy_and_names_what_diverged(rig: Rig) -> None:
    generator = np.random.default_rng(2)
    runs = [ideal_run(rig, name) for name in ("a", "b", "c")]
    tally = Tally()
    errors: list[Array] = []
    for run in runs:
        rows = parts_of(run)[WHOLE]
        off = 3.0 + generator.normal(size=len(run))
        tally.add(run, {WHOLE: rows}, "s", "m", Estimated(run.columns["tau_w_N_m"] - off, run.columns["theta_j_rad"]))
        blown = np.full(len(run), {"a": 0.0, "b": np.nan, "c": 1e300}[run.name])
        tally.add(run, {WHOLE: rows}, "s", "blown", Estimated(blown, blown))
        errors.append(off[rows])
    pooled = np.concatenate(errors)
    good, bad = tally.overall()
    assert good.tau_w_rmse_N_m == pytest.approx(np.std(pooled), rel=1e-9)
    assert tally.zeros()["s", "m", WHOLE][0] == pytest.approx(np.mean(pooled), rel=1e-9)
    assert bad.tau_w_rmse_N_m is None
    per_run = {s.run: s.tau_w_rmse_N_m for s in tally.per_run() if s.method == "m"}
    assert per_run["b"] == pytest.approx(np.sqrt(np.mean((errors[1] - np.mean(pooled)) ** 2)), rel=1e-9)
    assert [s.run for s in tally.per_run() if s.method == "blown" and s.tau_w_rmse_N_m is None] == ["b", "c"]


def test_files_hold_everything_and_are_the_same_every_time(rig: Rig, tmp_path: Path) -> None:
    source = tmp_path / "r.csv"
    write_csv(ideal_run(rig), source)
    seen: list[tuple[int, int, str]] = []
    report = replay_instrument(source, rig, tmp_path / "a", lambda *what: seen.append(what))
    replay_instrument(source, rig, tmp_path / "b")
    for name in ("instrument.json", "instrument_runs.csv"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    content = json.loads((tmp_path / "a" / "instrument.json").read_text())
    assert content["name"] == "r"
    assert content["published"]["tau_w_rmse_N_m"] == 4.42e-3
    assert len(content["overall"]) == len(report.overall) == 2 * (1 + 2 * 5)
    with (tmp_path / "a" / "instrument_runs.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(report.per_run)
    assert float(rows[0]["frequency_Hz"]) == pytest.approx(0.3, abs=0.02)
    assert seen == [(1, 0, "read run r"), (1, 1, "run r")]


def test_the_table_ends_with_the_published_figures(report: InstrumentReport) -> None:
    table = report.table()
    assert all(len(row) == len(table.headers) for row in table.rows)
    assert table.rows[-1][-2:] == ("4.42", "0.37")
    whole = [float(row[3]) for row in table.rows if row[2] == WHOLE and row[3] != "not finite"]
    assert whole == sorted(whole)


@pytest.mark.parametrize(
    ("drop", "message"),
    [("theta_j_rad", "theta_j_rad was not measured"), ("tau_w_N_m", "tau_w_N_m was not measured")],
)
def test_a_run_without_jaw_sensors_is_refused(drop: str, message: str, rig: Rig) -> None:
    run = ideal_run(rig)
    columns = {name: values for name, values in run.columns.items() if name != drop}
    with pytest.raises(UserError, match=message):
        evaluate("x", [Run("x", columns)], rig)


def test_runs_that_can_not_be_used_are_refused(rig: Rig) -> None:
    run = ideal_run(rig)
    short = Run("x", {name: values[:2000] for name, values in run.columns.items()})
    with pytest.raises(UserError, match="lasts 2 s"):
        evaluate("x", [short], rig)
    backwards = Run("x", run.columns | {"theta_j_rad": -run.columns["theta_j_rad"]})
    with pytest.raises(UserError, match="per rad of the spindle, which must be positive"):
        evaluate("x", [backwards], rig)
    crossed = Run("x", run.columns | {"current_A": -run.columns["current_A"]})
    with pytest.raises(UserError, match="per A of current, which must be positive"):
        evaluate("x", [crossed], rig)
    current_only = Run("x", {name: v for name, v in run.columns.items() if name != "tau_m_N_m"})
    with pytest.raises(UserError, match="torque_constant_N_m_per_A"):
        evaluate("x", [current_only], rig)


def test_figures_say_what_they_show(report: InstrumentReport) -> None:
    traces = report.traces
    assert {trace.run.frequency_Hz > 0.4 for trace in traces} in ({True}, {False})
    figure = traces_figure(traces)
    assert figure.axes[0].get_ylabel() == r"jaw torque $\tau_w$ (mN m)"
    broken = [
        trace._replace(tau_w_estimated_N_m=trace.tau_w_estimated_N_m | {"kalman": np.full(10_000, np.nan)})
        for trace in traces
    ]
    labels = [text.get_text() for text in traces_figure(broken).legends[0].get_texts()]
    assert "Kalman (not finite)" in labels
    assert loops_figure(traces).axes[0].get_xlabel() == "jaw angle (deg)"
    panel = map_figure(report, "tau_m_N_m", "torque").axes[0]
    assert [tick.get_text() for tick in panel.get_xticklabels()] == ["0.3", "0.5"]
    assert [tick.get_text() for tick in panel.get_yticklabels()] == ["30", "60"]
    assert len(panel.texts) == 4 + 1  # a number per run, and the panel's letter
