"""`hil-forceps simulate`: the simulation beside a run, in closed loop and driven, and what it can't do."""

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hil_forceps.cli.main import main
from hil_forceps.data.readers.csv_table import write_csv
from hil_forceps.data.run import Column, Run
from hil_forceps.identification.simulation import simulate_beside
from hil_forceps.model import closed_loop
from hil_forceps.model.closed_loop import law_vector
from hil_forceps.model.parameters import vector
from hil_forceps.rig import Rig, dump_rig, load_rig
from hil_forceps.rig.errors import UserError

ROOT = Path(__file__).parents[4]
COUNT = 2000
Call = Callable[..., tuple[int, str, str]]


def the_rig() -> Rig:
    return load_rig(ROOT / "configs" / "realistic.yaml").with_changes({"drive.sample_time_s": 1e-3, "bench": {}})


def a_run(rig: Rig, name: str = "a", scale: float = 1.0) -> Run:
    """Simulate finely from rest, with the load in steps between rows, and keep what a bench records."""
    theta = vector(rig)
    theta[0] *= scale
    time_s: Column = np.arange(COUNT, dtype=np.float64) / 1000
    reference: Column = 0.6 + 0.3 * np.sin(3 * time_s)
    load: Column = 1e-3 * (1 - np.cos(4 * time_s))
    inputs = closed_loop.Inputs(time_s, reference, load, np.empty(0, np.int64), np.empty(0))
    start = closed_loop.rest(theta, float(reference[0]))
    quantum = 2 * np.pi / 16384
    out = closed_loop.simulate(theta, law_vector(rig.require_drive()), quantum, inputs, start, 20)
    columns: dict[str, Column] = {
        "time_s": time_s,
        "theta_m_ref_rad": reference,
        "theta_m_rad": np.round(out.theta_m_rad / quantum) * quantum,
        "current_A": out.current_A,
        "theta_j_rad": out.theta_j_rad,
        "tau_w_N_m": load,
    }
    return Run(name, columns)


def without(run: Run, *names: str) -> Run:
    return Run(run.name, {name: values for name, values in run.columns.items() if name not in names})


def test_in_closed_loop_the_run_comes_back() -> None:
    rig = the_rig()
    result = simulate_beside(a_run(rig), rig)
    assert result.is_closed_loop
    assert list(result.measured) == ["theta_m_rad", "current_A", "theta_j_rad"]
    assert result.rmse("theta_m_rad") < 2 * np.pi / 16384
    assert result.rmse("current_A") < 0.05 * np.std(result.measured["current_A"])
    assert result.rmse("theta_j_rad") < 1e-3
    assert result.notes == ()


def test_a_wrong_rig_shows_in_the_error() -> None:
    rig = the_rig()
    right = simulate_beside(a_run(rig), rig).rmse("theta_j_rad")
    assert simulate_beside(a_run(rig, scale=1.05), rig).rmse("theta_j_rad") > 10 * right


def test_it_starts_where_the_run_does() -> None:
    rig = the_rig()
    whole = a_run(rig)
    cut = Run("cut", {name: values[900:] for name, values in whole.columns.items()})
    result = simulate_beside(cut, rig)
    assert result.rmse("current_A") < 0.1 * np.std(result.measured["current_A"])
    error = result.simulated["current_A"] - result.measured["current_A"]
    assert abs(np.mean(error[:200])) < 5e-3


@pytest.mark.parametrize(
    ("missing", "compared"),
    [
        ((), ["current_A", "theta_j_rad"]),
        (("theta_j_rad",), ["current_A"]),
        (("tau_w_N_m",), ["current_A"]),
    ],
)
def test_driven_by_the_motion_where_the_drive_is_not_known(missing: tuple[str, ...], compared: list[str]) -> None:
    rig = the_rig()
    result = simulate_beside(without(a_run(rig), *missing), rig.with_changes({"drive": None}))
    assert not result.is_closed_loop
    assert list(result.measured) == compared
    assert result.rmse("current_A") < 0.2 * np.std(result.measured["current_A"])
    assert "the rig has no drive" in result.notes[0]


def test_rows_of_other_paces() -> None:
    rig = the_rig()
    run = a_run(rig)
    slow = Run("slow", {name: values[::2] for name, values in run.columns.items()})
    assert simulate_beside(slow, rig).rmse("theta_m_rad") < 3e-3
    gap = Run("gap", {name: np.delete(values, slice(500, 520)) for name, values in run.columns.items()})
    result = simulate_beside(gap, rig)
    assert len(result.time_s) == COUNT
    assert "gaps are interpolated linearly; the longest is 0.021 s" in result.notes
    odd = Run("odd", {name: 1.3 * values if name == "time_s" else values for name, values in run.columns.items()})
    with pytest.raises(UserError, match="no whole multiple of the drive"):
        simulate_beside(odd, rig)


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Call:
    monkeypatch.setenv("COLUMNS", "200")

    def run(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            main(["simulate", *map(str, arguments)])
        out, err = capsys.readouterr()
        assert isinstance(ended.value.code, int)
        return ended.value.code, out, err

    return run


def test_the_command_prints_and_writes_what_the_simulation_gives(call: Call, tmp_path: Path) -> None:
    rig = the_rig()
    (rig_file := tmp_path / "rig.yaml").write_text(dump_rig(rig))
    run = a_run(rig)
    write_csv(run, tmp_path / "a.csv")
    code, out, _ = call(rig_file, "--like", tmp_path / "a.csv", "--out", tmp_path / "out")
    assert code == 0
    result = simulate_beside(run, rig)
    assert f"{1e3 * result.rmse('current_A'):.4g}" in out
    assert "simulated: in closed loop" in out
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == ["a.csv", "a.pdf", "a.png"]
    with (tmp_path / "out" / "a.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == COUNT
    for name in result.measured:
        written = np.array([float(row[f"simulated_{name}"]) for row in rows])
        np.testing.assert_array_equal(written, result.simulated[name])


def test_an_unknown_plant_and_a_missing_run_are_told(call: Call, tmp_path: Path) -> None:
    write_csv(a_run(the_rig()), tmp_path / "a.csv")
    code, _, err = call(ROOT / "configs" / "surgical_tool.yaml", "--like", tmp_path / "a.csv")
    assert (code, "has no value, but one is needed here" in err) == (2, True)
    code, _, err = call(ROOT / "configs" / "realistic.yaml", "--like", tmp_path / "none.csv")
    assert (code, "no such file or folder" in err) == (2, True)
