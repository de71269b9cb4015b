"""`hil-forceps docs`: whoever has the package alone reads the pages that its messages name."""

import re
from pathlib import Path

import pytest

from hil_forceps.cli.commands import docs as command
from hil_forceps.rig.errors import UserError

ROOT = Path(__file__).parents[3]
NAMED = re.compile(r"docs/((?:tutorials/|drives/)?[a-z-]+)\.md")  # docs/protocol/… are another project's


def test_it_lists_every_page_with_its_title(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.docs() == 0
    lines = capsys.readouterr().out.splitlines()
    titles = {line.split()[0]: line[command.NAME_WIDTH :] for line in lines}
    assert titles["rig-file"] == "The rig file"
    assert titles["tutorials/your-own-logs"] == "Your own logs"
    assert len(titles) == len([p for p in (ROOT / "docs").rglob("*.md") if "decisions" not in p.parts])


@pytest.mark.parametrize("name", ["rig-file", "docs/rig-file.md", "rig-file.md", "docs/rig-file.md#bench"])
def test_it_prints_a_page_however_a_message_names_it(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert command.docs(name) == 0
    assert capsys.readouterr().out == (ROOT / "docs" / "rig-file.md").read_text()


def test_a_page_that_is_not_there_is_told_with_the_nearest() -> None:
    with pytest.raises(UserError, match=r"glossry: no such page; did you mean glossary\?"):
        command.docs("glossry")
    with pytest.raises(UserError, match="`hil-forceps docs` lists all"):
        command.docs("../../pyproject.toml")


def test_without_pages_it_says_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(command, "FOLDERS", (tmp_path,))
    with pytest.raises(UserError, match="the pages are missing"):
        command.docs()


def test_every_page_that_the_program_names_is_there() -> None:
    sources = [path for name in command.PACKAGE.parent.glob("*/__init__.py") for path in name.parent.rglob("*.py")]
    named = {
        page
        for path in sources
        if path.relative_to(ROOT).parts[0] in {"hil_forceps", "firmware_protocol", "virtual_bus"}
        for page in NAMED.findall(path.read_text())
    }
    assert len(named) > 10
    assert named - {page.name for page in command.pages()} == set()
