"""Units by literal factors, names in the ways that people write them, and what a mapping says."""

import math
from pathlib import Path

import pytest

from hil_forceps.data.readers.read_run import read_run
from hil_forceps.data.readers.tables.mapping import read_map
from hil_forceps.data.readers.tables.units import UNITS, unit_of
from hil_forceps.data.readers.tables.written_name import parse_name
from hil_forceps.data.run import ANGLE_FROM_SPEED, KNOWN_COLUMNS, Run
from hil_forceps.rig import Rig, load_rig
from hil_forceps.rig.errors import UserError

ROOT = Path(__file__).parents[5]
FACTORS = {
    "s": 1.0, "ms": 0.001, "us": 0.000001, "ns": 0.000000001, "min": 60.0,
    "rad": 1.0, "mrad": 0.001, "deg": 0.017453292519943295, "mdeg": 0.000017453292519943295, "rev": 6.283185307179586,
    "rad/s": 1.0, "deg/s": 0.017453292519943295, "rev/s": 6.283185307179586, "rpm": 0.10471975511965977,
    "A": 1.0, "mA": 0.001, "uA": 0.000001, "V": 1.0, "mV": 0.001, "kV": 1000.0,
    "Nm": 1.0, "mNm": 0.001, "uNm": 0.000001, "Nmm": 0.001, "Ncm": 0.01, "kNm": 1000.0,
    "counts": 1.0, "%": 0.01, "‰": 0.001,
}  # fmt: skip
SAME = {
    "s": ("sec", "Seconds", "[s]", "(s)"),
    "us": ("µs", "μs", "usec"),
    "deg": ("°", "Degrees", "DEG", "[deg]", "<deg>"),
    "rpm": ("1/min", "RPM", "rev/min", "min^-1"),
    "A": ("Ampere", "Amps"),
    "Nm": ("N m", "N*m", "N·m", "N_m"),
    "mNm": ("mN m", "mN_m", "mN·m"),
    "uNm": ("µN m", "uN_m", "µNm"),
    "rad/s": ("rad_per_s", "rad / s"),
    "counts": ("Counts", "inc", "ticks", "qc"),
}


def test_factors() -> None:
    assert set(FACTORS) == set(UNITS)
    for unit, factor in FACTORS.items():
        assert math.isclose(UNITS[unit].factor, factor, rel_tol=1e-15), unit


@pytest.mark.parametrize("unit", SAME)
def test_spellings(unit: str) -> None:
    assert all(unit_of(each) == UNITS[unit] for each in SAME[unit])


@pytest.mark.parametrize("text", ["", "MA", "Ms", "furlong", "x" * 99, "MS", "K", "[]", "(", "S", "a"])
def test_what_is_no_unit(text: str) -> None:
    assert unit_of(text) is None


@pytest.mark.parametrize(
    "name",
    [
        "theta_m [deg]",
        "Theta_M (deg)",
        "theta m [°]",
        "theta_m/deg",
        "theta_m in degrees",
        "theta_m_deg",
        "THETA-M, deg",
    ],
)
def test_one_quantity_in_degrees(name: str) -> None:
    found = parse_name(name)
    assert (found.column, unit_of(found.unit)) == ("theta_m_rad", UNITS["deg"])


def test_a_longer_quantity_is_not_a_shorter_one_with_a_unit() -> None:
    assert parse_name("theta_m_ref_deg").column == "theta_m_ref_rad"
    assert parse_name("theta_m_raw").column == ""
    assert parse_name("theta_m_rad [deg]").other_unit == "deg"


def read(tmp_path: Path, text: str, *maps: str, rig: Rig | None = None) -> Run:
    (tmp_path / "a.csv").write_text(text)
    (run,) = read_run(tmp_path / "a.csv", rig=rig, mapping=read_map(maps))
    return run


def refused(tmp_path: Path, text: str, *maps: str) -> str:
    with pytest.raises(UserError) as caught:
        read(tmp_path, text, *maps)
    assert all(str(tmp_path) in problem or problem.startswith("--map") for problem in caught.value.problems)
    return str(caught.value)


