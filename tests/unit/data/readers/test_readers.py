"""`read_run`: every kind of file is told by what it is, gives the same numbers, and bad ones are refused in words."""

import importlib
import os
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from hil_forceps.data.readers import csv_table
from hil_forceps.data.readers.csv_table import write_csv
from hil_forceps.data.readers.matlab import mat_file
from hil_forceps.data.readers.parquet_table import read_parquet, write_parquet
from hil_forceps.data.readers.read_run import read_run
from hil_forceps.data.readers.tables import packed
from hil_forceps.data.run import Run
from hil_forceps.rig.errors import UserError

pa: Any = importlib.import_module("pyarrow")
pq: Any = importlib.import_module("pyarrow.parquet")

ROOT = Path(__file__).parents[4]
EMPS = Path(os.environ.get("HIL_FORCEPS_DATA", ROOT.parent / "shared" / "data")) / "emps"
COUNT = 200


def a_run(count: int = COUNT, name: str = "a") -> Run:
    time_s = np.arange(count) / 1000
    generator = np.random.default_rng(count)
    return Run(
        name,
        {
            "time_s": time_s,
            "theta_m_ref_rad": np.sin(time_s),
            "theta_m_rad": np.sin(time_s) + 1e-3 * generator.normal(size=count),
            "current_A": generator.normal(size=count),
        },
    )


def same(left: Run, right: Run) -> bool:
    return left.columns.keys() == right.columns.keys() and all(
        left.columns[name].tobytes() == right.columns[name].tobytes() for name in left.columns
    )


def problem_of(path: Path, content: bytes | str) -> str:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(UserError) as caught:
        read_run(path)
    assert all(problem.startswith(str(path)) for problem in caught.value.problems)
    return "\n".join(caught.value.problems)


def emps_variables(count: int = COUNT) -> dict[str, object]:
    time_s = np.arange(count) / 1000
    return {
        "t": time_s[:, None],
        "qg": 0.2 * np.sin(time_s)[:, None],
        "qm": 0.199 * np.sin(time_s)[:, None],
        "vir": np.cos(time_s)[:, None],
        "gtau": 35.15,
        "kp": 160.18,
        "kv": 243.45,
    }


@pytest.mark.parametrize(("suffix", "write"), [(".csv", write_csv), (".parquet", write_parquet)])
def test_what_is_written_comes_back(suffix: str, write: Callable[[Run, Path], None], tmp_path: Path) -> None:
    run, path = a_run(), tmp_path / f"a{suffix}"
    write(run, path)
    (again,) = read_run(path)
    assert again.name == "a"
    assert same(run, again)
    disguised = path.rename(tmp_path / "a.dat")
    assert same(read_run(disguised)[0], run)


def test_a_long_csv_is_read_in_blocks_with_the_right_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packed, "PIECE_BYTES", 300)
    run, path = a_run(), tmp_path / "a.csv"
    write_csv(run, path)
    told: list[tuple[int, int]] = []
    assert same(csv_table.read_csv(path, lambda done, total: told.append((done, total))), run)
    assert len(told) > 10
    assert told[-1] == (path.stat().st_size,) * 2
    lines = path.read_text().splitlines()
    lines.insert(50, "# a comment, with, commas\n")
    lines[150] = "0.0001" + lines[150][lines[150].index(",") :]
    assert ":152: time_s: 0.0001 does not come after 0.147" in problem_of(path, "\n".join(lines))
    lines[150] = "0.148,1,?,2"
    assert ":152: column 3 (theta_m_rad): '?' is not a finite number" in problem_of(path, "\n".join(lines))


def test_a_line_that_is_short_in_a_foreign_column_is_refused(tmp_path: Path) -> None:
    head = "time_s,theta_m_rad,current_A,note\n"
    told = problem_of(tmp_path / "a.csv", head + "0,1,2,x\n0.001,1,2\n0.002,1,2,y,z\n")
    assert ":3: 3 cells, but the header has 4 columns" in told


@pytest.mark.parametrize("delimiter", [";", "\t"])
@pytest.mark.parametrize("decimal", [".", ","])
def test_other_delimiters_and_decimal_marks(delimiter: str, decimal: str, tmp_path: Path) -> None:
    run, path = a_run(), tmp_path / "a.csv"
    write_csv(run, path)
    text = path.read_text().replace(",", delimiter).replace(".", decimal)
    path.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    (again,) = read_run(path)
    assert same(run, again)
    assert again.notes == (("decimal commas were converted",) if decimal == "," else ())


