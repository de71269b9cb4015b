"""What `run` records over the virtual bus is what its rig says: the first thing that a user tries."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hil_forceps.cli.main import main

CONFIGS = Path(__file__).parents[3] / "configs"
REALISTIC, PAPER = CONFIGS / "realistic.yaml", CONFIGS / "paper.yaml"


def called(*arguments: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main(list(arguments))
    assert isinstance(ended.value.code, int)
    return ended.value.code


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    made: dict[tuple[Path, tuple[str, ...]], Path] = {}

    def run(rig: Path, *more: str) -> Path:
        if (rig, more) not in made:
            out = tmp_path_factory.mktemp(rig.stem)
            channel = ("--interface", "virtual_forceps", "--channel", f"recording{len(made)}", "--option", f"rig={rig}")
            assert called("run", "--rig", str(rig), *channel, *more, "--out", str(out)) == 0
            made[rig, more] = out / "run.mcap"
        return made[rig, more]

    return run


def diagnosed(recording: Path, rig: Path, out: Path, *more: str) -> dict[str, Any]:
    assert called("diagnose", str(recording), "--rig", str(rig), "--out", str(out), "--jobs", "1", *more) == 0
    told: dict[str, Any] = json.loads((out / "diagnosis.json").read_text())
    return told


@pytest.mark.parametrize("rig", [REALISTIC, pytest.param(PAPER, marks=pytest.mark.long)])
def test_an_unchanged_rig_is_consistent(record: Callable[..., Path], rig: Path, tmp_path: Path) -> None:
    told = diagnosed(record(rig), rig, tmp_path)
    assert told["verdict"] == "consistent", told["sentence"]


def test_a_stiffness_that_is_off_is_found(
    record: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(REALISTIC.read_text().replace("wire_stiffness_N_per_m: 2.6e4", "wire_stiffness_N_per_m: 2.0e4"))
    told = diagnosed(record(REALISTIC), wrong, tmp_path / "out")
    assert told["verdict"] == "parameters"
    assert list(told["parameter_shifts"]) == ["forceps.wire_stiffness_N_per_m"]
    shift = told["parameter_shifts"]["forceps.wire_stiffness_N_per_m"]
    low, high = shift["ci95"]
    assert low < 2.6e4 < high
    assert high - low < 0.01 * 2.6e4
    # Terminal, JSON and the extended rig say the same number.
    assert f"-> {shift['fitted']:.4g} [{low:.4g}, {high:.4g}]" in capsys.readouterr().out
    assert f"wire_stiffness_N_per_m: {shift['fitted']:.10g}"[:30] in (tmp_path / "out" / "extended.yaml").read_text()


def test_a_spent_budget_says_what_was_not_looked_at(
    record: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = diagnosed(record(REALISTIC), REALISTIC, tmp_path, "--budget", "0.001")
    assert told["verdict"] == "undetermined"
    assert told["reasons"] == [
        "the time limit was reached before this was tested: the catalogue beside the known parameters"
    ]
    assert told["next_experiment"] is None
    # Not on a terminal: a line before anything is computed, and one for each step.
    lines = capsys.readouterr().err.splitlines()
    first_s, last_s = (int(line.split()[0]) for line in (lines[0], lines[-1]))
    assert first_s <= max(2, last_s // 10)  # on a machine that is busy all of it takes longer
    assert "fitting" not in lines[0]
    assert any("fitting the known parameters" in line for line in lines[1:])


@pytest.mark.long
def test_lost_frames_are_no_cause(record: Callable[..., Path], tmp_path: Path) -> None:
    """One feedback in 200 is lost; the drive samples twice a row, and its clock is 50 ppm off."""
    faults = tmp_path / "faults.yaml"
    faults.write_text(
        "- {fault: drop, function: FEEDBACK, direction: to_host, from_s: 0.5, to_s: 25.0, probability: 0.005}\n"
    )
    told = diagnosed(record(REALISTIC, "--option", f"faults={faults}"), REALISTIC, tmp_path / "out")
    assert told["verdict"] == "consistent", told["sentence"]
    texts = [finding["text"] for finding in told["data_audit"]]
    assert any("samples missing" in text for text in texts)
    assert not any("no motion" in text or "does not follow" in text for text in texts)
