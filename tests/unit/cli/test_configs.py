"""`hil-forceps configs`: whoever has the package alone gets the example rig files that pages and messages name."""

from pathlib import Path

import pytest

from hil_forceps.cli.commands import configs as command
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.loading import load_rig

ROOT = Path(__file__).parents[3]
FILES = sorted(path.relative_to(ROOT / "configs") for path in (ROOT / "configs").rglob("*.yaml"))


def test_it_lists_every_example_with_its_title(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.configs() == 0
    lines = capsys.readouterr().out.splitlines()
    titles = {line.split()[0]: line[command.NAME_WIDTH :] for line in lines}
    assert sorted(titles) == sorted(path.with_suffix("").as_posix() for path in FILES)
    assert titles["paper"].startswith("The forceps of the paper, with ideal sensors")
    assert all(len(title) > 20 for title in titles.values())
    assert max(map(len, lines)) <= 80


@pytest.mark.parametrize("name", ["drives/odrive", "configs/drives/odrive.yaml", "drives/odrive.yaml"])
def test_it_prints_an_example_however_a_page_names_it(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert command.configs(name) == 0
    assert capsys.readouterr().out == (ROOT / "configs" / "drives" / "odrive.yaml").read_text()


def test_it_writes_them_to_where_the_commands_of_the_pages_expect_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match="or write the examples with `hil-forceps configs --out configs`"):
        load_rig("configs/realistic.yaml")
    assert command.configs(out=Path("configs")) == 0
    assert load_rig("configs/realistic.yaml") == load_rig(ROOT / "configs" / "realistic.yaml")
    assert sorted(path.relative_to("configs") for path in Path("configs").rglob("*.yaml")) == FILES


def test_it_writes_one(tmp_path: Path) -> None:
    assert command.configs("paper", out=tmp_path) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["paper.yaml"]


def test_it_spoils_no_file_that_somebody_changed(tmp_path: Path) -> None:
    command.configs(out=tmp_path)
    command.configs(out=tmp_path)  # the same again is nothing new
    mine = tmp_path / "drives" / "odrive.yaml"
    mine.write_text("forceps: {}\n")
    (tmp_path / "paper.yaml").unlink()
    with pytest.raises(UserError, match=r"odrive\.yaml: already exists; name another folder, or use --overwrite"):
        command.configs(out=tmp_path)
    assert mine.read_text() == "forceps: {}\n"
    assert not (tmp_path / "paper.yaml").exists()
    command.configs(out=tmp_path, overwrite=True)
    assert mine.read_bytes() == (ROOT / "configs" / "drives" / "odrive.yaml").read_bytes()


def test_an_example_that_is_not_there_is_told_with_the_nearest() -> None:
    with pytest.raises(UserError, match=r"realistc: no such example; did you mean realistic\?"):
        command.configs("realistc")
    with pytest.raises(UserError, match="`hil-forceps configs` lists all"):
        command.configs("../pyproject")


def test_without_examples_it_says_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(command, "FOLDERS", (tmp_path,))
    with pytest.raises(UserError, match="the example rig files are missing"):
        command.configs()
