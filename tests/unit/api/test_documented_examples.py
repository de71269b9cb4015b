"""docs/python-api.md: every name has an example, the examples run in their order, and type checkers agree with them."""

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import hil_forceps as hf
from hil_forceps.data.readers.csv_table import write_csv

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "python-api.md").read_text(encoding="utf-8")
_BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
BLOCKS = _BLOCK.findall(PAGE)
README = _BLOCK.findall((ROOT / "README.md").read_text(encoding="utf-8"))


def test_every_name_is_in_the_table_and_what_is_called_is_in_an_example() -> None:
    table = {name for row in re.findall(r"^\| (`.*?) \|", PAGE, re.MULTILINE) for name in re.findall(r"`(\w+)`", row)}
    assert table == set(hf.__all__)
    code = "\n".join(BLOCKS)
    results = {"Run", "Rig", "Simulation", "DiagnosisResult", "TrendResult"}  # come out of functions
    assert [name for name in table - results if f"hf.{name}" not in code] == []


@pytest.mark.slow
def test_the_examples_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, forceps_bench: Callable[..., hf.VirtualBench]
) -> None:
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "examples"}
    for block in BLOCKS:
        line = PAGE[: PAGE.index(block)].count("\n")
        exec(compile("\n" * line + block, "docs/python-api.md", "exec"), names)
    names["test_the_estimate_is_near"](forceps_bench)

    result = names["result"]
    assert (result.verdict, [cause.id for cause in result.causes]) == ("effects", ["viscous_asymmetry"])
    (found,) = (each for each in result.parameters if each.name.startswith("effects."))
    assert found.name == "effects.viscous_asymmetry.difference_N_m_s_per_rad"
    assert found.value == pytest.approx(4e-5, rel=0.05)
    assert result.gain["current_A"].explained_share > 0.9
    assert names["better"].rmse("current_A") < 0.5 * names["beside"].rmse("current_A")
    assert names["estimate"] == (names["whole"].tau_w_N_m[-1], names["whole"].elongation_m[-1])
    assert (names["third"].ok, names["third"].reason) == (True, "completed")
    assert {path.name for path in (tmp_path / "today").iterdir()} == {"run.mcap", "bus.log"}
    assert "<script" not in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_the_lines_of_the_readme_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    monkeypatch.chdir(tmp_path)
    # A motor that stands still ends a diagnosis at once.
    still = hf.simulate("configs/realistic.yaml", hf.Trajectory((0.0, 1.0), (1.0, 1.0))).to_run()
    write_csv(still, "day1.csv")
    write_csv(still, "day2.csv")
    names: dict[str, Any] = {}
    (block,) = README
    exec(compile(block, "README.md", "exec"), names)
    assert [run.name for run in names["runs"]] == ["day1", "day2"]
    assert names["result"].verdict == "undetermined"


WRONG = """
from typing import assert_type
import hil_forceps as hf

assert_type(hf.read_runs("a.csv"), list[hf.Run])
assert_type(hf.Estimator("kalman", "rig.yaml", 1e-3).step(0.0, 0.0).tau_w_N_m, float)
hf.diagnose("a.csv", 3)
hf.simulate("rig.yaml", "a.csv")
hf.diagnose("a.csv", "rig.yaml").verdict = "effects"
hf.nothing_of_this_name
"""


@pytest.mark.slow
def test_type_checkers_take_the_examples_and_refuse_wrong_calls(tmp_path: Path) -> None:
    (tmp_path / "examples.py").write_text("\n\n".join(BLOCKS))
    (tmp_path / "readme.py").write_text(README[0])
    (tmp_path / "wrong.py").write_text(WRONG)
    files = [str(tmp_path / name) for name in ("examples.py", "readme.py", "wrong.py")]
    command = [sys.executable, "-m", "mypy", "--strict", "--no-error-summary", *files]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    places = re.findall(r"^\S*?(\w+)\.py:(\d+): error", done.stdout, re.MULTILINE)
    assert places == [("wrong", str(line)) for line in (7, 8, 9, 10)], done.stdout + done.stderr
