"""The names of `hil_forceps`: few, all there, and importing the package loads none of what they need."""

import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import get_type_hints

import pytest

import hil_forceps as hf

ROOT = Path(__file__).parents[3]

COUNT = """
import sys
before = set(sys.modules)
import hil_forceps
loaded = sorted(set(sys.modules) - before)
print(len(loaded), *[name for name in loaded if name.startswith("hil_forceps.")])
hil_forceps.load_rig, hil_forceps.read_runs
print(*(name in sys.modules for name in ("numba", "scipy", "matplotlib", "can", "rich", "pandas", "polars")))
"""


def test_importing_loads_nothing_and_rigs_and_runs_need_no_compiler() -> None:
    done = subprocess.run([sys.executable, "-c", COUNT], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded, heavy = done.stdout.splitlines()
    assert len(loaded.split()) == 1  # no module of ours but itself
    assert int(loaded.split()[0]) < 30  # `typing` and `importlib` with what they are made of
    assert heavy == " ".join(["False"] * 7)


def test_names_are_few_documented_and_found() -> None:
    assert len(hf.__all__) <= 18
    assert set(hf.__all__) <= set(dir(hf))
    for name in hf.__all__:
        value = getattr(hf, name)
        assert value.__doc__
        assert value.__name__ == name
    assert hf.diagnose is import_module("hil_forceps.api.diagnosis").diagnose
    for function in (hf.diagnose, hf.read_runs, hf.simulate, hf.track, hf.trend, hf.virtual_bench, hf.load_rig):
        assert "return" in get_type_hints(function)


def test_a_name_that_is_not_there_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="'hil_forceps' has no attribute 'diagnosr'"):
        _ = hf.diagnosr  # type: ignore[attr-defined]
