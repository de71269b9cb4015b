"""No name out of data becomes a path out of the folder for results."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from hil_forceps.cli import main as cli
from hil_forceps.cli.arguments.files import MAX_NAME_BYTES, file_name, make_folder
from hil_forceps.cli.commands.measured import import_
from hil_forceps.data.run import Run
from hil_forceps.rig.errors import UserError

CONFIGS = Path(__file__).parents[3] / "configs"
HOSTILE = ("../../x", "/etc/x", "a/b", "..", ".", "...", "a\0b", "n" * 5000, "é" * 300, "\x1b[2J", "../" * 50 + "x")


@pytest.mark.parametrize("name", HOSTILE)
def test_a_name_is_one_step(name: str, tmp_path: Path) -> None:
    made = file_name(name)
    path = tmp_path / f"{made}.csv"
    path.write_text("x")
    assert path.resolve().parent == tmp_path.resolve()
    assert len(made.encode()) <= MAX_NAME_BYTES


@given(st.text(max_size=400))
def test_no_name_leaves_its_folder(name: str) -> None:
    made = file_name(name.encode("utf-8", "replace").decode())
    assert "/" not in made
    assert "\0" not in made
    assert made not in {".", ".."}


@pytest.mark.parametrize("name", ["sine_1", "day 1#2", "left.v2", "Lauf-ä"])
def test_a_usual_name_stays(name: str) -> None:
    assert file_name(name) == name


@pytest.mark.parametrize("name", HOSTILE)
def test_import_writes_into_its_folder_alone(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    source, out = tmp_path / "deep" / "in" / "a.csv", tmp_path / "deep" / "in" / "out"
    source.parent.mkdir(parents=True)
    source.write_text("x")
    time_s: NDArray[np.float64] = np.linspace(0.0, 0.3, 300)
    run = Run(name, {"time_s": time_s, "theta_m_rad": np.sin(9.0 * time_s), "current_A": np.cos(7.0 * time_s)})
    monkeypatch.setattr(import_, "read_sources", lambda *_, **__: [(source, run)])
    before = set(tmp_path.rglob("*"))
    with pytest.raises(SystemExit) as ended:
        cli.main(["import", str(source), "--out", str(out)])
    assert ended.value.code == 0, capsys.readouterr().err
    new = set(tmp_path.rglob("*")) - before - {out}
    assert len(new) == 1
    assert next(iter(new)).parent == out


def test_links_out_of_the_folder_are_refused(tmp_path: Path) -> None:
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    out.mkdir()
    elsewhere.write_text("kept")
    (out / "run.json").symlink_to(elsewhere)
    with pytest.raises(UserError, match=r"run\.json in it links out of it"):
        make_folder(out)
    assert elsewhere.read_text() == "kept"
    (out / "run.json").unlink()
    (out / "today").mkdir()
    (out / "latest").symlink_to(out / "today")  # inside
    make_folder(out)
    (out / "circle").symlink_to(out / "circle")
    with pytest.raises(UserError, match="circle"):
        make_folder(out)


def test_a_folder_within_is_no_link_out(tmp_path: Path) -> None:
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    out.mkdir()
    elsewhere.mkdir()
    (out / "left").symlink_to(elsewhere)
    make_folder(out)  # a link to a folder that nothing is written to
    with pytest.raises(UserError, match="left in it links out of it"):
        make_folder(out / "left", inside=out)
    make_folder(out / "right", inside=out)
    make_folder(out, inside=out)


def test_a_folder_that_is_a_link_itself_is_the_users_choice(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "real")
    make_folder(tmp_path / "out")
    assert list((tmp_path / "real").iterdir()) == []


def test_a_run_does_not_follow_a_planted_link(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, victim = tmp_path / "out", tmp_path / "victim"
    out.mkdir()
    victim.write_text("kept")
    (out / "run.mcap").symlink_to(victim)
    rig = CONFIGS / "realistic.yaml"
    channel = ("--interface", "virtual_forceps", "--channel", str(tmp_path), "--option", f"rig={rig}")
    with pytest.raises(SystemExit) as ended:
        cli.main(["run", "--rig", str(rig), *channel, "--duration", "0.1", "--out", str(out)])
    assert ended.value.code == 2
    assert "run.mcap in it links out of it" in capsys.readouterr().err
    assert victim.read_text() == "kept"


def test_a_rig_named_like_the_folder_above_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig, other = tmp_path / "...yaml", tmp_path / "other.yaml"
    for path in (rig, other):
        path.write_text((CONFIGS / "realistic.yaml").read_text(encoding="utf-8"), encoding="utf-8")
    with pytest.raises(SystemExit) as ended:
        cli.main(
            ["run", "--rig", str(rig), "--rig", str(other), "--interface", "virtual", "--out", str(tmp_path / "o")]
        )
    assert ended.value.code == 2
    assert "can't be .." in capsys.readouterr().err
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize("key", ["extends", "include", "<<", "!include"])
def test_a_rig_file_takes_no_other_file_in(key: str, tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    text = (CONFIGS / "realistic.yaml").read_text(encoding="utf-8")
    rig.write_text(f"{key}: /etc/passwd\n{text}" if key != "!include" else f"x: !include /etc/passwd\n{text}")
    with pytest.raises(SystemExit) as ended:
        cli.main(["check", str(rig)])
    assert ended.value.code == 2
