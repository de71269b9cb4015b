"""Files of all other kinds that runs, rigs and results are read from."""

import gzip
import importlib
import io
import json
import re
import struct
import tempfile
import warnings
import zipfile
import zlib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.records import Attachment, Chunk
from scipy.io import savemat

from firmware_protocol.host.samples import RawBench, RawSample
from firmware_protocol.messages import DriveState
from hil_forceps.bench.assembly import Settings, metadata
from hil_forceps.bridge.fault import FaultReason
from hil_forceps.bridge.logs.flight_recorder import Recent, last_second
from hil_forceps.control.trajectories import PAPER_TRAJECTORY
from hil_forceps.data.readers.csv_table import write_csv
from hil_forceps.data.readers.parquet_table import write_parquet
from hil_forceps.data.recording.writer import Outcome, Recorder, Reference
from hil_forceps.data.run import Column, Run
from hil_forceps.estimation.interface import Estimate, Sample
from hil_forceps.rig import load_rig

ROOT = Path(__file__).parents[2]
CHUNK_OPCODE = 6
HEAD = struct.Struct("<BQ")
MAGIC = b"\x89MCAP0\r\n"
WANTED = ("time_s", "theta_m_rad", "current_A")
RIG = (ROOT / "configs" / "realistic.yaml").read_bytes()
EPOS = (
    "EPOS Studio Version:;3.7\r\n;Velocity Actual Value;Current Actual Value\r\nms;rpm;mA\r\n"
    + "".join(f"{n}.000;{n}.5;{n},25\r\n" for n in range(20))
).encode()
SURGICAL = b"%a,b\n" + b"".join(b"%.3f,%d,3,0.2,4,5,0.3,0,%d,9\n" % (n * 1e-3, 1000 - n, n) for n in range(110))
JSON = json.dumps({"a": [1, 2.5, None, True, {"b": 'ä\\"['}], "c": -1e-3, "d": {}}).encode()


def a_run(count: int) -> Run:
    """Return a run with a load."""
    time_s = np.arange(count) / 1000
    names = ("theta_m_ref_rad", "theta_m_rad", "current_A", "theta_j_rad", "tau_w_N_m")
    values = np.random.default_rng(count).normal(size=(len(names), count)) * 1e-3
    return Run("a", {"time_s": time_s, **dict(zip(names, values, strict=True))})


def tables() -> dict[str, bytes]:
    """Return a run of 20 rows as CSV, Parquet (plain, and packed), and the surgical tool's text in a zip."""
    arrow: Any = importlib.import_module("pyarrow")
    parquet: Any = importlib.import_module("pyarrow.parquet")
    run = a_run(20)
    packed = zipped({"11.TXT": SURGICAL})
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        write_csv(run, home / "a.csv")
        write_parquet(run, home / "a.parquet")
        plain = arrow.table(dict(run.columns))
        parquet.write_table(plain, home / "b.parquet", compression="none", use_dictionary=False)
        return {file.name: file.read_bytes() for file in home.iterdir()} | {"a.zip": packed}


def layouts() -> list[list[bytes]]:
    """Return tables as text in other layouts, in lines: preambles, units, decimal commas, spaces, empty cells."""
    run = a_run(20).columns
    rows = [[repr(value) for value in row] for row in zip(*(run[name].tolist() for name in WANTED), strict=True)]

    def lines(head: str, delimiter: str, decimal: str = ".", end: str = "") -> list[bytes]:
        body = [delimiter.join(row).replace(".", decimal) + end for row in rows]
        return [f"{line}\n".encode() for line in [*head.split("\n"), *body]]

    empty = lines("time_s,theta_m_rad,current_A", ",")
    empty[7], empty[9] = b"0.006,,0\n", b"0.008,nan,0\n"
    return [
        lines("sep=;\ntime;theta_m;current\ns;°;mA", ";", ","),
        lines("Model,MSO24\nRecord Length,20\n\nTime [s],theta_m (rad),current [A],", ",", end=","),
        lines("# time_s theta_m_rad current_A", "  "),
        [*lines("unit\ttable\ntime_ms\ttheta_m_deg\tcurrent_A", "\t"), b"\n", b"End of data\n"],
        [*empty, empty[0], b"0.021,1,1\n"],
    ]