def test_rows_written_twice_are_dropped_and_told(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time_s,theta_m_rad,current_A,k\n0,1,2,0\n0.1,1,3,0\n0.1,1,3,1\n0.1,1,3,2\n0.2,1,3,0\n")
    (run,) = read_run(path)
    assert run.columns["time_s"].tolist() == [0, 0.1, 0.2]
    assert f"2 rows repeat the row before and were dropped, the first at {path}:4" in run.notes


HEAD = "time_s,theta_m_rad,current_A\n"
ZEROS = "line 5 contains zero bytes, as after a power cut; it and the rest of the file were left out"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "is empty"),
        ("t,theta_m_rad,current_A\n0,1,2\n", "column time_s is missing; if 't' is it, in SI, name it time_s"),
        ("time_s,theta_m_rad,current\n0,1,2\n", "if 'current' is it, in SI, name it current_A"),
        (HEAD + "0,1,2\n0,1,3\n", ":3: time_s: 0 does not come after 0 (comes twice with different values)"),
        (HEAD + "0.1,1,2\n0,1,2\n", "(time goes back)"),
        (HEAD + "0,1,2\n", "1 samples are too few"),
        (HEAD + "0,1,2\n0,1,2\n", "all 2 rows are identical"),
        (HEAD + "0,1,0,5,2,3\n", "if commas are decimal marks, put semicolons between the cells"),
        (HEAD.replace(",", ";") + "0;1.000,5;2\n", ":2: column 2 (theta_m_rad): '1.000,5' has two decimal marks"),
        (HEAD.encode("utf-16"), ":1: 0 samples are too few"),
        (HEAD.encode("utf-16")[:-1], "begins as UTF-16 but is not valid UTF-16"),
        (HEAD.encode() + b"0,1,2\n0,1,\xff\n", ":3: not a text file (byte 0xff is no UTF-8)"),
        (HEAD + "0,1,1_000\n0.001,1,2\n", ":2: column 3 (current_A): '1_000' is not a finite number"),
        (HEAD + "0,1,\u0663\n0.001,1,2\n", ":2: column 3 (current_A): '\u0663' is not a finite number"),
        (HEAD + "0,1,2\n1,1,2\n2,1,2\n", "rows are 1 s apart"),
        (HEAD + "0,1,2\n1,1,2\n2,1,2\n", "if the stamps are ms, multiply them by 0.001"),
        (HEAD + "0,1,2\n1000,1,2\n2000,1,2\n", "if the stamps are us, multiply them by 1e-06"),
        (HEAD + "1700000000000000000,1,2\n1700000000001000000,1,2\n", "if the stamps are ns, multiply them by 1e-09"),
        (
            HEAD + "0,1,2\n0.001,1,-8.3",
            "2 are needed; line 3, the last, has no line end",
        ),
        (bytes(5000), "zero bytes"),
        (HEAD + "0,1,2\n" + "1" * 100_000 + "," * 5_000_000, "a line of more than"),
    ],
)
def test_a_bad_csv_is_refused_with_place_and_remedy(content: str | bytes, message: str, tmp_path: Path) -> None:
    assert message in problem_of(tmp_path / "bad.csv", content)


@pytest.mark.parametrize(
    ("end", "told"),
    [
        ("0.003,1,-8.3", ("line 5, the last, has no line end and may be cut off: it was left out",)),
        (
            "0.003,1" + "\0" * 500,
            (ZEROS,),
        ),
        (
            "\0" * 10_000_000,
            (ZEROS,),
        ),
        (
            "\0\n0.003,1,2\n",
            (ZEROS,),
        ),
        ("", ()),
        ("# the end", ()),
        ("  ", ()),
    ],
)
def test_a_csv_that_was_cut_off_gives_its_whole_lines(end: str, told: tuple[str, ...], tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(HEAD + "0,1,2\n0.001,1,2\n0.002,1,-8.3e-06\n" + end)
    (run,) = read_run(path)
    assert run.columns["current_A"].tolist() == [2.0, 2.0, -8.3e-06]
    assert run.notes == told


def test_hidden_files_and_tables_of_others_in_a_folder_are_left_out(tmp_path: Path) -> None:
    write_csv(a_run(), tmp_path / "b.csv")
    (tmp_path / "._b.csv").write_bytes(b"\0\5\x16\7" + bytes(100))
    (tmp_path / "shopping.csv").write_text("what,how many\nscrews,100\n")
    (run,) = read_run(tmp_path)
    assert run.notes == (
        "._b.csv was left out: a hidden file",
        "shopping.csv was left out: it has no column of a run",
    )
    (tmp_path / "b.csv").unlink()
    with pytest.raises(UserError, match="none of the columns of a run"):
        read_run(tmp_path)


def test_packed_variables_of_any_size_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mat_file, "MAX_UNPACKED_BYTES", 2000)
    savemat(tmp_path / "a.mat", emps_variables(), do_compression=True)
    assert "variables of more than" in problem_of(tmp_path / "a.mat", (tmp_path / "a.mat").read_bytes())


