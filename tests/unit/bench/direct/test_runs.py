"""Runs without the bus: compiled and ahead of the gate, or sample by sample, to the last bit the same."""

from pathlib import Path

import numpy as np
import pytest

from hil_forceps.bench.assembly import Rigs, rigs_for
from hil_forceps.bench.direct import run_ahead
from hil_forceps.bench.direct.runs import STOP_CHECK_SAMPLES, DirectRun, run_direct
from hil_forceps.bench.execute import rig_for
from hil_forceps.bench.matrix import RunSpec
from hil_forceps.rig import load_rig
from virtual_bus.direct import DirectWorld

CONFIGS = Path(__file__).parents[4] / "configs"
PERIOD_S = 1e-4
DURATION_S = 0.15


def prepared(
    config: str, algorithm: str, changes: dict[str, float] | None = None, *, compensated: bool = True
) -> tuple[RunSpec, Rigs]:
    spec = RunSpec(2, algorithm, compensated, PERIOD_S, False, DURATION_S)
    return spec, rigs_for(spec, rig_for(spec, load_rig(CONFIGS / f"{config}.yaml")).with_changes(changes or {}), None)


def both(spec: RunSpec, rigs: Rigs) -> tuple[DirectRun, DirectRun]:
    ahead, plain = (
        run_direct(DirectWorld(rigs.plant, 2, 7), spec, rigs, lambda: False, ahead=each) for each in (True, False)
    )
    return ahead, plain


@pytest.fixture
def blocks(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Where each block began."""
    began: list[int] = []
    original = run_ahead.Ahead.block

    def block(self: run_ahead.Ahead, first: int, reference_rad: float) -> run_ahead.Vector:
        began.append(first)
        return original(self, first, reference_rad)

    monkeypatch.setattr(run_ahead.Ahead, "block", block)
    return began


@pytest.mark.parametrize("compensated", [True, False])
@pytest.mark.parametrize("config", ["paper", "realistic"])
def test_what_runs_ahead_gives_the_same_bits(blocks: list[int], config: str, compensated: bool) -> None:
    spec, rigs = prepared(config, "kalman", compensated=compensated)
    ahead, plain = both(spec, rigs)
    assert len(plain.rows) == round(DURATION_S / PERIOD_S) + 1
    np.testing.assert_array_equal(ahead.rows, plain.rows)
    assert ahead.ending == plain.ending == "completed"
    assert 1 < len(blocks) < 0.1 * len(plain.rows)


def test_a_reference_that_the_gate_changes_is_gone_on_from(blocks: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_ahead.Ahead, "pays", lambda _self, _samples: True)
    spec, rigs = prepared("realistic", "improved")
    ahead, plain = both(spec, rigs)
    np.testing.assert_array_equal(ahead.rows, plain.rows)
    assert 0.1 * len(plain.rows) < len(blocks) < len(plain.rows)


def test_where_the_gate_changes_many_the_plain_loop_takes_over(blocks: list[int]) -> None:
    spec, rigs = prepared("realistic", "improved")
    ahead, plain = both(spec, rigs)
    np.testing.assert_array_equal(ahead.rows, plain.rows)
    assert 0 < len(blocks) < run_ahead.TRIAL_SAMPLES / run_ahead.MIN_MEAN_BLOCK_SAMPLES + 0.1 * len(plain.rows)
    assert blocks[-1] < len(plain.rows) // 2


def test_a_denied_reference_ends_both_alike() -> None:
    spec, rigs = prepared("paper", "kalman", {"limits.current_max_A": 1e-9})
    ahead, plain = both(spec, rigs)
    assert "the gate denied the reference at" in plain.ending
    assert ahead.ending == plain.ending
    np.testing.assert_array_equal(ahead.rows, plain.rows)


def test_a_request_to_stop_is_seen_as_soon() -> None:
    spec, rigs = prepared("paper", "improved")
    ended = []
    for ahead in (True, False):
        asked = iter([False, True])
        run = run_direct(DirectWorld(rigs.plant, 2, 7), spec, rigs, lambda asked=asked: next(asked), ahead=ahead)  # type: ignore[misc]
        ended.append((len(run.rows), run.ending))
    assert ended == [(STOP_CHECK_SAMPLES + 1, "stopped on request")] * 2


def test_a_world_with_effects_has_no_such_kernel() -> None:
    _, rigs = prepared("paper", "improved")
    changed = rigs.plant.model_copy(update={"effects": {"wire_damping": {"damping_N_s_per_m": 1.0}}})
    assert DirectWorld(changed, 2, 7).compiled() is None
    assert DirectWorld(rigs.plant, 2, 7).compiled() is not None
