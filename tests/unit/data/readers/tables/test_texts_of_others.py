"""Texts in the style of other programs: their preambles, units and ends, and what their writers make of a table."""

import csv
import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil_forceps.data.readers.read_run import read_run
from hil_forceps.data.readers.tables.mapping import read_map
from hil_forceps.data.run import Run
from hil_forceps.rig.errors import UserError

pd: Any = importlib.import_module("pandas")
pl: Any = importlib.import_module("polars")

COUNT = 30
TIME_S = np.arange(COUNT) / 1000
THETA_RAD = np.sin(9 * TIME_S)
CURRENT_A = 0.3 * np.cos(TIME_S)
TABLE = {"time_s": TIME_S, "theta_m_rad": THETA_RAD, "current_A": CURRENT_A}


def check(run: Run, rtol: float = 0.0) -> None:
    for name, values in TABLE.items():
        np.testing.assert_allclose(run.columns[name], values, rtol=rtol, atol=rtol)


def pandas_german(path: Path) -> None:
    pd.DataFrame(TABLE).to_csv(path, sep=";", decimal=",", index=False)


def pandas_decimal_commas_between_commas(path: Path) -> None:
    pd.DataFrame(TABLE).to_csv(path, decimal=",", index=False)


def pandas_with_index(path: Path) -> None:
    pd.DataFrame(TABLE).to_csv(path)


def pandas_packed(path: Path) -> None:
    pd.DataFrame(TABLE).to_csv(path, index=False, compression="gzip")


def polars_table(path: Path) -> None:
    pl.DataFrame(TABLE).write_csv(path, separator="\t", line_terminator="\r\n")


def excel_dialect(path: Path) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file, dialect="excel", quoting=csv.QUOTE_ALL)
        writer.writerow(TABLE)
        writer.writerows(zip(*(each.tolist() for each in TABLE.values()), strict=True))


def numpy_savetxt(path: Path) -> None:
    np.savetxt(path, np.column_stack(list(TABLE.values())), header="time_s theta_m_rad current_A", fmt="%.17g")


WRITERS: tuple[Callable[[Path], None], ...] = (
    *(pandas_german, pandas_decimal_commas_between_commas, pandas_with_index, pandas_packed, polars_table),
    *(excel_dialect, numpy_savetxt),
)


@pytest.mark.parametrize("write", WRITERS, ids=lambda each: each.__name__)
def test_what_other_writers_make_is_read_bit_for_bit(write: Callable[[Path], None], tmp_path: Path) -> None:
    write(tmp_path / "a.csv")
    (run,) = read_run(tmp_path / "a.csv")
    check(run)


def rows(form: str) -> str:
    """Return a line for each sample."""
    each = zip(*(values.tolist() for values in TABLE.values()), strict=True)
    lines = (form.format(t=t, th=th, deg=float(np.degrees(th)), i=i, mA=1e3 * i) for t, th, i in each)
    return "".join(f"{line}\n" for line in lines)


LVM = (
    "LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\n"
    "Decimal_Separator\t.\nMulti_Headings\tNo\n"
    "X_Columns\tOne\nTime_Pref\tRelative\nOperator\tx\nDate\t2024/05/16\nTime\t06:16:50.884\n***End_of_Header***\t\n\n"
    f"Channels\t2\t\t\nSamples\t{COUNT}\t{COUNT}\t\nDate\t2024/05/16\t2024/05/16\t\nTime\t06:16:50\t06:16:50\t\n"
    "Y_Unit_Label\trad\tA\t\nX_Dimension\tTime\tTime\t\nX0\t0.0\t0.0\t\nDelta_X\t0.001\t0.001\t\n***End_of_Header***\t\t\t\n"
    "X_Value\tangle\tcurrent\tComment\n"
)
CONTROLDESK = (
    "format,4\norigin,dSPACE ControlDesk\n\npath,Platform/Timer,Model/angle,Model/current\n"
    "description,,,\nunit,s,deg,mA\ntrace_values,,,\n"
)
TEKTRONIX = (
    "Model,MSO24\nFirmware Version,1.44\n\nWaveform Type,ANALOG\nHorizontal Units,s\nRecord Length,30\n,,\n"
    "Labels,,\nTIME,CH1,CH2\n"
)
PLOTJUGGLER = "__time,/drive/position,/drive/current\n"
SALEAE = "Time [s],theta_m [deg],current [mA]\n"
MAPPED = ("theta_m_rad=/drive/position:rad", "current_A=/drive/current:A", "time_s=__time:s")

OTHERS: dict[str, tuple[str, tuple[str, ...]]] = {
    "lvm": (LVM + rows("{t!r}\t{th!r}\t{i!r}"), ("time_s=X_Value:s", "theta_m_rad=angle:rad", "current_A=current:A")),
    "controldesk": (
        CONTROLDESK + rows(",{t!r},{deg!r},{mA!r}"),
        ("time_s=Platform/Timer", "theta_m_rad=Model/angle", "current_A=Model/current"),
    ),
    "tektronix": (
        TEKTRONIX + rows("{t:.9e},{th:.17e},{i:.17e}"),
        ("time_s=TIME:s", "theta_m_rad=CH1:rad", "current_A=CH2:A"),
    ),
    "plotjuggler": (PLOTJUGGLER + rows("{t!r},{th!r},{i!r}"), MAPPED),
    "saleae": (SALEAE + rows("{t!r},{deg!r},{mA!r}"), ()),
    "no_names": (rows("{t!r}   {th!r}  {i!r}"), ("time_s=#1:s", "theta_m_rad=#2:rad", "current_A=#3:A")),
    "footer": (
        "time_s;theta_m_rad;current_A;\n" + rows("{t!r};{th!r};{i!r};") + "\nEnd of data;;;\nmeasured by nobody\n",
        (),
    ),
    "twice": (
        "time_s,theta_m_rad,current_A\n"
        + rows("{t!r},{th!r},{i!r}").replace("0.015,", "time_s,theta_m_rad,current_A\n0.015,", 1),
        (),
    ),
    "trailing": ("time_s,theta_m_rad,current_A\n" + rows("{t!r},{th!r},{i!r},"), ()),
}


@pytest.mark.parametrize("name", OTHERS)
def test_texts_in_the_style_of_other_programs(name: str, tmp_path: Path) -> None:
    text, maps = OTHERS[name]
    path = tmp_path / ("a.lvm" if name == "lvm" else "a.csv")
    path.write_text(text)
    if maps:
        with pytest.raises(UserError, match="--map"):
            read_run(path)
    (run,) = read_run(path, mapping=read_map(maps))
    check(run, rtol=1e-15)
    told = "\n".join(run.notes)
    for what, note in (
        ("footer", "behind the table, was left out: 'End of data;;;'"),
        ("twice", "1 line with the header again: left out"),
        ("trailing", "at the end of each line was ignored"),
        ("lvm", "before the table: left out"),
        ("no_names", "#1 is the first"),
        ("controldesk", "was read as units"),
    ):
        assert (note in told) == (name == what or (what == "lvm" and name in ("controldesk", "tektronix"))), told


def test_a_cut_row_at_the_end_is_no_footer(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time_s,theta_m_rad,current_A\n" + rows("{t},{th},{i}") + "0.03,1\n")
    with pytest.raises(UserError, match=r"a.csv:32: 2 cells, but the header has 3"):
        read_run(tmp_path / "a.csv")
