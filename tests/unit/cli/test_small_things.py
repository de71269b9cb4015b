"""What people expect of a command line: examples, completion, --json, --quiet, progress in a log, tables that fit."""

import io
import json
import os
import re
import shlex
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from rich.table import Table

from hil_forceps.cli import main as cli
from hil_forceps.cli.examples import EXAMPLES
from hil_forceps.cli.terminal import notes
from hil_forceps.cli.terminal.progress import last_told
from hil_forceps.cli.terminal.tables import least_width, print_table

ROOT = Path(__file__).parents[3]
PAPER = str(ROOT / "configs" / "paper.yaml")
UNKNOWN = str(ROOT / "configs" / "surgical_tool_unknown.yaml")
Call = Callable[..., tuple[int, str, str]]


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Call:
    """Run a command in this process, in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            cli.main(list(arguments))
        out, err = capsys.readouterr()
        notes.without_quiet([])
        assert isinstance(ended.value.code, int)
        return ended.value.code, out, err

    return run


@pytest.mark.parametrize("command", [name for name in EXAMPLES if name != "drive"])
def test_help_ends_with_an_example_that_is_understood(call: Call, command: str) -> None:
    _, out, _ = call(command, "--help")
    words = " ".join(out.split())
    assert " ".join(["Example:", *EXAMPLES[command].split()]) in words
    assert "With --quiet only errors" in words
    tokens = shlex.split(EXAMPLES[command].partition(" > ")[0])[1:]
    assert tokens[0] == command
    cli.app.parse_args(tokens, exit_on_error=False, print_error=False)


def test_help_groups_the_options_and_tells_all_that_a_command_does(call: Call) -> None:
    out = call("run", "--help")[1]
    places = [out.index(f" {group} ──") for group in ("Line to the drive", "Control", "Output", "Faults")]
    assert places == sorted(places)
    assert out.index("--channel") < places[1] < out.index("--algorithm") < places[2] < out.index("--bus-log")
    assert "OUT/fault.json has the last second" in " ".join(out.split())
    assert "fault.json" not in call("--help")[1]


def test_every_command_has_an_example() -> None:
    assert {name for name in cli.app if not name.startswith("-")} == set(EXAMPLES)


def test_completion_can_be_installed(call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    code, _, _ = call("--install-completion", "--shell", "bash", "--output", str(tmp_path / "done.bash"))
    assert code == 0
    script = (tmp_path / "done.bash").read_text()
    assert all(name in script for name in ("diagnose", "--trajectory", "init"))


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("nonsense", "nonsense: unknown command; see hil-forceps --help for the list"),
        ("chek r.yaml", "chek: unknown command (did you mean check?); see hil-forceps --help for the list"),
        ("check r.yaml --foo", "--foo: unknown option of check; see hil-forceps check --help"),
        ("check r.yaml --jsn", "--jsn: unknown option of check (did you mean --json?); see hil-forceps check --help"),
    ],
)
def test_a_wrong_word_is_told_with_what_was_meant(call: Call, line: str, told: str) -> None:
    assert call(*line.split()) == (2, "", f"hil-forceps: {told}\n")


def test_a_rig_is_no_recording(call: Call) -> None:
    code, _, err = call("replay", PAPER)
    assert (code, err.count("\n")) == (2, 1)
    assert "paper.yaml: is a rig file, not a recording" in err


@pytest.mark.parametrize("line", [f"bench --config {UNKNOWN} --out o", f"run --rig {UNKNOWN} --out o --serial p"])
def test_what_a_rig_lacks_is_told_with_its_file(call: Call, line: str) -> None:
    code, _, err = call(*line.split(), "--quiet")
    assert code == 2
    assert all(each.startswith(f"hil-forceps: {UNKNOWN}: ") for each in err.splitlines())


def test_the_drive_tells_its_errors_in_the_programs_name(call: Call) -> None:
    code, _, err = call("drive", "--rig", "none.yaml", "--serial-pty", "p")
    assert code == 2
    assert err.startswith("hil-forceps: none.yaml: can't be read")


def test_the_newest_report_is_opened(call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    monkeypatch.setenv("DISPLAY", ":0")
    for place, name in enumerate(("new", "old")):
        path = tmp_path / "out" / name / "report.html"
        path.parent.mkdir(parents=True)
        path.touch()
        os.utime(path, (100 - place, 100 - place))
    assert call("open") == (0, "out/new/report.html\n", "")
    assert opened == [(tmp_path / "out" / "new" / "report.html").as_uri()]
    assert call("open", "out/old", "--print")[1] == "out/old/report.html\n"
    monkeypatch.delenv("DISPLAY")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    call("open")
    assert len(opened) == 1


@pytest.mark.parametrize("line", ["open", "open none", "open ."])
def test_no_report_is_told_in_one_line(call: Call, tmp_path: Path, line: str) -> None:
    (tmp_path / "some").mkdir()
    code, out, err = call(*line.split())
    assert (code, out, err.count("\n")) == (2, "", 1)


def test_json_of_the_commands_that_print_tables(call: Call) -> None:
    found = json.loads(call("check", PAPER, "--json")[1])
    assert found == {"rig": PAPER, "findings": []}
    found = json.loads(call("check", UNKNOWN, "--json")[1])["findings"]
    assert any(each["key"] == "forceps.wire_stiffness_N_per_m" and each["level"] == "note" for each in found)
    assert json.loads(call("info", "--json")[1])["libraries"]["numpy"]
    assert json.loads(call("info", "--rig", PAPER, "--json")[1])["wire_mode_rad_per_s"] > 1000
    line = "scan --interface virtual --channel nobody --seconds 0.05 --json"
    assert call(*line.split()) == (1, '{\n  "frames": 0,\n  "drives": []\n}\n', "")


def test_quiet_silences_notes_and_never_errors(call: Call) -> None:
    line = (
        "init",
        "r.yaml",
        "--motor",
        "paper",
        "--drive",
        "native",
        "--encoder-counts",
        "4096",
        "--current-limit",
        "1",
    )
    radii = ("--motor-pulley-radius-mm", "2", "--jaw-pulley-radius-mm", "1")
    assert "note: " in call(*line, *radii)[2]
    assert call(*line, *radii, "--overwrite", "--quiet")[2] == ""
    assert call("--quiet", *line, *radii, "--overwrite")[2] == ""
    assert "already exists" in call(*line, *radii, "--quiet")[2]


def test_a_log_gets_a_line_every_few_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    said = io.StringIO()
    monkeypatch.setattr(sys, "stderr", said)
    with last_told(lambda count: f"{count} samples", every_s=0.01) as tell:
        for count in range(1000):
            tell(count)
        for _ in range(500):
            if said.getvalue().count("\n") >= 2:
                break
            time.sleep(0.01)
    lines = said.getvalue().splitlines()
    assert len(lines) >= 2
    assert re.fullmatch(r" +\d+ s  999 samples", lines[-1])


def wide_table() -> Table:
    table = Table(title="Errors")
    for place in range(9):
        table.add_column(f"heading{place}\nmN m", no_wrap=True)
    for row in range(3):
        table.add_row(*(f"value{row}{place}" for place in range(9)))
    return table


@pytest.mark.parametrize("columns", [80, 200])
def test_no_word_of_a_table_is_cut(
    columns: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setenv("FORCE_COLOR", "1")  # as on a terminal
    monkeypatch.setenv("NO_COLOR", "1")
    assert 80 < least_width(wide_table()) < 200
    print_table(wide_table(), 100)
    out = re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().out)
    assert "…" not in out
    words = out.split()
    assert all(f"value{row}{place}" in words for row in range(3) for place in range(9))
    assert max(map(len, out.splitlines())) <= columns
