"""The surgical-tool text format: signs and scales, where files are found, and what is refused with which words."""

import io
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hil_forceps.data.readers.surgical_tool import files as surgical_files
from hil_forceps.data.readers.surgical_tool.reader import CHANNELS, iter_surgical_tool, read_surgical_tool
from hil_forceps.rig import UserError

HEADER = "%This header is wrong: right spindle, 9.9 Hz, milliseconds\n%a,b,c\n"


def sample_lines(side: str = "left", count: int = 300) -> list[str]:
    """Write a motion of the format: the jaw closes at 1 rad/s against 0.1 N m; counts as the sensors give them."""
    sign = 1 if side == "left" else -1
    lines = []
    for index in range(count):
        time_s = index * 1e-3
        spindle = sign * (1000 - time_s * 8192 / (2 * np.pi))
        jaw = sign * (200 + 0.875 * time_s * 4000 / (2 * np.pi))
        torque, load = sign * 0.15 / 3.9811e-5, -sign * 0.1 / 3.9811e-5
        motor = -spindle * 4096 * 35 / 8192
        cells = [spindle, torque, sign * 0.25, jaw, load, 0.3, -0.01, motor, spindle]
        lines.append(f"{time_s:.3f}," + ",".join(f"{cell:.4f}" for cell in cells))
    return lines


def text(side: str = "left", count: int = 300) -> str:
    return HEADER + "\n".join(sample_lines(side, count)) + "\n"


