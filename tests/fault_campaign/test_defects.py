"""Deliberate defects are each caught within some seeds, by an invariant that they break; without them it holds."""

from pathlib import Path

import pytest

from tests.fault_campaign import campaign
from tests.fault_campaign.defects import DEFECTS
from tests.fault_campaign.defects.hunt import hunt
from tests.fault_campaign.invariants import INVARIANTS
from tests.fault_campaign.schedule import from_json

MOST_SEEDS = 80  # the slowest to be caught takes half of it (docs/decisions/0018-fault-campaign.md)
SHORT = (
    "gate_without_bounds", "gate_never_closes", "a_sample_serves_twice", "what_was_refused_is_sent_later",
    "the_last_chunk_is_forgotten", "the_file_has_the_date_in_it", "drive_without_watchdog", "moteus_is_enabled_at_zero",
    "moteus_trusts_an_old_answer", "adapter_bundles_frames",
)  # fmt: skip


def check(name: str) -> None:
    caught = hunt(DEFECTS[name], MOST_SEEDS)
    assert caught is not None, f"not caught in {MOST_SEEDS} seeds: {DEFECTS[name].plant.__doc__}"
    assert campaign.judge(caught.schedule, again=True).findings == (), "it fails without the defect, too"


@pytest.mark.parametrize("name", SHORT)
def test_a_defect_is_caught(name: str) -> None:
    check(name)


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(set(DEFECTS) - set(SHORT)))
def test_every_defect_is_caught(name: str) -> None:
    check(name)


def test_there_are_defects_of_every_invariant() -> None:
    assert len(DEFECTS) >= 30
    looked_for = set().union(*(defect.caught_by for defect in DEFECTS.values()))
    assert looked_for == {*INVARIANTS, "same bytes"}
    assert all(defect.plant.__doc__ for defect in DEFECTS.values())


def test_a_failing_seed_is_told_shrunk_and_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    DEFECTS["drive_without_watchdog"].plant(monkeypatch)
    caught = next(seed for seed in range(0, 900, 9) if campaign.judge_seed(seed).findings)
    assert campaign.main(["1", "--seed", str(caught), "--jobs", "1", "--out", str(tmp_path)]) == 1
    told = capsys.readouterr().out
    assert f"--replay {caught}" in told
    assert "torque: torque 21." in told
    path = tmp_path / f"seed-{caught}.json"
    least = from_json(path.read_text())
    assert len(least.faults) == 1
    assert campaign.main(["--schedule", str(path), "--out", str(tmp_path)]) == 1
    assert campaign.main(["--replay", str(caught), "--out", str(tmp_path)]) == 1
    monkeypatch.undo()
    assert campaign.main(["--schedule", str(path), "--out", str(tmp_path)]) == 0
    assert "all invariants hold" in capsys.readouterr().out