ROWS = "0,10,100\n1,20,200\n2,30,300\n"


def test_a_mapping_names_columns_and_units(tmp_path: Path) -> None:
    head = "clock,Pos [deg],iq\n"
    run = read(tmp_path, head + ROWS, "time_s=clock:ms", "theta_m_rad=Pos", "current_A=#3:mA")
    assert run.columns["time_s"].tolist() == [0.0, 0.001, 0.002]
    assert run.columns["theta_m_rad"].tolist() == [10 * math.pi / 180, 20 * math.pi / 180, 30 * math.pi / 180]
    assert run.columns["current_A"].tolist() == [0.1, 0.2, 0.3]
    assert "column 'clock' was read as time_s, from ms, times 0.001" in run.notes


def test_a_mapping_kept_beside_the_data_is_taken_and_told(tmp_path: Path) -> None:
    (tmp_path / "columns.yaml").write_text("time_s: clock:ms\ntheta_m_rad: 'Pos:deg'\ncurrent_A: iq:A\n")
    run = read(tmp_path, "clock,Pos,iq\n" + ROWS)
    assert run.columns["current_A"].tolist() == [100.0, 200.0, 300.0]
    assert f"columns were named by {tmp_path}/columns.yaml" in run.notes
    assert read(tmp_path, "clock,Pos,iq\n" + ROWS, "current_A=iq:mA").columns["current_A"].tolist() == [0.1, 0.2, 0.3]
    (tmp_path / "columns.yaml").write_text("time_s: clock:ms\nspeed: 'Pos:deg'\n")
    assert f"{tmp_path}/columns.yaml:2: 'speed' is not a column of a run" in refused(tmp_path, "clock,Pos,iq\n" + ROWS)
    (tmp_path / "columns.yaml").write_text("time_s: 3\n")
    assert "columns.yaml:1: time_s: 3 is not a column" in refused(tmp_path, "clock,Pos,iq\n" + ROWS)


def test_speed_is_integrated_and_counts_take_the_rigs_encoder(tmp_path: Path) -> None:
    named = ("time_s=t:ms", "current_A=i:A")
    run = read(tmp_path, "t,speed,i\n" + ROWS, *named, "theta_m_rad=speed:rpm")
    assert ANGLE_FROM_SPEED in run.notes
    turn = 2 * math.pi / 60 * 1e-3
    assert run.columns["theta_m_rad"].tolist() == pytest.approx([0.0, 15 * turn, 40 * turn], rel=1e-14)
    rig = load_rig(ROOT / "configs" / "realistic.yaml")
    run = read(tmp_path, "t,pos,i\n" + ROWS, *named, "theta_m_rad=pos:counts", rig=rig)
    counts = rig.encoder.counts_per_rev
    assert counts is not None
    assert run.columns["theta_m_rad"].tolist() == pytest.approx([2 * math.pi * n / counts for n in (10, 20, 30)])
    told = refused(tmp_path, "t,pos,i\n" + ROWS, *named, "theta_m_rad=pos:counts")
    assert "name a rig (--rig) with encoder.counts_per_rev" in told


KNOWN = "time_s,theta_m_rad,current_A\n"