def packed_text(text: bytes, packing: str) -> bytes:
    """Return a text as it is, as gzip or as zstd."""
    zstandard: Any = importlib.import_module("zstandard")
    packed: bytes = {"gz": lambda plain: gzip.compress(plain, mtime=0), "zst": zstandard.compress}.get(packing, bytes)(
        text
    )
    return packed


def asammdf() -> Any:
    """Import asammdf, whose own imports warn."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return importlib.import_module("asammdf")


@cache
def container(name: str) -> bytes:
    """Return a run of 20 rows as Excel (`a.xlsx`), HDF5 (`a.h5`) or MDF (`a.mf4`)."""
    run = {each: a_run(20).columns[each] for each in WANTED}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        {"a.xlsx": _write_excel, "a.h5": _write_hdf5, "a.mf4": _write_mf4}[name](run, path)
        return path.read_bytes()


def _write_excel(run: dict[str, Column], path: Path) -> None:
    openpyxl: Any = importlib.import_module("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(list(run))
    for row in zip(*(values.tolist() for values in run.values()), strict=True):
        book.active.append(row)
    book.save(path)
    parts = excel_parts(path.read_bytes())
    parts["docProps/core.xml"] = re.sub(
        rb"\d{4}-\d\d-\d\dT[\d:]+Z", b"2026-01-01T00:00:00Z", parts["docProps/core.xml"]
    )
    path.write_bytes(zipped(parts))


def _write_hdf5(run: dict[str, Column], path: Path) -> None:
    h5py: Any = importlib.import_module("h5py")
    with h5py.File(path, "w") as file:
        for name, values in run.items():
            file.create_dataset(f"log/{name}", data=values, compression="gzip")
            file[f"log/{name}"].attrs["unit"] = ""


def _write_mf4(run: dict[str, Column], path: Path) -> None:
    library = asammdf()
    with library.MDF(version="4.10") as mdf:
        units = {"theta_m_rad": "rad", "current_A": "A"}
        mdf.append([library.Signal(run[name], run["time_s"], name=name, unit=unit) for name, unit in units.items()])
        mdf.save(path, overwrite=True)


def zipped(parts: Mapping[str, bytes | str]) -> bytes:
    """Pack files; the archive has no time of its own, so the same files give the same bytes."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for name, data in parts.items():
            archive.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_DEFLATED)
    return packed.getvalue()


def excel_parts(book: bytes) -> dict[str, bytes]:
    """Unpack a workbook."""
    with zipfile.ZipFile(io.BytesIO(book)) as archive:
        return {entry.filename: archive.read(entry) for entry in archive.infolist()}


def mat_structure() -> bytes:
    """Return a structure with the columns of a run, not packed."""
    file = io.BytesIO()
    savemat(file, {"log": {name: a_run(20).columns[name] for name in WANTED}, "settings": {"kp": 1.0}})
    return without_time(file.getvalue())


def mat() -> bytes:
    """Return a file of EMPS, not packed."""
    time_s = np.arange(20) / 1000
    series = {"t": time_s, "qg": 0.2 * time_s, "qm": 0.199 * time_s, "vir": np.cos(time_s)}
    file = io.BytesIO()
    savemat(file, {**{k: v[:, None] for k, v in series.items()}, "gtau": 35.15, "kp": 160.18, "kv": 243.45})
    return without_time(file.getvalue())


def without_time(file: bytes) -> bytes:
    """Return a MAT file whose text in front doesn't say when it was written."""
    return b"MATLAB 5.0 MAT-file".ljust(116) + file[116:]


