"""However a text is laid out, the same arrays come out of it; and what was found in it is told."""

import csv
import gzip
import importlib
import io
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil_forceps.data.readers.read_run import read_run
from hil_forceps.data.readers.tables import packed
from hil_forceps.data.run import Run
from hil_forceps.rig.errors import UserError

COUNT = 40
COLUMNS = ("time_s", "theta_m_rad", "current_A")
TIME_S = np.arange(COUNT) / 1000
THETA_RAD = np.round(np.sin(9 * TIME_S), 6)
CURRENT_A = np.round(0.3 * np.cos(TIME_S) - 0.25, 6)
VALUES = (TIME_S, THETA_RAD, CURRENT_A)

PREAMBLES = {
    "none": "",
    "scope": "Model,MSO24\nFirmware Version,2.4\nSample Interval,1.0e-3\nRecord Length,40\n\n",
    "sep": "sep={delimiter}\n",
    "comments": "# measured on Monday\n# by nobody\n",
}
HEADERS = {
    "names": (COLUMNS, None),
    "brackets": (("Time [s]", "theta_m [rad]", "CURRENT [A]"), None),
    "units_row": (("time", "theta_m", "current"), ("s", "rad", "A")),
}
PACKINGS = ("plain", "gz", "zst")


def text_of(delimiter: str, decimal: str, header: str, preamble: str, end: str = "\n") -> str:
    names, units = HEADERS[header]
    rows: list[Sequence[str]] = [names] if units is None else [names, units]
    rows += [[repr(float(value)).replace(".", decimal) for value in row] for row in zip(*VALUES, strict=True)]
    file = io.StringIO()
    file.write(PREAMBLES[preamble].format(delimiter=delimiter).replace("\n", end))
    writer = csv.writer(file, delimiter=delimiter, lineterminator=end)
    writer.writerows(rows)
    return file.getvalue()


def written(path: Path, text: bytes, packing: str) -> Path:
    zstandard: Any = importlib.import_module("zstandard")
    pack = {"plain": bytes, "gz": gzip.compress, "zst": zstandard.compress}[packing]
    whole = path.with_name(path.name + ("" if packing == "plain" else f".{packing}"))
    whole.write_bytes(pack(text))
    return whole


def is_the_run(run: Run) -> bool:
    return all(
        run.columns[name].tobytes() == np.asarray(values).tobytes()
        for name, values in zip(COLUMNS, VALUES, strict=True)
    )


LAYOUTS = [
    (delimiter, decimal, header, preamble)
    for delimiter, decimal, header, preamble in itertools.product(",;\t| ", ".,", HEADERS, PREAMBLES)
    if not (delimiter == " " and header == "brackets")  # `Time [s]` is two words
]


@pytest.mark.parametrize(("delimiter", "decimal", "header", "preamble"), LAYOUTS)
def test_every_layout_gives_the_same_arrays(
    delimiter: str, decimal: str, header: str, preamble: str, tmp_path: Path
) -> None:
    text = text_of(delimiter, decimal, header, preamble).encode()
    for packing in PACKINGS:
        path = written(tmp_path / "a.csv", text, packing)
        (run,) = read_run(path)
        assert run.name == "a"
        assert is_the_run(run)
        told = "\n".join(run.notes)
        assert ("decimal commas" in told) == (decimal == ",")
        assert ("was read as units" in told) == (header == "units_row")
        assert ("before the table" in told) == (preamble == "scope")


@pytest.mark.parametrize("before", [1, 57, 58, 59, 60, 61, 400])
def test_a_preamble_of_any_length_is_left_out(before: int, tmp_path: Path) -> None:
    text = "Model,MSO24\n" * before + text_of(",", ".", "units_row", "none")
    (tmp_path / "a.csv").write_text(text)
    (run,) = read_run(tmp_path / "a.csv")
    assert is_the_run(run)


def test_there_are_a_hundred_layouts() -> None:
    assert len(LAYOUTS) * len(PACKINGS) > 300


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_line_ends_and_encodings(end: str, encoding: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packed, "PIECE_BYTES", 97)  # line ends and characters fall on borders of pieces
    text = text_of(";", ",", "names", "none", end).replace("time_s", "time (µs)").replace("0,0;", "0;", 1)
    (tmp_path / "a.csv").write_bytes(text.encode(encoding))
    (run,) = read_run(tmp_path / "a.csv")
    np.testing.assert_array_equal(run.columns["time_s"], TIME_S * 1e-6)
    np.testing.assert_array_equal(run.columns["theta_m_rad"], THETA_RAD)
    assert any("Windows-1252" in note for note in run.notes) == (encoding == "cp1252")
    (tmp_path / "a.csv").write_bytes((text + f"x;1;2{end}{text}").encode(encoding))
    with pytest.raises(UserError, match=rf"a.csv:{COUNT + 2}: column 1 \(time"):
        read_run(tmp_path / "a.csv")
