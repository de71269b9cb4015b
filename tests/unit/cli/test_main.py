"""The command line as a user meets it: help, exit codes, and one clear line for each thing that is wrong."""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from hil_forceps import __version__
from hil_forceps.cli import main as cli
from hil_forceps.rig.errors import UserError

ROOT = Path(__file__).parents[3]
PAPER = str(ROOT / "configs" / "paper.yaml")
TOOL = str(ROOT / "configs" / "surgical_tool.yaml")
COMMANDS = (
    "bench",
    "run",
    "drive",
    "conformance",
    "decode",
    "diagnose",
    "import",
    "simulate",
    "fmu",
    "replay",
    "recover",
    "explain",
    "init",
    "schema",
    "configs",
    "docs",
    "open",
    "check",
    "scan",
    "info",
)
HEAVY = ("numba", "numpy", "matplotlib", "can", "scipy", "pydantic", "serial", "mcap", "cantools", "zstandard")


class Said(NamedTuple):
    """How a command ended and what it said."""

    code: int
    out: str
    err: str


Call = Callable[..., Said]


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Call:
    """Run a command in this process, in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> Said:
        with pytest.raises(SystemExit) as ended:
            cli.main(list(arguments))
        out, err = capsys.readouterr()
        assert isinstance(ended.value.code, int)
        return Said(ended.value.code, out, err)

    return run


def test_every_command_is_listed(call: Call) -> None:
    said = call("--help")
    assert (said.code, said.err) == (0, "")
    assert all(re.search(rf"^\W*{command}\b", said.out, re.MULTILINE) for command in COMMANDS)
    assert "Not a medical device" in " ".join(said.out.split())


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(call: Call, command: str) -> None:
    said = call(command, "--help")
    assert (said.code, said.err) == (0, "")
    assert f"hil-forceps {command}" in said.out


@pytest.mark.parametrize(
    ("command", "options"),
    [
        ("bench", "--config --out --seed --simulation --algorithm --jobs --realtime --wire --estimator-rig"),
        ("run", "--rig --out --interface --channel --serial --algorithm --trajectory --duration --bus-log"),
        ("drive", "--rig --interface --channel --serial-pty --simulation --seed --faults --duration"),
        ("replay", "--rig --out --algorithm"),
        ("decode", "--form"),
        ("info", "--rig"),
    ],
)
def test_help_names_the_options(call: Call, command: str, options: str) -> None:
    out = call(command, "--help").out
    assert [option for option in options.split() if not re.search(rf"{option}\b", out)] == []


def test_version_is_that_of_the_package(call: Call) -> None:
    assert call("--version") == Said(0, f"{__version__}\n", "")


@pytest.mark.parametrize("arguments", [["--help"], ["--version"]])
def test_nothing_heavy_is_imported_to_answer_at_once(arguments: list[str]) -> None:
    script = (
        "import json, sys\nfrom hil_forceps.cli.main import main\n"
        "try:\n    main(sys.argv[1:])\nexcept SystemExit:\n    pass\n"
        "print('MODULES', json.dumps(sorted(sys.modules)))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, *arguments],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    )
    modules = set(json.loads(done.stdout.partition("MODULES")[2]))
    assert modules & set(HEAVY) == set()
    assert "hil_forceps.cli.main" in modules


def test_installed_command_is_this_one() -> None:
    command = shutil.which("hil-forceps", path=str(Path(sys.executable).parent))
    if command is None:
        pytest.skip("hil-forceps is not installed beside this interpreter")
    done = subprocess.run([command, "--version"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{__version__}\n", "")


# What a user gets wrong: the words after `hil-forceps`, and what its one line has to name.
WRONG = [
    ("nonsense", "nonsense"),
    ("bench", "--config"),
    (f"bench --config {PAPER}", "--out"),
    (f"bench --config {PAPER} --out o --frob", "--frob"),
    (f"bench --config {PAPER} --out o --seed x", "--seed"),
    (f"bench --config {PAPER} --out o --seed -1", "--seed"),
    (f"bench --config {PAPER} --out o --jobs 0", "--jobs"),
    (f"bench --config {PAPER} --out o --algorithm nope", "previous, improved_as_published, improved, kalman"),
    (f"bench --config {PAPER} --out o --simulation 3", "--simulation 3: this bench has 1, 2"),
    (f"bench --config {PAPER} --out o --realtime --wire string", "--wire"),
    (f"bench --config {PAPER} --out o --duration 30", "--realtime"),
    (f"bench --config {PAPER} --out o --realtime --duration 5", "--duration 5: must be 20 to"),
    (f"bench --config {PAPER} --out o --realtime --duration nan", "--duration nan: must be 20 to"),
    ("bench --config none.yaml --out o", "none.yaml: can't be read: No such file"),
    ("bench --config . --out o", ".: is a folder; name a rig file (YAML)"),
    (f"bench --config {PAPER} --out file", "--out file: can't be written to"),
    (f"bench --config {PAPER} --out file/o", "--out file/o: can't be written to"),
    (f"bench --config {PAPER} --out /proc/o", "--out /proc/o: can't be written to"),
    ("bench --config empty --out o", "empty"),
    ("run --rig none.yaml --out o --serial p", "none.yaml: can't be read"),
    (f"run --rig {PAPER} --out o", "the drive's line is missing; give either a CAN interface"),
    (f"run --rig {PAPER} --out o --interface virtual --serial p", "there are both; give either a CAN interface"),
    (f"run --rig {PAPER} --out o --serial /dev/no-such-port", "there is no such port"),
    (f"run --rig {PAPER} --out o --serial file", "file: can't be opened"),
    (f"run --rig {PAPER} --out o --serial no-such-kind://x", "no-such-kind://x: can't be opened"),
    (f"run --rig {PAPER} --out o --interface no_such --channel x", "no_such:x: unknown CAN interface"),
    (f"run --rig {PAPER} --out o --interface socketcan --channel nocan7", "socketcan:nocan7: can't be opened"),
    (
        f"run --rig {PAPER} --out o --interface virtual_forceps --channel x",
        "; say what is there by the option rig=RIG.yaml",
    ),
    (f"run --rig {PAPER} --out o --interface virtual --channel x --option a", "a: must be KEY=VALUE, such as "),
    (f"run --rig {PAPER} --out o --interface udp_multicast --channel 239.74.163.9 --option port=x", "port"),
    (f"run --rig {PAPER} --out o --interface virtual --channel x --algorithm nope", "unknown algorithm 'nope'"),
    (f"run --rig {PAPER} --out o --serial p --duration nan", "--duration nan"),
    (f"run --rig {PAPER} --out o --serial p --duration 0", "--duration 0"),
    (f"run --rig {PAPER} --out o --serial p --trajectory none.csv", "none.csv: can't be read"),
    (f"run --rig {PAPER} --out o --serial p --trajectory empty", "theta_j_rad; correct it"),
    (f"run --rig {PAPER} --out o --serial p --bus-log txt", "--bus-log"),
    (f"run --rig {PAPER} --out file --serial p", "--out file: can't be written to"),
    (f"run --rig {TOOL} --out o --serial p", "limits: is missing"),
    (f"drive --kind none --rig {PAPER} --serial-pty p", "--kind none: no such drive is installed"),
    ("replay none.mcap", "none.mcap: no such file"),
    ("replay empty.mcap", "empty.mcap: not an MCAP file"),
    ("replay foreign.mcap", "foreign.mcap: not an MCAP file"),
    ("replay empty", "empty: is not a recording (*.mcap); for runs of an instrument add --rig"),
    ("replay emptydir", "emptydir: contains no run.mcap; name the folder of a run, or its recording; for runs"),
    ("replay fault.json", "fault.json: contains only the last second of a run; name its run.mcap"),
    ("import none.mcap --out o", "none.mcap: no such file or folder; check the path"),
    ("import emptydir --out o", "emptydir: contains no run; name files, or a folder of files"),
    ("import --out o", "SOURCE: missing; name files or folders"),
    ("explain fault.json", "fault.json: is not a valid fault.json: 'drive' is missing; use run.mcap"),
    ("explain empty.json", "empty.json: is not a valid fault.json: it is not JSON in UTF-8; use run.mcap"),
    ("explain emptydir", "emptydir: contains no run.mcap; name the folder of a run"),
    ("info empty.mcap", "empty.mcap: is a run, not a rig file; name a rig file, or use hil-forceps explain empty.mcap"),
    ("info emptydir", "emptydir: is a folder; name a rig file (YAML)"),
    (f"doctor --rig {PAPER}", "the line to its drive is missing; give --interface and --channel, or --serial"),
    ("doctor --interface foo", "foo: unknown CAN interface; known interfaces: "),
    (f"replay empty --rig {TOOL} --out o", "empty: "),
    (f"replay . --rig {TOOL} --out o", "contains no run"),
    ("info --rig none.yaml", "none.yaml: can't be read"),
]


@pytest.mark.parametrize(("line", "words"), WRONG, ids=[line.replace(str(ROOT), "") for line, _ in WRONG])
def test_what_is_wrong_is_told_in_one_line(call: Call, tmp_path: Path, line: str, words: str) -> None:
    for name in ("empty", "empty.mcap", "empty.json"):
        (tmp_path / name).touch()
    (tmp_path / "emptydir").mkdir()
    (tmp_path / "fault.json").write_text('{"format": 1}')
    for name in ("file", "foreign.mcap"):
        (tmp_path / name).write_text("this is something else\n" * 10)
    before = sorted(tmp_path.iterdir())
    said = call(*line.split())
    assert sorted(tmp_path.iterdir()) == before, "a command that is refused leaves nothing behind"
    assert said.code == 2
    assert said.out == ""
    lines = [each for each in said.err.splitlines() if not each.startswith("Compiling")]
    assert len(lines) == 1, said.err
    assert lines[0].startswith("hil-forceps: ")
    assert words in lines[0] or "--seed" in words
    assert "Traceback" not in said.err


@pytest.mark.parametrize("command", ["bench --config", "run --serial p --rig"])
def test_broken_rig_has_a_line_for_each_problem(call: Call, command: str) -> None:
    broken = ROOT / "tests" / "unit" / "rig" / "broken_rigs" / "many_at_once.yaml"
    said = call(*command.split(), str(broken), "--out", "o")
    wanted = broken.with_suffix(".txt").read_text().splitlines()
    assert said.code == 2
    assert [line.replace(f"{broken.parent}/", "") for line in said.err.splitlines()] == [
        f"hil-forceps: {line}" for line in wanted
    ]
    assert not Path("o").exists()


def test_bench_without_what_it_needs_names_all_of_it(call: Call) -> None:
    said = call("bench", "--config", TOOL, "--out", "o")
    assert said.code == 2
    assert "drive: the section is missing" in said.err
    assert "forceps.motor_pulley_radius_m" in said.err


def test_trajectory_file_is_checked_to_the_line(call: Call, tmp_path: Path) -> None:
    table, from_zero = tmp_path / "t.csv", "from the first operational sample"
    for rows, words in [
        ("0,1\n1\n", ":3: '1' is not two finite numbers; correct the line"),
        ("0,1\n0,1\n", ":3: time_s does not increase; sort the points, and remove duplicate times"),
        (
            "-5,1\n0,1\n",
            f":2: time_s -5 is negative, but time counts {from_zero}; begin the trajectory at 0 or later",
        ),
        ("0,inf\n", ":2: '0,inf' is not two finite numbers; correct the line"),
        ("0,x\n", ":2: '0,x' is not two finite numbers; correct the line"),
        ("0,1\n1,2", ":3: the last line has no line end and may be cut off; complete it"),
        ("", ": contains no points; add a line time_s,theta_j_rad for each"),
    ]:
        table.write_text("time_s,theta_j_rad\n" + rows)
        said = call("run", "--rig", PAPER, "--out", "o", "--serial", "p", "--trajectory", str(table))
        assert (said.code, said.out) == (2, "")
        assert said.err == f"hil-forceps: {table}{words}\n"


def fails_with(error: BaseException) -> Callable[..., None]:
    def fail(*_: object, **__: object) -> None:
        raise error

    return fail


@pytest.mark.parametrize(
    ("error", "code", "err"),
    [
        (UserError(["one", "two"]), 2, "hil-forceps: one\nhil-forceps: two\n"),
        (OSError(28, "No space left on device", "o/summary.json"), 2, "o/summary.json: No space left on device\n"),
        (KeyboardInterrupt(), 130, "hil-forceps: interrupted\n"),
    ],
)
def test_errors_become_lines_and_exit_codes(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], error: BaseException, code: int, err: str
) -> None:
    monkeypatch.setattr(cli, "app", fails_with(error))
    monkeypatch.setattr(cli, "_drop_output", lambda: None)
    with pytest.raises(SystemExit) as ended:
        cli.main([])
    assert ended.value.code == code
    assert capfd.readouterr().err.endswith(err)


def test_fault_of_the_program_is_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cli, "app", fails_with(RuntimeError("ours")))
    with pytest.raises(RuntimeError, match="ours"):
        cli.main([])


def test_info_says_what_is_there(call: Call) -> None:
    said = call("info")
    assert (said.code, said.err) == (0, "")
    assert f"hil-forceps {__version__}, protocol 1." in said.out
    assert "not a medical device" in said.out
    assert re.search(r"CAN interfaces from plugins: .*virtual_forceps", said.out)
    assert re.search(r"drives for .*: .*simulated", said.out)


def test_info_explains_a_rig(call: Call) -> None:
    said = call("info", "--rig", PAPER)
    assert (said.code, said.err) == (0, "")
    assert "wire mode, undamped: 2003.6 rad/s" in said.out  # sqrt(k (r_m²/I_m + r_j²/I_j)) of Table I