def packed_mat(plain: bytes) -> bytes:
    """Return the same file with each variable packed; what is behind the last whole one is left as it is."""
    out, at = plain[:128], 128
    while at + 8 <= len(plain):
        size = 8 + int.from_bytes(plain[at + 4 : at + 8], "little")
        packed = zlib.compress(plain[at : at + size])
        out += struct.pack("<II", 15, len(packed)) + packed
        at += size
    return out


class _Kept(io.BytesIO):
    def close(self) -> None:
        self.kept = self.getvalue()
        super().close()


def recording(ticks: int) -> bytes:
    """Return a recording with all that a `run` writes."""
    rig = load_rig(ROOT / "configs" / "realistic.yaml")
    file = _Kept()
    settings = Settings("kalman", True, 1e-3, PAPER_TRAJECTORY)
    recorder = Recorder(file, metadata(rig, settings, {}), False)
    _fill(recorder, ticks)
    recorder.close({"reason": "completed"})
    return file.kept


def _fill(recorder: Recorder, ticks: int) -> None:
    for k in range(ticks):
        now = k * 1_000_000
        state = DriveState.OPERATIONAL if k >= 3 else DriveState.ARMED
        raw = RawSample(k % 256, now, 1000 + k, -5, state, 0, max(k - 1, 0) % 256, now + 350_000)
        recorder.sample(raw, Sample(now, 0.1 * k, -1.35e-5), Estimate(1e-3, 2e-5))
        recorder.bench(RawBench(k % 256, k, 9, now + 400_000))
        reference = Reference(now + 600_000, now, now, k, 1.5, 2e-5, 0.25 * k, 0.25 * k, 16, k % 256)
        recorder.reference(reference, now + 610_000, Outcome.SENT, k % 256)


def fault() -> bytes:
    """Return a `fault.json` of a few rows."""
    reason = FaultReason("drive_lost", "time since the last sample", 101.0, 100.0, "ms", 12_000_000, "running", "lost")
    file = _Kept()
    recorder = Recorder(file, {}, False)
    _fill(recorder, 12)
    recent = Recent(recorder.recent(), ["(0.001000) can0 0A5#0102 R"], 0, [(1_000_000, 3)])
    more = {"zero_ns": 3_000_000, "drive": {"profile": "native", "fault": "none", "state": "unknown"}}
    return last_second(reason, [(0, "connecting"), (5_000_000, "running")], recent, more)


def records(data: bytes) -> list[tuple[int, bytes]]:
    """Return the records of an MCAP file, chunks unpacked (with their head of 40 bytes left away)."""
    found, at = [], len(MAGIC)
    while at + HEAD.size <= len(data) - len(MAGIC):
        opcode, size = HEAD.unpack_from(data, at)
        body = data[at + HEAD.size : at + HEAD.size + size]
        found.append((opcode, _unpacked(body) if opcode == CHUNK_OPCODE else body))
        at += HEAD.size + size
    return found


def mcap(found: list[tuple[int, bytes]]) -> bytes:
    """Put records together again, chunks packed and with the right checksum."""
    return MAGIC + b"".join(
        _chunk(body) if opcode == CHUNK_OPCODE else HEAD.pack(opcode, len(body)) + body for opcode, body in found
    )


def attachment(name: str, data: bytes) -> tuple[int, bytes]:
    """Return an attachment with the right checksum."""
    builder = RecordBuilder()
    Attachment(0, 0, name, "application/json", data).write(builder)
    whole: bytes = builder.end()  # type: ignore[no-untyped-call]
    return whole[0], whole[HEAD.size :]


def _unpacked(body: bytes) -> bytes:
    zstandard: Any = importlib.import_module("zstandard")
    chunk = Chunk.read(ReadDataStream(io.BytesIO(body)))
    data: bytes = zstandard.decompress(chunk.data)
    return data


def _chunk(data: bytes) -> bytes:
    zstandard: Any = importlib.import_module("zstandard")
    builder = RecordBuilder()
    packed = zstandard.compress(data)
    Chunk("zstd", packed, 0, 0, zlib.crc32(data), len(data)).write(builder)
    out: bytes = builder.end()  # type: ignore[no-untyped-call]
    return out
