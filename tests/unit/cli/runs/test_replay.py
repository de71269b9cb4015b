"""`replay` of recordings: what is missing can't be identical, and what is no recording is told with what was meant."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hil_forceps.cli import main as cli

PAPER = Path(__file__).parents[4] / "configs" / "paper.yaml"
Change = Callable[[bytes], bytes]


def command(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        cli.main([str(each) for each in arguments])
    return int(ended.value.code or 0)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    line = ("--interface", "virtual_forceps", "--channel", folder, "--option", f"rig={PAPER}", "--duration", "1")
    assert command("run", "--rig", PAPER, *line, "--out", folder / "out") == 0
    return folder / "out"


def flipped(at: Callable[[bytes], int]) -> Change:
    def change(data: bytes) -> bytes:
        place = at(data)
        return data[:place] + bytes([data[place] ^ 0x10]) + data[place + 1 :]

    return change


CHANGES: dict[str, Change] = {
    "cut": lambda data: data[: len(data) // 2],
    "a hole": flipped(lambda data: len(data) // 2),
    "metadata": flipped(lambda data: data.index(b"host_period_s")),
    "summary": flipped(lambda data: data.rindex(b"int64 stamp_ns")),
    "end": flipped(lambda data: len(data) - 2),
}


def test_a_whole_recording_is_identical(whole: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert command("replay", whole) == 0
    assert "all identical; 1001 of them were sent" in capsys.readouterr().out
    assert command("replay", whole, "--json") == 0
    said: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert (said["identical"], said["first_difference"], said["missing_or_damaged"]) == (True, None, [])
    assert (said["sent"], said["references"]) == (1001, 1001 + sum(said["not_sent"].values()))


@pytest.mark.parametrize("name", CHANGES)
def test_what_is_damaged_or_missing_is_never_all_identical(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(CHANGES[name]((whole / "run.mcap").read_bytes()))
    capsys.readouterr()
    assert command("replay", path) == 1
    out = capsys.readouterr().out
    assert out.startswith(f"{path}: incomplete: ")
    assert out.count("\n") == 1
    assert f"hil-forceps recover {path} lists what is missing" in out
    assert command("replay", path, "--json") == 1
    said = json.loads(capsys.readouterr().out)
    assert said["missing_or_damaged"]
    assert not said["identical"]


def test_what_was_recovered_whole_is_identical_again_and_a_hole_stays_one(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, code in (("summary", 0), ("a hole", 1)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "run.mcap").write_bytes(CHANGES[name]((whole / "run.mcap").read_bytes()))
        assert command("recover", tmp_path / name) == code
        capsys.readouterr()
        assert command("replay", tmp_path / name / "recovered") == code
        assert ("all identical" in capsys.readouterr().out) is (code == 0)


def test_another_algorithm_as_json(whole: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert command("replay", whole, "--algorithm", "previous", "--json") == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["algorithm"], "identical" in said) == ("previous", False)
    assert said["tau_w_difference_rms_N_m"] > 0.0