def test_a_channel_in_another_unit_beside_its_own_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time_s,theta_m_rad,theta_m_deg,current_A\n0,1,57,2\n0.001,1,57,2\n")
    (run,) = read_run(path)
    assert sorted(run.columns) == ["current_A", "theta_m_rad", "time_s"]
    assert run.notes == ("column 'theta_m_deg' is not a column of a run and was left out (did you mean theta_m_rad?)",)


def test_parquet_of_others_is_checked(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    good = {"time_s": [0.0, 0.1, 0.2], "theta_m_rad": [1, 2, 3], "current_A": pa.array([1, 2, 3], pa.float32())}
    pq.write_table(pa.table(good | {"room": ["a", "b", "c"]}), path)
    run = read_parquet(path)
    assert run.columns["theta_m_rad"].tolist() == [1.0, 2.0, 3.0]
    assert run.notes == ("column 'room' is not a column of a run and was left out",)
    for change, message in (
        ({"current_A": ["a", "b", "c"]}, "column current_A contains string, not numbers"),
        ({"current_A": [1.0, None, None]}, ": row 2: current_A is empty or NaN in 2 of 3 rows"),
        ({"current_A": [1.0, 2.0, np.inf]}, ": row 3: current_A is not a finite number"),
        ({"time_s": [0.0, 0.2, 0.1]}, ": row 3: time_s: 0.1 does not come after 0.2"),
    ):
        pq.write_table(pa.table(good | change), path)
        assert message in problem_of(path, path.read_bytes())
    pq.write_table(pa.table({"time_ms": [0.0, 1.0], "theta_m_rad": [1.0, 2.0], "current_A": [1.0, 2.0]}), path)
    assert read_parquet(path).columns["time_s"].tolist() == [0.0, 0.001]
    sparse = {"time_s": [0.0, 0.05, 0.1], "current_A": [1.0, None, 2.0]}
    pq.write_table(pa.table(good | sparse), path)
    assert read_parquet(path).notes[0] == "1 row with empty or NaN cells became gaps (current_A 1)"


def test_emps_keeps_its_numbers_and_says_what_they_are(tmp_path: Path) -> None:
    path = tmp_path / "DATA_EMPS.mat"
    savemat(path, emps_variables())
    (run,) = read_run(path)
    assert sorted(run.columns) == ["tau_m_N_m", "tau_w_N_m", "theta_m_rad", "theta_m_ref_rad", "time_s"]
    time_s = run.columns["time_s"]
    np.testing.assert_array_equal(run.columns["theta_m_rad"], 0.199 * np.sin(time_s) / 5e-3)
    np.testing.assert_allclose(run.columns["tau_m_N_m"], 5e-3 * 35.15 * np.cos(time_s), rtol=1e-14)
    np.testing.assert_array_equal(run.columns["tau_w_N_m"], 0.0)
    assert "written at a radius of 5 mm" in run.notes[0]
    for change, message in (
        ({"vir": None}, "the numbers vir are missing"),
        ({"qm": np.zeros(3)}, "samples: t 200, qm 3"),
        ({"gtau": np.ones(2)}, "gtau is not a single number"),
        ({"qg": np.array(["x"])}, "the numbers qg are missing"),
        ({"qg": np.full(COUNT, np.nan)}, "qg: sample 1 is not a finite number"),
    ):
        variables = {name: value for name, value in (emps_variables() | change).items() if value is not None}
        savemat(path, variables)
        assert message in problem_of(path, path.read_bytes())


@pytest.mark.shared_data
@pytest.mark.parametrize("name", ["DATA_EMPS", "DATA_EMPS_PULSES"])
def test_emps_as_published(name: str) -> None:
    path = EMPS / f"{name}.mat"
    if not path.is_file():
        pytest.skip(f"{path} is not there; see docs/real-data.md for where to get it")
    (run,) = read_run(path)
    assert len(run) == 24841
    assert run.sample_time_s == pytest.approx(1e-3, rel=1e-3)
    assert 20.0 < float(np.ptp(run.columns["theta_m_rad"])) < 200.0


def test_suffixes_that_lie_and_files_that_are_not_there(tmp_path: Path) -> None:
    for suffix in ("mcap", "parquet", "zip", "blf", "mat"):
        assert f"not a .{suffix} file" in problem_of(tmp_path / f"a.{suffix}", HEAD + "0,1,2\n1,1,2\n")
    assert "HDF5: damaged" in problem_of(tmp_path / "a.mat", b"\x89HDF\r\n\x1a\n" + bytes(100))
    with pytest.raises(UserError, match="no such file or folder"):
        read_run(tmp_path / "none.csv")
    with pytest.raises(UserError, match="no such file"):
        read_run("nul\0.csv")


def test_a_folder_gives_all_its_runs_or_all_its_problems(tmp_path: Path) -> None:
    write_csv(a_run(), tmp_path / "b.csv")
    write_parquet(a_run(), tmp_path / "a.parquet")
    (tmp_path / "bus.log").write_text("(0.0) can0 081#00 R\n")
    (tmp_path / "README.md").write_text("nothing")
    assert [run.name for run in read_run(tmp_path)] == ["a", "b"]
    (tmp_path / "c.csv").write_text("time_ms,theta_m_rad\n")
    (tmp_path / "d.csv").write_text("")
    with pytest.raises(UserError) as caught:
        read_run(tmp_path)
    assert len(caught.value.problems) == 2
    (empty := tmp_path / "empty").mkdir()
    with pytest.raises(UserError, match="contains no run"):
        read_run(empty)


def seeds() -> dict[str, bytes]:
    """Whole files of every kind that can be made here, to damage."""
    import tempfile  # noqa: PLC0415

    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        write_csv(a_run(20), home / "a.csv")
        write_parquet(a_run(20), home / "a.parquet")
        savemat(home / "a.mat", emps_variables(20))
        savemat(home / "b.mat", emps_variables(20), do_compression=True)
        with zipfile.ZipFile(home / "a.zip", "w") as archive:
            archive.writestr("11.TXT", "0,1,2,3,4,5,6,7,8,9\n" * 20)
        return {file.name: file.read_bytes() for file in home.iterdir()}


SEEDS = seeds()
HEADS = [b"", b"\x89MCAP0\r\n", b"PAR1", b"PK\x03\x04", b"LOGG", b"MATLAB 5.0 MAT-file", HEAD.encode(), b"% ten\n"]
SUFFIXES = [".csv", ".parquet", ".mcap", ".zip", ".txt", ".mat", ".log", ".asc", ".blf", ".trc", ""]


def refuses_or_reads(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    problems: tuple[str, ...] = ("none",)
    try:
        problems = () if not read_run(path) else problems
    except UserError as error:
        problems = error.problems
    assert problems
    assert all("\n" not in problem for problem in problems)


@settings(max_examples=300, deadline=None)
@given(head=st.sampled_from(HEADS), body=st.binary(max_size=400), suffix=st.sampled_from(SUFFIXES))
def test_bytes_raise_nothing_but_user_errors(
    head: bytes, body: bytes, suffix: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    refuses_or_reads(tmp_path_factory.getbasetemp() / f"fuzz{suffix}", head + body)


@settings(max_examples=300, deadline=None)
@given(data=st.data(), name=st.sampled_from(sorted(SEEDS)))
def test_damaged_files_raise_nothing_but_user_errors(
    data: st.DataObject, name: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    content = bytearray(SEEDS[name])
    for _ in range(data.draw(st.integers(0, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(content)) | st.none())
    refuses_or_reads(tmp_path_factory.getbasetemp() / f"damaged-{name}", bytes(content[:cut]))


def test_a_parquet_that_claims_more_rows_than_it_has(tmp_path: Path) -> None:
    content = SEEDS["a.parquet"]
    length = struct.unpack("<I", content[-8:-4])[0]
    refuses_or_reads(tmp_path / "a.parquet", content[: -8 - length // 2] + content[-8:])
