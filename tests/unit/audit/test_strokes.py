"""Counts and play of a gear and zeros of torques: told from the data, hidden by breaking the data."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.audit.audit import audit
from hil_forceps.audit.finding import Finding
from hil_forceps.data.readers.surgical_tool.reader import read_surgical_tool
from hil_forceps.data.run import Run
from tests.unit.audit.told_numbers import tells

Columns = dict[str, NDArray[np.float64]]
DATA = Path(os.environ.get("HIL_FORCEPS_DATA", Path(__file__).parents[4] / "shared" / "data"))
INSTRUMENT = DATA / "surgical_tool" / "Tool_4_Maryland_R_5.zip"
TIME = np.arange(10_000) * 1e-3
PLAY = 0.03
KINDS = {"gear_counts", "gear_play", "zero"}


def behind(drive: NDArray[np.float64]) -> NDArray[np.float64]:
    """What follows through play: it stays until it is pushed."""
    at, angles = float(drive[0]), np.empty(drive.size)
    for n, angle in enumerate(drive.tolist()):
        at = min(max(at, angle - 0.5 * PLAY), angle + 0.5 * PLAY)
        angles[n] = at
    return angles


def strokes(level: int, frequency_Hz: float = 0.4) -> Columns:
    """A spindle behind a gear with play, driven there and back against a load, with friction."""
    rng = np.random.default_rng(level)
    phase = 2.0 * np.pi * frequency_Hz * TIME
    drive, way = 0.27 + (0.5 + 0.5 * PLAY) * np.sin(phase), np.tanh(30.0 * np.cos(phase))
    spindle = -0.77 + behind(drive)
    load = 0.02 * (level + 1) + 0.003 * way
    return {
        "time_s": TIME,
        "theta_m_rad": np.round(spindle * 8192 / 2 / np.pi) * 2 * np.pi / 8192,
        "theta_drive_rad": drive,
        "tau_m_N_m": 1.1 * load + 0.05 * way + 1e-3 * rng.standard_normal(TIME.size),
        "theta_j_rad": 1.3 + 0.9 * spindle - 0.5 * load + 1e-4 * rng.standard_normal(TIME.size),
        "tau_w_N_m": load + 1e-4 * rng.standard_normal(TIME.size),
    }


def found(change: Callable[[Columns], Columns], count: int = 5) -> dict[str, Finding]:
    runs = [Run(str(level), change(strokes(level))) for level in range(count)]
    return {finding.kind: finding for finding in audit(runs, None) if finding.kind in KINDS}


def scaled(channel: str, factor: float) -> Callable[[Columns], Columns]:
    return lambda columns: columns | {channel: factor * columns[channel]}


def offset(channel: str, by: float) -> Callable[[Columns], Columns]:
    return lambda columns: columns | {channel: columns[channel] + by}


def test_a_gear_that_fits_is_a_note_with_its_play() -> None:
    told = found(dict)
    assert {kind: finding.severity for kind, finding in told.items()} == {"gear_counts": "note", "gear_play": "note"}
    assert tells(told["gear_counts"].text, pytest.approx(1.0, abs=2e-3))
    assert tells(told["gear_play"].text, pytest.approx(PLAY, rel=0.02))


@pytest.mark.parametrize("factor", [4096 / 4196, 4196 / 4096, 0.5])
def test_wrong_counts_of_the_motor_s_encoder_are_found(factor: float) -> None:
    told = found(scaled("theta_drive_rad", factor))["gear_counts"]
    assert told.severity == "warning"
    assert tells(told.text, pytest.approx(factor, rel=4e-3))


@pytest.mark.parametrize(
    ("channel", "by", "zero"), [("tau_m_N_m", -0.015, -0.015), ("tau_w_N_m", 0.01, -0.011), ("tau_m_N_m", 0.004, 0.004)]
)
def test_a_zero_that_is_off_is_found(channel: str, by: float, zero: float) -> None:
    told = found(offset(channel, by))["zero"]
    assert (told.severity, told.channel) == ("warning", "tau_m_N_m")
    assert tells(told.text, pytest.approx(zero, abs=5e-4))
    assert tells(told.text, pytest.approx(-zero / 1.1, abs=5e-4))


def test_too_few_loads_one_load_or_none_tell_no_zero() -> None:
    assert "zero" not in found(offset("tau_m_N_m", 0.1), count=3)
    assert "zero" not in found(lambda c: c | {"tau_w_N_m": np.full(TIME.size, 0.1)})
    noisy = np.random.default_rng(0)
    assert "zero" not in found(lambda c: c | {"tau_m_N_m": c["tau_m_N_m"] + noisy.normal(0.0, 0.5)})
    assert found(lambda c: {n: v for n, v in c.items() if n not in {"tau_w_N_m", "theta_drive_rad"}}) == {}
    assert found(lambda c: c | {"theta_m_rad": np.zeros(TIME.size)}) == {}


@pytest.mark.skipif(not INSTRUMENT.exists(), reason=f"measured data are not at {INSTRUMENT}")
@pytest.mark.parametrize("counts", [4096, 4196])
def test_measured_runs_tell_4096_counts_from_4196(counts: int) -> None:
    runs = []
    for run in read_surgical_tool(INSTRUMENT):
        columns = dict(run.columns) | {"theta_drive_rad": run.columns["theta_drive_rad"] * 4096 / counts}
        runs.append(Run(run.name, columns))
    told = {finding.kind: finding for finding in audit(runs, None) if finding.kind in KINDS}
    assert told["gear_counts"].severity == ("note" if counts == 4096 else "warning")
    assert told["zero"].channel in {"tau_m_N_m", "current_A"}
    assert tells(told["gear_play"].text, pytest.approx(0.0275, abs=0.0225))  # between 5 and 50 mrad
