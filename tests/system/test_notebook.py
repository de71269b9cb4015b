"""The notebook of docs/notebooks, cell by cell: what it shows is what its words say."""

import importlib.util
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pytest

NOTEBOOK = Path(__file__).parents[2] / "docs" / "notebooks" / "hidden_effect.py"


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # of the notebook's own machinery
def test_the_hidden_effect_is_found_and_knowing_it_gains(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(mpl.rcParams, "backend", "agg")
    spec = importlib.util.spec_from_file_location("hidden_effect", NOTEBOOK)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    shown, names = module.app.run()  # raises where a cell does
    result: Any = names["result"]
    assert result in shown
    assert (result.verdict, [cause.id for cause in result.causes]) == ("effects", ["viscous_asymmetry"])
    assert names["found"].low <= names["true_difference"] <= names["found"].high
    assert names["after"].rmse("current_A") < 0.5 * names["before"].rmse("current_A")
    assert names["errors_N_m"]["after"] < 0.75 * names["errors_N_m"]["before"]
