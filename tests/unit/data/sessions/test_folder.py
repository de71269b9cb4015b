"""Which sessions a folder holds, of which instrument and with which rig."""

from pathlib import Path

import pytest

from hil_forceps.data.sessions.folder import sessions_of
from hil_forceps.rig.errors import UserError


def made(folder: Path, *names: str) -> Path:
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("x")
    return folder


def told(folder: Path, rig: Path | None = None, out: Path | None = None) -> list[tuple[str, str, str]]:
    return [(s.name, s.instrument, s.rig.name) for s in sessions_of(folder, rig, out)]


def test_each_log_is_a_session_of_the_instrument_whose_rig_is_nearest(tmp_path: Path) -> None:
    made(tmp_path, "left/rig.yaml", "left/2026/a.csv", "left/b.mcap", "right/rig.yaml", "right/a.csv.gz", "notes.md")
    assert told(tmp_path) == [
        ("left/2026/a", "left", "rig.yaml"),
        ("left/b", "left", "rig.yaml"),
        ("right/a.csv", "right", "rig.yaml"),
    ]


def test_a_folder_of_a_run_is_one_session_and_its_bus_log_none(tmp_path: Path) -> None:
    made(tmp_path, "rig.yaml", "monday/run.mcap", "monday/bus.log", "monday/run.json", "two/bus.log", "two/l/run.mcap")
    assert [name for name, *_ in told(tmp_path)] == ["monday", "two/l"]
    assert {instrument for _, instrument, _ in told(tmp_path)} == {tmp_path.name}


def test_bus_logs_are_sessions_where_nothing_else_is(tmp_path: Path) -> None:
    made(tmp_path, "a/1.log", "a/2.asc", "b/1.csv", "b/1.log")
    assert told(tmp_path, Path("given.yaml")) == [
        ("a/1", "a", "given.yaml"),
        ("a/2", "a", "given.yaml"),
        ("b/1", "b", "given.yaml"),
    ]


def test_what_is_hidden_or_a_result_is_left_out_and_equal_names_keep_their_suffix(tmp_path: Path) -> None:
    made(tmp_path, "a.csv", "a.mcap", ".b.csv", "_c/d.csv", "out/estimates.parquet")
    assert [name for name, *_ in told(tmp_path, Path("r.yaml"), tmp_path / "out")] == ["a.csv", "a.mcap"]


def test_the_table_says_otherwise(tmp_path: Path) -> None:
    made(tmp_path, "a1.csv", "a2.csv", "b.csv", "special.yaml")
    (tmp_path / "sessions.csv").write_text("session,instrument,date,rig\na*,left,,\nb,right,2026-11-28,special.yaml\n")
    found = sessions_of(tmp_path, Path("given.yaml"))
    assert [(s.name, s.instrument, s.rig.name, s.told_date) for s in found] == [
        ("a1", "left", "given.yaml", ""),
        ("a2", "left", "given.yaml", ""),
        ("b", "right", "special.yaml", "2026-11-28"),
    ]


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ("name\na", "sessions.csv:1: the column session is missing"),
        ("session,when\na,b", "sessions.csv:1: column 'when' is unknown"),
        ("session,date\na", "sessions.csv:2: 1 cells, but 2 columns"),
        ("session,date\na,soon", "sessions.csv:2: date 'soon': is not a date"),
        ("session,rig\na,none.yaml", "sessions.csv:2: rig none.yaml: no such file"),
        ("session\nz", "sessions.csv:2: session z: no such log"),
        ("session\n,", "sessions.csv:2: 2 cells, but 1 columns"),
    ],
)
def test_a_wrong_table_is_refused_with_its_line(tmp_path: Path, table: str, said: str) -> None:
    made(tmp_path, "a.csv")
    (tmp_path / "sessions.csv").write_text(table)
    with pytest.raises(UserError) as refused:
        sessions_of(tmp_path, Path("given.yaml"))
    assert said in str(refused.value)


def test_no_rig_no_folder_and_no_logs_are_refused_with_a_remedy(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no such folder"):
        sessions_of(tmp_path / "nowhere", None)
    with pytest.raises(UserError, match="contains no logs"):
        sessions_of(tmp_path, Path("given.yaml"))
    made(tmp_path, "a.csv", "b.csv")
    with pytest.raises(UserError, match="name one for all with --rig") as refused:
        sessions_of(tmp_path, None)
    assert len(refused.value.problems) == 1
