"""Long runs are diagnosed in excerpts that are spread over them, and it is said which share that is."""

import numpy as np
import pytest

from hil_forceps.data.even_rows import EvenRun
from hil_forceps.data.run import Run
from hil_forceps.diagnosis.evidence import pass_all
from hil_forceps.diagnosis.options import Options
from hil_forceps.diagnosis.preparation import excerpts as taking
from hil_forceps.diagnosis.preparation.excerpts import excerpts
from hil_forceps.diagnosis.preparation.records import record_of
from hil_forceps.diagnosis.state_space.layout import JAW, Noise
from hil_forceps.diagnosis.validation.conclusion import conclude
from hil_forceps.model import parameters
from tests.hidden_effects.generator import RIG, true_rig
from tests.unit.diagnosis.simulated_runs import POOL, runs_of


def run_of(rows: int, name: str) -> EvenRun:
    time_s = 5.0 + 1e-3 * np.arange(rows, dtype=np.float64)
    nothing = np.zeros(rows)
    columns = {"time_s": time_s, "theta_m_rad": nothing, "current_A": nothing, "theta_j_rad": nothing}
    return EvenRun.whole(Run(name, columns))


def test_short_runs_are_taken_whole_and_nothing_is_said() -> None:
    runs = [run_of(50_000, "a"), run_of(60_000, "b")]
    assert excerpts(runs) == (runs, [])


def test_a_long_run_leaves_room_for_short_ones_and_is_taken_from_end_to_end() -> None:
    short, long = run_of(20_000, "short"), run_of(1_000_000, "long")
    found, said = excerpts([long, short])
    assert found[-1] is short
    parts = found[:-1]
    assert sum(part.lost.size for part in found) <= taking.MAX_ROWS
    assert sum(part.lost.size for part in found) > 0.9 * taking.MAX_ROWS
    assert {part.of for part in parts} == {"long"}
    assert len({part.name for part in parts}) == len(parts)
    assert parts[0].begin_s == 0.0
    assert parts[-1].run.columns["time_s"][-1] == long.run.columns["time_s"][-1]
    for part in parts:
        first = float(part.run.columns["time_s"][0] - long.run.columns["time_s"][0])
        assert part.begin_s == pytest.approx(first)
    (note,) = said
    assert (note.kind, note.severity, note.run) == ("excerpts", "note", "long")
    assert "10 %" in note.text


def test_what_drifts_does_so_since_the_start_of_the_run() -> None:
    drifting = {"torque_constant_drift": {"relative_change": 0.2, "time_constant_s": 4.0}}
    true = true_rig(RIG, drifting, {})
    (run,) = runs_of(true, ("multisine",), 7600)
    second = {name: values[6000:] for name, values in run.columns.items()}
    part = EvenRun.whole(Run("second half", second))
    noise = Noise(np.array([RIG.noise.theta_j_rad, RIG.noise.tau_w_N_m, RIG.noise.current_A]), np.zeros(3), np.zeros(3))
    misfits = []
    for begin_s in (6.0, 0.0):
        record = record_of(part._replace(begin_s=begin_s), true, noise)
        (passed,) = pass_all([record], parameters.vector(true), POOL.map).runs
        misfits.append(float(np.mean(passed.residual[passed.counts[:, JAW], JAW] ** 2)))
    assert misfits[0] == pytest.approx(1.0, abs=0.1)
    assert misfits[1] > 1.5


def test_a_run_that_is_to_be_held_out_is_so_in_all_its_excerpts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(taking, "MAX_ROWS", 14_000)
    monkeypatch.setattr(taking, "EXCERPT_ROWS", 3_500)
    runs = runs_of(RIG, ("multisine", "trapezoid"), 7610)
    held = runs[0].name
    diagnosis, _, _ = conclude(
        [EvenRun.whole(run) for run in runs], RIG, (), Options(hold_out=(held,), mapper=POOL.map)
    )
    assert diagnosis.verdict == "consistent"
    assert len(diagnosis.held_out) == 2
    assert all(name.startswith(f"{held} from ") for name in diagnosis.held_out)
