"""Excel, HDF5, MATLAB 5 and 7.3, MDF: what other people's writers make is read; what is damaged or lies is refused."""

import importlib
import zipfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from hil_forceps.data.readers.containers import child, contained, excel
from hil_forceps.data.readers.containers.content import ContentError
from hil_forceps.data.readers.read_run import read_run
from hil_forceps.data.readers.tables.mapping import read_map
from hil_forceps.data.run import Run
from hil_forceps.rig.errors import UserError
from tests.reader_fuzz import sound_files

h5py: Any = importlib.import_module("h5py")
openpyxl: Any = importlib.import_module("openpyxl")
pd: Any = importlib.import_module("pandas")

COUNT = 60
TIME_S = np.arange(COUNT) / 1000
THETA_RAD = np.sin(9 * TIME_S)
CURRENT_A = 0.3 * np.cos(TIME_S)
TABLE = {"time_s": TIME_S, "theta_m_rad": THETA_RAD, "current_A": CURRENT_A}


def check(run: Run) -> None:
    """Hold a run against what was written; Excel keeps 16 digits."""
    for name, values in TABLE.items():
        np.testing.assert_allclose(run.columns[name], values, rtol=2e-15, atol=1e-17)


def refused(path: Path, *maps: str) -> str:
    with pytest.raises(UserError) as caught:
        read_run(path, mapping=read_map(maps))
    assert all(str(path) in problem and "\n" not in problem for problem in caught.value.problems)
    return str(caught.value)


def an_excel(path: Path) -> None:
    pd.DataFrame(TABLE).to_excel(path, index=False)


def an_excel_of_a_german_bench(path: Path) -> None:
    book = openpyxl.Workbook()
    sheet = book.active
    sheet.append(["Prüfstand 3"])
    sheet.append([])
    sheet.append(["Time", "theta_m", "Current"])
    sheet.append(["ms", "°", "mA"])
    for time_s, theta_rad, current_A in zip(*TABLE.values(), strict=True):
        sheet.append([1e3 * time_s, np.degrees(theta_rad), 1e3 * current_A])
    sheet.append(["Ende"])
    book.create_sheet("Notizen").append(["nobody", "measured", "this"])
    book.save(path)


def an_hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        group = file.create_group("log/drive")
        for name, values in TABLE.items():
            group.create_dataset(name, data=values, compression="gzip", shuffle=True)
        group["label"] = "not a number"


def an_hdf5_of_pandas_kind(path: Path) -> None:
    table = np.zeros(COUNT, dtype=[(name, "f8") for name in TABLE])
    for name, values in TABLE.items():
        table[name] = values
    with h5py.File(path, "w") as file:
        file["table"] = table


def a_matlab_7_3(path: Path) -> None:
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in TABLE.items():
            file[name] = values[None]
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + bytes(8) + b"\0\2IM")


def a_matlab_5(path: Path) -> None:
    savemat(path, {name: values[:, None] for name, values in TABLE.items()} | {"gain": 3.0, "who": "me"})


def a_matlab_5_structure(path: Path) -> None:
    savemat(path, {"log": dict(TABLE), "settings": {"kp": 3.0, "deep": {"x": 1}}}, do_compression=True)


def an_mf4(path: Path) -> None:
    asammdf = sound_files.asammdf()
    file = asammdf.MDF(version="4.10")
    signals = [("theta_m", np.degrees(THETA_RAD), "deg"), ("current", 1e3 * CURRENT_A, "mA")]
    file.append([asammdf.Signal(values, TIME_S, name=name, unit=unit) for name, values, unit in signals])
    file.save(path, overwrite=True)
    file.close()


with_mdf = pytest.mark.skipif(find_spec("asammdf") is None, reason="MDF needs asammdf: pip install 'hil-forceps[mdf]'")
WRITERS: dict[str, Callable[[Path], None]] = {
    "a.xlsx": an_excel,
    "b.xlsx": an_excel_of_a_german_bench,
    "a.h5": an_hdf5,
    "b.hdf5": an_hdf5_of_pandas_kind,
    "a.mat": a_matlab_7_3,
    "b.mat": a_matlab_5,
    "c.mat": a_matlab_5_structure,
    "a.mf4": an_mf4,
}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=with_mdf) if name.endswith(".mf4") else name for name in WRITERS]
)
def test_what_other_writers_make_is_read(name: str, tmp_path: Path) -> None:
    WRITERS[name](tmp_path / name)
    runs = read_run(tmp_path / name)
    check(runs[0])
    (disguised,) = read_run((tmp_path / name).rename(tmp_path / "a.dat"))
    check(disguised)
    told = "\n".join(runs[0].notes)
    assert ("row 4 was read as units" in told) == (name == "b.xlsx")


