"""At 80 columns no word is broken: the help of every command, and every table that a command prints."""

import inspect
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from hil_forceps.cli import main as cli
from hil_forceps.cli.examples import EXAMPLES

ROOT = Path(__file__).parents[3]
COLUMNS = 80
CLI = ROOT / "hil_forceps" / "cli"
Call = Callable[..., str]


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Call:
    """Run a command on a terminal of 80 columns; return what it writes, without colours."""
    monkeypatch.setenv("COLUMNS", str(COLUMNS))
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("NO_COLOR", "1")

    def run(*arguments: str) -> str:
        with pytest.raises(SystemExit):
            cli.main(list(arguments))
        return re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().out)

    return run


def words_of(command: str) -> Iterator[str]:
    """Yield the words of a command's docstring, and of its options."""
    text = inspect.getdoc(cli.app[command].default_command) or ""
    about, _, parameters = text.partition("Parameters\n----------\n")
    described = [line for line in parameters.splitlines() if line.startswith("    ")]
    yield from (word for line in (about, *described) for word in re.sub("[`*]", "", line).split())
    for argument in cli.app[command].assemble_argument_collection():
        yield from (name for name in argument.names if name.startswith("--") and "--empty-" not in name)


@pytest.mark.parametrize("command", [name for name in EXAMPLES if name != "drive"])
def test_no_word_of_a_help_is_broken(call: Call, command: str) -> None:
    out = call(command, "--help")
    assert max(map(len, out.splitlines())) <= COLUMNS
    found = set(out.replace("│", " ").split())
    wanted = set(words_of(command))
    assert len(wanted) > 15
    assert sorted(wanted - found) == []
    assert "--empty-" not in out
    assert "--no-json" not in out


def test_the_list_of_commands_fits(call: Call) -> None:
    out = call("--help")
    assert max(map(len, out.splitlines())) <= COLUMNS
    assert set(EXAMPLES) <= set(out.replace("│", " ").split())


def test_every_table_goes_through_the_one_place_that_breaks_no_word() -> None:
    """`test_small_things` shows that `print_table` breaks none; nobody prints a table otherwise."""
    users = {
        path.name: path.read_text(encoding="utf-8") for path in CLI.rglob("*.py") if path.name not in {"tables.py"}
    }
    for name, text in users.items():
        assert "Console().print(" not in text, name
        if re.search(r"\bTable\(", text):
            assert "print_table(" in text, name
    assert sum("print_table(" in text for text in users.values()) >= 4


def test_the_audit_of_a_run_with_a_long_name_is_whole(call: Call, tmp_path: Path) -> None:
    name = "a_run_whose_name_is_longer_than_a_column_of_a_terminal"
    rows = "".join(f"{n * 1e-3:.3f},{0.001 * n},0.1\n" for n in range(60) if n != 30)
    (tmp_path / f"{name}.csv").write_text(f"time_s,theta_m_rad,current_A\n{rows}")
    out = call("import", str(tmp_path / f"{name}.csv"), "--out", str(tmp_path / "out"))
    assert name in out.split()
    assert "…" not in out
