"""`recover`: what is there, what is missing and from when to when, and a sound recording that holds nothing else."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil_forceps.cli import main as cli
from hil_forceps.data.readers.read_run import read_run
from hil_forceps.data.recording.reader import Recording, read_recording

CONFIGS = Path(__file__).parents[4] / "configs"
PAPER, ODRIVE = CONFIGS / "paper.yaml", CONFIGS / "drives" / "odrive.yaml"


def command(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        cli.main([str(each) for each in arguments])
    return int(ended.value.code or 0)


def a_run(folder: Path, rig: Path, *more: str) -> Path:
    line = ("--interface", "virtual_forceps", "--channel", folder, "--option", f"rig={rig}", "--duration", "1.5")
    assert command("run", "--rig", rig, *line, "--out", folder / "out", *more) == 0
    return folder / "out"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return a_run(tmp_path_factory.mktemp("native"), PAPER, "--option", "simulation=2")


def damaged(tmp_path: Path, whole: Path, change: Any, *, with_log: bool = True) -> Path:
    """Copy a run with its recording's bytes changed."""
    folder = tmp_path / "damaged"
    folder.mkdir()
    data = bytearray((whole / "run.mcap").read_bytes())
    (folder / "run.mcap").write_bytes(change(data))
    if with_log:
        (folder / "bus.log").write_bytes((whole / "bus.log").read_bytes())
    return folder


def told(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, dict[str, Any]]:
    capsys.readouterr()
    code = command("recover", *arguments, "--json")
    content: dict[str, Any] = json.loads(capsys.readouterr().out)
    return code, content


def recovered(folder: Path) -> Recording:
    return read_recording(folder / "recovered" / "run.mcap")


def flip(place: int) -> Any:
    def change(data: bytearray) -> bytearray:
        data[place] ^= 0x10
        return data

    return change


def assert_same_samples(found: Recording, original: Recording, count: int) -> None:
    """Everything to the last bit but the arrival, which the log rounds to a microsecond."""
    assert len(found.samples) == count
    for name in original.samples.dtype.names or ():
        if name == "received_ns":
            assert np.abs(found.samples[name] - original.samples[name][:count]).max() <= 1000
        else:
            assert found.samples[name].tobytes() == original.samples[name][:count].tobytes(), name