def test_groups_and_matrices_are_mapped_by_path_and_number(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["log/t"] = 1e3 * TIME_S
        file["log/t"].attrs["unit"] = "ms"
        file["log/data"] = np.column_stack([THETA_RAD, CURRENT_A])
    assert "add --map time_s=t" in refused(tmp_path / "a.h5")
    for head in ("", "log/", "/log/"):
        maps = [f"time_s={head}t", f"theta_m_rad={head}data#1:rad", f"current_A={head}data#2:A"]
        (run,) = read_run(tmp_path / "a.h5", mapping=read_map(maps))
        check(run)
    savemat(tmp_path / "a.mat", {"log": {"t": TIME_S, "data": np.column_stack([THETA_RAD, CURRENT_A]).T}})
    (run,) = read_run(tmp_path / "a.mat", mapping=read_map(["time_s=t:s", *maps[1:]]))
    check(run)


@with_mdf
def test_time_bases_of_their_own_are_interpolated_only_when_asked(tmp_path: Path) -> None:
    asammdf = sound_files.asammdf()
    with asammdf.MDF(version="4.10") as file:
        file.append([asammdf.Signal(THETA_RAD, TIME_S, name="theta_m", unit="rad")])
        file.append([asammdf.Signal(CURRENT_A[::2], TIME_S[::2], name="current", unit="A")])
        file.save(tmp_path / "a.mf4", overwrite=True)
    assert "to interpolate the others at the times of one: --map time_s=@theta_m" in refused(tmp_path / "a.mf4")
    (run,) = read_run(tmp_path / "a.mf4", mapping=read_map(["time_s=@theta_m"]))
    assert run.columns["time_s"].tolist() == TIME_S[:-1].tolist()  # nothing is extrapolated
    assert run.columns["theta_m_rad"].tolist() == THETA_RAD[:-1].tolist()
    np.testing.assert_allclose(run.columns["current_A"], CURRENT_A[:-1], atol=1e-6)
    assert "interpolated linearly at the times of 'theta_m'" in run.notes
    assert "no channel 'x'" in refused(tmp_path / "a.mf4", "time_s=@x")


def test_sheets_are_runs_and_bad_cells_have_a_place(tmp_path: Path) -> None:
    with pd.ExcelWriter(tmp_path / "a.xlsx") as writer:
        pd.DataFrame(TABLE).to_excel(writer, sheet_name="one", index=False)
        pd.DataFrame(TABLE).to_excel(writer, sheet_name="two", index=False)
    assert [run.name for run in read_run(tmp_path / "a.xlsx")] == ["a-one", "a-two"]
    strange = pd.DataFrame(TABLE).astype(object)
    strange.loc[3, "current_A"] = None
    strange.to_excel(tmp_path / "b.xlsx", index=False)
    (run,) = read_run(tmp_path / "b.xlsx")
    assert run.notes[0] == "1 row with empty or NaN cells became gaps (current_A 1)"
    strange.loc[7, "current_A"] = "1,5"
    strange.to_excel(tmp_path / "b.xlsx", index=False)
    assert "sheet 'Sheet1', row 9: '1,5' is not a finite number" in refused(tmp_path / "b.xlsx")


def test_only_what_the_file_itself_holds_is_read(tmp_path: Path) -> None:
    """Links to other files and external storage would read whatever a file names."""
    an_hdf5(tmp_path / "other.h5")
    (tmp_path / "secret").write_bytes(CURRENT_A.tobytes())
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["time_s"] = TIME_S
        file["theta_m_rad"] = h5py.ExternalLink("other.h5", "/log/drive/theta_m_rad")
        file.create_dataset("current_A", (COUNT,), "f8", external=[(str(tmp_path / "secret"), 0, 8 * COUNT)])
        layout = h5py.VirtualLayout((COUNT,), "f8")
        layout[:] = h5py.VirtualSource(tmp_path / "other.h5", "/log/drive/current_A", (COUNT,))
        file.create_virtual_dataset("tau_m_N_m", layout)
        file["loop"] = h5py.SoftLink("/loop")
        file["group/again"] = file["/"]
    told = refused(tmp_path / "a.h5")
    assert "column theta_m_rad is missing" in told
    assert "neither current_A nor tau_m_N_m" in told


def test_what_claims_more_than_its_bytes_can_hold_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name in TABLE:
            file.create_dataset(name, (40_000_000,), "f8", chunks=(1000,))
    assert "40000000 numbers in 0 bytes" in refused(tmp_path / "a.h5")
    with zipfile.ZipFile(tmp_path / "a.xlsx", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("[Content_Types].xml", bytes(1 << 20))
    monkeypatch.setattr(excel, "_MAX_UNPACKED_BYTES", 1000)
    with pytest.raises(ContentError, match="when unpacked"):
        excel.tables(tmp_path / "a.xlsx")


@pytest.mark.parametrize("name", ["a.h5", "a.xlsx", pytest.param("a.mf4", marks=with_mdf), "a.mat"])
def test_damage_is_told(name: str, tmp_path: Path) -> None:
    WRITERS[name](tmp_path / name)
    whole = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(whole[: len(whole) // 2])
    assert "write it again" in refused(tmp_path / name)


def test_a_reader_that_dies_or_is_missing_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    an_hdf5(tmp_path / "a.h5")
    monkeypatch.setattr(contained, "_CHILD", "this")  # any module that answers otherwise
    assert "its reader ended (" in refused(tmp_path / "a.h5") or "not a valid " in refused(tmp_path / "a.h5")
    monkeypatch.undo()
    (tmp_path / "h5py.py").write_text("raise ImportError('not here')\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    told = refused(tmp_path / "a.h5")
    assert "HDF5 needs h5py, which can't be imported (not here): pip install 'hil-forceps[formats]'" in told
    assert set(child.LIBRARIES) == {"excel", "hdf5", "mf4"}