def zipped(path: Path, files: dict[str, bytes | str]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


@pytest.mark.parametrize("side", ["left", "right"])
def test_both_jaws_come_out_with_the_same_signs(side: str, tmp_path: Path) -> None:
    (tmp_path / "23.TXT").write_text(text(side))
    (run,) = read_surgical_tool(tmp_path)
    assert run.name == "23"
    assert run.notes == (f"{side} jaw", "jaw brake command 0.30 A")
    time_s = run.columns["time_s"]
    np.testing.assert_allclose(time_s, np.arange(300) * 1e-3)
    np.testing.assert_allclose(run.columns["theta_m_rad"] - run.columns["theta_m_rad"][0], time_s, atol=1e-6)
    np.testing.assert_allclose(run.columns["theta_j_rad"] - run.columns["theta_j_rad"][0], 0.875 * time_s, atol=1e-6)
    np.testing.assert_allclose(run.columns["tau_m_N_m"], 0.15, rtol=1e-6)
    np.testing.assert_allclose(run.columns["current_A"], 0.25)
    np.testing.assert_allclose(run.columns["tau_w_N_m"], 0.1, rtol=1e-6)
    np.testing.assert_allclose(run.columns["theta_m_ref_rad"], run.columns["theta_m_rad"])


def test_every_column_of_a_run_comes_from_one_channel() -> None:
    assert len({channel.position for channel in CHANNELS}) == len(CHANNELS) == len({c.column for c in CHANNELS})


def test_folder_nested_folder_and_zip_give_the_same_runs(tmp_path: Path) -> None:
    home = tmp_path / "tool" / "tool"
    home.mkdir(parents=True)
    for name in ("12.TXT", "00.txt"):
        (home / name).write_text(text())
    for other in ("SerialLog.txt", "123.TXT", "1.TXT", "12.TXT.bak"):
        (home / other).write_text("not for us")
    packed = zipped(tmp_path / "tool.zip", {f"deep/er/tool/{file.name}": file.read_bytes() for file in home.iterdir()})
    names = [[run.name for run in iter_surgical_tool(path)] for path in (home, home.parent, packed)]
    assert names == [["00", "12"]] * 3
    first, again = (next(iter_surgical_tool(path)) for path in (home, packed))
    assert first.columns["tau_w_N_m"].tobytes() == again.columns["tau_w_N_m"].tobytes()


def test_line_endings_of_windows_are_no_matter(tmp_path: Path) -> None:
    (tmp_path / "00.TXT").write_bytes(text().replace("\n", "\r\n").encode())
    assert len(read_surgical_tool(tmp_path)[0]) == 300


def replaced(line: int, change: Callable[[str], str]) -> str:
    lines = text().split("\n")
    lines[line - 1] = change(lines[line - 1])
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", ": 0 samples; a run has at least 100"),
        (HEADER, ": 0 samples"),
        (text(count=20), ": 20 samples"),
        (text()[:-30] + "\n", ":302: 7 columns, but the format has 10"),
        (replaced(5, lambda line: line + ",7"), ":5: 11 columns"),
        (replaced(9, lambda _: "Dear reader"), ":9: 1 columns"),
        (replaced(9, lambda line: line.replace("0.3000", "0.3O00")), ":9: column 7: '0.3O00' is not a number"),
        (replaced(9, lambda line: line.replace("0.3000", "nan")), ":9: column 7: not a finite number"),
        (replaced(9, lambda line: "0.001" + line[5:]), ":9: column 1: time does not increase"),
        (text().replace("0.00", "0.0"), "column 1"),
        ("\x00\xff", ": 0 samples; a run has at least 100; line 1 contains zero bytes"),
        (HEADER + "é" * 9 + "\n", ":3: not a text file"),
    ],
)
def test_a_bad_file_is_refused_with_its_line(content: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "00.TXT"
    path.write_bytes(content.encode("latin-1"))
    with pytest.raises(UserError) as caught:
        read_surgical_tool(tmp_path)
    assert str(path) in str(caught.value)
    assert message in str(caught.value)


@pytest.mark.parametrize(("end", "told"), [("", "has no line end"), ("\0" * 4096, "contains zero bytes")])
def test_a_file_that_was_cut_off_gives_its_whole_lines(end: str, told: str, tmp_path: Path) -> None:
    (tmp_path / "00.TXT").write_text(text()[:-2] + end)
    (run,) = read_surgical_tool(tmp_path)
    assert len(run) == 299
    assert [note for note in run.notes if told in note and note.startswith("line 302")]


def test_milliseconds_in_the_time_column_are_noticed(tmp_path: Path) -> None:
    rows = [f"{index}," + line.split(",", 1)[1] for index, line in enumerate(sample_lines())]
    (tmp_path / "00.TXT").write_text("\n".join(rows))
    with pytest.raises(UserError, match="samples are 1 apart; expected seconds"):
        read_surgical_tool(tmp_path)


def test_left_and_right_in_one_set_are_refused(tmp_path: Path) -> None:
    (tmp_path / "00.TXT").write_text(text("left"))
    (tmp_path / "01.TXT").write_text(text("right"))
    with pytest.raises(UserError, match=r"01\.TXT: a right jaw in one data set with .*00\.TXT, a left jaw"):
        read_surgical_tool(tmp_path)


def test_paths_that_hold_no_data_set(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="No such file"):
        read_surgical_tool(tmp_path / "none")
    with pytest.raises(UserError, match="contains no run"):
        read_surgical_tool(tmp_path)
    (tmp_path / "note.txt").write_text("hello")
    with pytest.raises(UserError, match="neither a folder nor a valid zip"):
        read_surgical_tool(tmp_path / "note.txt")
    with pytest.raises(UserError, match="contains no run"):
        read_surgical_tool(zipped(tmp_path / "empty.zip", {"readme.txt": "x"}))
    two = zipped(tmp_path / "two.zip", {"a/00.TXT": text(), "b/00.TXT": text()})
    with pytest.raises(UserError, match=r"contains several data sets \(a, b\)"):
        read_surgical_tool(two)


def test_a_bomb_is_not_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(surgical_files, "MAX_FILE_BYTES", 1 << 16)
    bomb = zipped(tmp_path / "bomb.zip", {"00.TXT": b"0" * (1 << 20)})
    with pytest.raises(UserError, match=r"bomb\.zip!00\.TXT: larger than"):
        read_surgical_tool(bomb)
    (tmp_path / "00.TXT").write_bytes(b"0" * (1 << 17))
    with pytest.raises(UserError, match=r"00\.TXT: larger than"):
        read_surgical_tool(tmp_path)


def test_a_zip_that_lies_about_its_sizes_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(surgical_files, "MAX_FILE_BYTES", 1 << 16)
    honest = zipped(tmp_path / "lie.zip", {"00.TXT": b"0" * (1 << 20)}).read_bytes()
    size = (1 << 20).to_bytes(4, "little")
    assert honest.count(size) == 2
    (tmp_path / "lie.zip").write_bytes(honest.replace(size, (100).to_bytes(4, "little")))
    with pytest.raises(UserError, match=r"lie\.zip!00\.TXT"):
        read_surgical_tool(tmp_path / "lie.zip")


def test_many_entries_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "many.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for index in range(surgical_files.MAX_ZIP_ENTRIES + 1):
            archive.writestr(f"{index}.dat", "")
    with pytest.raises(UserError, match="entries"):
        read_surgical_tool(path)


def test_damaged_zips_are_refused_whatever_is_damaged(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("00.TXT", text())
    whole = buffer.getvalue()
    generator = np.random.default_rng(7)
    path = tmp_path / "damaged.zip"
    refused = 0
    for _ in range(200):
        damaged = bytearray(whole)
        for position in generator.integers(0, len(whole), 3):
            damaged[position] ^= int(generator.integers(1, 256))
        path.write_bytes(damaged[: generator.integers(1, len(whole) + 1)] if generator.random() < 0.3 else damaged)
        try:
            read_surgical_tool(path)
        except UserError:
            refused += 1
    assert refused > 150  # and nothing but UserError came out
