"""Every broken file beside its exact error lines: NAME.yaml and NAME.txt in `broken_rigs`."""

from pathlib import Path

import pytest

from hil_forceps.rig import UserError, load_rig

FOLDER = Path(__file__).parent / "broken_rigs"
NAMES = sorted(path.stem for path in FOLDER.glob("*.yaml"))


def test_there_are_enough_of_them_and_each_has_its_lines() -> None:
    assert len(NAMES) >= 30
    assert sorted(path.stem for path in FOLDER.glob("*.txt")) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_broken_file_gives_exactly_these_lines(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(FOLDER)
    expected = (FOLDER / f"{name}.txt").read_text(encoding="utf-8").splitlines()
    with pytest.raises(UserError) as caught:
        load_rig(f"{name}.yaml")
    assert list(caught.value.problems) == expected


@pytest.mark.parametrize("name", NAMES)
def test_every_line_says_where_what_and_what_to_do(name: str) -> None:
    for line in (FOLDER / f"{name}.txt").read_text(encoding="utf-8").splitlines():
        assert line.startswith(f"{name}.yaml:"), line
        assert line.split(":")[1].isdigit(), line
        assert ";" in line or line.endswith("?"), line


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"nowhere\.yaml: can't be read: No such file or directory; check the path"):
        load_rig(tmp_path / "nowhere.yaml")


def test_a_folder(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="is a folder; name a rig file"):
        load_rig(tmp_path)


def test_a_path_with_a_nul() -> None:
    with pytest.raises(UserError, match="can't be read"):
        load_rig("a\0b")


def test_a_file_that_is_far_too_long_is_not_read_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "long.yaml"
    with path.open("wb") as file:
        file.truncate(1 << 40)  # sparse: a terabyte of noughts that takes no room
    with pytest.raises(UserError, match="not a rig file"):
        load_rig(path)


SIZE = 64 * 1024


@pytest.mark.parametrize(
    "text",
    [
        "a: &a [x, x]\n" + "".join(f"b{n}: &b{n} [*a, *a]\n" for n in range(3000)),
        *(
            word * (SIZE // len(word))
            for word in ("{", "[", "- ", "? ", '"', ":", "a: ", "%", "---\n", "- a\n", "a: 1\n")
        ),
        "".join(f"k{n}: 1\n" for n in range(6000)),
        "[" + "," * (SIZE - 2) + "]",
        "{" + "a," * (SIZE // 2 - 2) + "}",
        "a: " + "&a " * (SIZE // 3 - 3),
        "a: " + "!a " * (SIZE // 3 - 3),
        "a: " + "x" * (SIZE - 3),
        'a: "' + "\\x" * (SIZE // 2 - 4),
        "a: [" + "{a: b}, " * (SIZE // 8 - 4) + "]",
    ],
    ids=lambda text: text[:8],
)
def test_as_large_as_a_file_may_be_and_made_to_take_long(text: str, tmp_path: Path) -> None:
    """References that multiply, nesting, one endless line: refused in a bounded number of short lines."""
    (tmp_path / "r.yaml").write_text(text)
    with pytest.raises(UserError) as caught:
        load_rig(tmp_path / "r.yaml")
    assert 1 <= len(caught.value.problems) <= 101
    assert max(map(len, caught.value.problems)) < 400