@pytest.mark.parametrize(
    ("text", "maps", "told"),
    [
        ("t,pos,iq\n" + ROWS, (), "add --map time_s=t:s --map theta_m_rad=pos:rad --map current_A=iq:A"),
        ("time_s,pos,current_A\n" + ROWS, (), "add --map theta_m_rad=pos:rad with its unit behind the colon"),
        ("time_s,Position [deg],current_A\n" + ROWS, (), "add --map 'theta_m_rad=Position [deg]'"),
        ("time_s,theta_m,current_A\n" + ROWS, (), "add --map theta_m_rad=theta_m:rad with its unit"),
        ("time_s,theta_m_rad,torque\n" + ROWS, (), "add --map tau_m_N_m=torque:N_m"),
        ("time;theta;current\ns;°\n0;1;2\n1;2;3\n2;3;4\n", (), "is it, add --map theta_m_rad=theta"),
        ("time_s,theta_m_rad [deg],current_A\n" + ROWS, (), "has two units; say which holds"),
        ("time_s,theta_m_rad,current_A\ns,deg,A\n" + ROWS, (), "has the unit 'deg' in the row of units; say which"),
        ("time_s,theta_m_deg,theta_m_mrad,current_A\n0,1,1,1\n1,2,2,2\n", (), "2 columns say theta_m with a unit"),
        (KNOWN + ROWS, (), "if the stamps are ms, multiply them by 0.001, or add --map time_s=COLUMN:ms"),
        (KNOWN + ROWS, ("time_s=clock:ms",), "--map time_s=clock:ms: the file has no column 'clock:ms'; it has "),
        (KNOWN + ROWS, ("time_s=time_s:furlong",), "'furlong' is no unit that is read (s, ms, "),
        (KNOWN + ROWS, ("theta_m_rad=theta_m_rad:A",), "is in A; theta_m_rad is made from rad, "),
        ("time_s,a,a,current_A\n0,1,1,1\n", ("theta_m_rad=a:rad",), "2 columns have that name; give the place of one"),
        (KNOWN + ROWS, ("speed=a",), "--map speed=a: 'speed' is not a column of a run"),
        (KNOWN + ROWS, ("theta_m_rad",), "--map theta_m_rad: write NAME=COLUMN[:UNIT]"),
        (KNOWN + ROWS, ("theta_m_rad=",), "the column is missing"),
        (KNOWN + ROWS, ("none/there.yaml",), "none/there.yaml: No such file"),
    ],
)  # fmt: skip
def test_what_is_refused_says_the_line_to_type(text: str, maps: tuple[str, ...], told: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(UserError) as caught:
        read_run(tmp_path / "a.csv", mapping=read_map(maps))
    assert told in str(caught.value)


def test_empty_cells_become_gaps_and_are_counted(tmp_path: Path) -> None:
    rows = [f"{n / 1000},{n},{n}" for n in range(20)]
    rows[3], rows[7], rows[8] = "0.003,nan,3", "0.007,7,", ",8,NaN"
    run = read(tmp_path, KNOWN + "\n".join(rows) + "\n")
    assert len(run) == 17
    assert run.notes[0] == "3 rows with empty or NaN cells became gaps (time_s 1, theta_m_rad 1, current_A 2)"
    assert "2 gaps in time, about 3 samples missing" in run.notes[1]
    rows[12] = "0.011,12,12"
    (tmp_path / "a.csv").write_text(KNOWN + "\n".join(rows) + "\n")
    with pytest.raises(UserError, match=r"a.csv:14: time_s: 0.011 does not come after 0.011"):
        read_run(tmp_path / "a.csv")


def test_a_column_that_is_mostly_empty_is_left_out_when_so_told(tmp_path: Path) -> None:
    text = "time_s,theta_m_rad,current_A,theta_j_rad\n" + "".join(
        f"{n / 1000},{n},{n},{n if n % 4 == 0 else ''}\n" for n in range(20)
    )
    assert "a.csv:3: theta_j_rad is empty or NaN in 15 of 20 rows" in refused(tmp_path, text)
    assert "leave the column out: --map theta_j_rad=none" in refused(tmp_path, text)
    assert len(read(tmp_path, text, "theta_j_rad=none")) == 20


def test_the_page_on_columns_has_every_column_and_unit_and_its_example_is_read() -> None:
    page = (ROOT / "docs" / "measured-data.md").read_text()
    assert all(f"| `{name}` |" in page for name in KNOWN_COLUMNS)
    (run,) = read_run(ROOT / "docs" / "examples" / "measured.csv")
    assert len(run) == 400
    assert run.notes == ()
    assert set(run.columns) == set(KNOWN_COLUMNS) - {"voltage_V", "theta_drive_rad", "tau_m_N_m"}