def test_a_sound_recording_is_left_alone(whole: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, said = told(capsys, whole)
    assert (code, said["sound"], said["whole"], said["written"]) == (0, True, True, None)
    assert said["rows"]["/sample"] == len(read_recording(whole / "run.mcap").samples)
    assert not (whole / "recovered").exists()


def test_what_a_cut_took_away_comes_back_from_the_bus_log(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    original = read_recording(whole / "run.mcap")
    folder = damaged(tmp_path, whole, lambda data: data[: len(data) // 2])
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    code, said = told(capsys, folder)
    there = said["rows"]["/sample"]
    assert code == 1
    assert (said["has_end"], said["whole"], said["lost"]) == (False, False, [])
    (restored,) = said["restored"]
    assert (restored["topic"], restored["first"], restored["last"]) == ("/sample", there, len(original.samples) - 1)
    assert 0 < there < len(original.samples)
    assert_same_samples(recovered(folder), original, len(original.samples))
    assert {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()} == before
    assert command("replay", folder / "recovered") == 1
    said_of_it = capsys.readouterr().out
    assert "incomplete: " in said_of_it
    assert "all identical; recording ended before the run did" in said_of_it
    (run,) = read_run(folder / "recovered" / "run.mcap")
    assert any("samples restored from the bus log, its end is missing" in note for note in run.notes)


def test_a_hole_is_named_by_numbers_times_and_bytes_and_filled(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    original = read_recording(whole / "run.mcap")
    place = (whole / "run.mcap").stat().st_size // 2
    folder = damaged(tmp_path, whole, flip(place))
    code, said = told(capsys, folder)
    assert (code, said["sound"], said["has_end"]) == (1, False, True)
    assert any(each["begin"] <= place < each["end"] for each in said["damage"])
    (restored,) = said["restored"]
    lost = {each["topic"]: each for each in said["lost"]}
    assert set(lost) == {"/reference", "/bench"}
    began_ns = min(original.samples["received_ns"][0], original.references["tick_ns"][0])
    times = (original.samples["received_ns"] - began_ns) / 1e9
    assert restored["from_s"] == pytest.approx(times[restored["first"] - 1], abs=1e-9)
    assert restored["to_s"] == pytest.approx(times[restored["last"] + 1], abs=1e-9)
    found = recovered(folder)
    assert_same_samples(found, original, len(original.samples))
    gone = lost["/reference"]
    kept = np.delete(original.references, slice(gone["first"], gone["last"] + 1))
    assert found.references.tobytes() == kept.tobytes()
    assert found.result == original.result
    (run,) = read_run(folder / "recovered" / "run.mcap")
    assert "theta_m_ref_rad" not in run.columns, "the echo of a lost reference matches none that was sent 256 before"


def test_without_a_bus_log_the_hole_stays(whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place = (whole / "run.mcap").stat().st_size // 2
    folder = damaged(tmp_path, whole, flip(place), with_log=False)
    code, said = told(capsys, folder)
    assert (code, said["restored"], said["bus_log"]) == (1, [], "")
    assert {each["topic"] for each in said["lost"]} == {"/sample", "/reference", "/bench"}
    missing = sum(each["last"] - each["first"] + 1 for each in said["lost"])
    original = read_recording(whole / "run.mcap")
    assert len(recovered(folder).order) == len(original.order) - missing


@pytest.mark.parametrize("part", ["magic", "description", "metadata", "copy", "summary", "end"])
def test_where_only_what_is_said_twice_is_damaged_nothing_is_missing(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], part: str
) -> None:
    data = (whole / "run.mcap").read_bytes()
    place = {
        "magic": 3,
        "description": data.index(b"int64 stamp_ns"),
        "metadata": data.index(b"host_period_s"),
        "copy": data.index(b"host_period_s", data.index(b"hil_forceps.json")),
        "summary": data.rindex(b"int64 stamp_ns"),
        "end": len(data) - 2,
    }[part]
    folder = damaged(tmp_path, whole, flip(place))
    code, said = told(capsys, folder)
    assert (code, said["sound"], said["whole"]) == (0, False, True)
    found, original = recovered(folder), read_recording(whole / "run.mcap")
    assert (found.metadata, found.result) == (original.metadata, original.result)
    assert found.samples.tobytes() == original.samples.tobytes()
    assert found.references.tobytes() == original.references.tobytes()


def test_a_length_that_swallows_chunks_does_not(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = (whole / "run.mcap").read_bytes()
    name = data.index((11).to_bytes(4, "little") + b"hil_forceps", data.index(b"/bench"))
    place = name - 8 + 2  # the length of the record with the metadata: by some 64 KiB longer
    folder = damaged(tmp_path, whole, lambda each: each[:place] + bytes([each[place] + 1]) + each[place + 1 :])
    code, said = told(capsys, folder)
    assert said["rows"]["/sample"] == len(read_recording(whole / "run.mcap").samples)
    assert code == 0


def test_a_file_is_never_written_over(whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = damaged(tmp_path, whole, lambda data: data[: len(data) // 2])
    assert command("recover", folder, "--out", folder / "run.mcap") == 2
    said = capsys.readouterr().err
    assert "run.mcap: already exists with other content; remove it, or name another file with " in said
    assert command("recover", folder, "--out", tmp_path / "new.mcap") == 1
    made = (tmp_path / "new.mcap").read_bytes()
    assert command("recover", folder, "--out", tmp_path / "new.mcap") == 1, "the same again is the same answer"
    assert (tmp_path / "new.mcap").read_bytes() == made
    (tmp_path / "new.mcap").write_bytes(made[:-1])
    assert command("recover", folder, "--out", tmp_path / "new.mcap") == 2
    assert (tmp_path / "new.mcap").read_bytes() == made[:-1]


def test_what_is_no_recording_is_said_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(range(256)) * 20)
    (tmp_path / "empty").mkdir()
    for name, words in (("a.mcap", "not a recording"), ("empty", "contains no run.mcap"), ("none", "no such file")):
        assert command("recover", tmp_path / name) == 2
        said = capsys.readouterr().err
        assert words in said
        assert said.count("\n") == 1


def test_a_maker_s_samples_are_not_made_up(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = a_run(tmp_path, ODRIVE)
    folder = damaged(tmp_path, out, lambda data: data[: len(data) // 2])
    code, said = told(capsys, folder)
    assert (code, said["restored"]) == (1, [])
    assert any("samples of a drive with the profile odrive can't be restored" in note for note in said["notes"])
    assert command("replay", folder / "recovered") == 1, "how it ended is still missing"
