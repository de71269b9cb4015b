"""The campaign: no seed finds anything. 45 in `make test`, over 500 behind it; `make campaign N=10000` at night."""

import json
from pathlib import Path

import pytest

from tests.fault_campaign import campaign
from tests.fault_campaign.rigs import PROFILES
from tests.fault_campaign.schedule import Kind, draw, from_json

BLOCK = 54
BLOCKS = 10  # of seeds, in CI
SHORT = 5 * len(PROFILES)
FOUND = Path(__file__).parent / "found"


def test_the_first_seeds_find_nothing() -> None:
    verdicts = [campaign.judge_seed(seed) for seed in range(SHORT)]
    assert {verdict.profile for verdict in verdicts} == set(PROFILES)
    assert [verdict for verdict in verdicts if verdict.findings] == []


def test_ci_runs_more_than_five_hundred_seeds() -> None:
    assert BLOCK * BLOCKS >= 500
    schedules = [draw(seed) for seed in range(BLOCK * BLOCKS)]
    assert {fault.kind for schedule in schedules for fault in schedule.faults} == set(Kind)
    alone = {schedule.faults[0].kind for schedule in schedules if len(schedule.faults) == 1}
    assert len(alone) >= len(Kind) - 2, "singly, too"


@pytest.mark.long
@pytest.mark.parametrize("block", range(BLOCKS))
def test_seeds_find_nothing(block: int) -> None:
    verdicts = [campaign.judge_seed(seed) for seed in range(block * BLOCK, (block + 1) * BLOCK)]
    assert len(verdicts) == BLOCK
    assert [verdict for verdict in verdicts if verdict.findings] == []


@pytest.mark.parametrize("path", sorted(FOUND.glob("*.json")), ids=lambda path: path.stem)
def test_what_was_found_once_stays_mended(path: Path) -> None:
    assert campaign.judge(from_json(path.read_text(encoding="utf-8"))).findings == ()


def test_the_command_counts_kinds_and_ends(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert campaign.main(["9", "--jobs", "1", "--out", str(tmp_path)]) == 0
    counts = json.loads((tmp_path / "summary.json").read_text())
    assert (counts["runs"], counts["failed"], counts["seeds"], counts["made_twice"]) == (9, [], [0, 8], 2)
    assert sum(sum(ends.values()) for ends in counts["ends"].values()) == 9
    assert sum(counts["faults"]["drop"].values()) == sum(bool(draw(seed).of_kind(Kind.DROP)) for seed in range(9))
    assert "9 runs, 2 of them twice: 0 failed" in capsys.readouterr().out
