"""The comparison on held-out runs: the whole path on simulated runs, black boxes, and on the real data cut small."""

import json
import os
import zipfile
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from hil_forceps.cli.main import main
from hil_forceps.identification.instrument import black_boxes as boxes
from hil_forceps.identification.instrument.comparison import EXTENDED, PUBLISHED_PROTOCOL, Comparison
from hil_forceps.identification.instrument.comparison_files import comparison_tables, write_comparison
from hil_forceps.identification.instrument.evaluation import compare_instrument, read_instrument
from hil_forceps.identification.instrument.report import CLOSING, WHOLE
from hil_forceps.identification.instrument.splits import ODD_LOADS
from hil_forceps.report.identification.comparison import write_comparison_figures
from hil_forceps.rig import load_rig
from hil_forceps.rig.errors import UserError

ROOT = Path(__file__).parents[3]
DATA = Path(os.environ.get("HIL_FORCEPS_DATA", ROOT.parent / "shared" / "data")) / "surgical_tool"
SETS = {"left": "Tool_4_Maryland_L_4", "right": "Tool_4_Maryland_R_5"}
RIG = ROOT / "configs" / "surgical_tool.yaml"
LEVELS = "0123"
KEPT_LINES = 12_000


@pytest.fixture(scope="module", params=SETS)
def compared(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    """Four loads at the middle frequency and at the highest, 12 s each."""
    if not DATA.is_dir():
        pytest.skip(f"no surgical-tool data at {DATA}; set HIL_FORCEPS_DATA to read them")
    small = tmp_path_factory.mktemp("cut") / "small.zip"
    name = SETS[request.param]
    with zipfile.ZipFile(DATA / f"{name}.zip") as whole, zipfile.ZipFile(small, "w", zipfile.ZIP_DEFLATED) as part:
        for member in (f"{x}{y}.TXT" for x in "23" for y in LEVELS):
            lines = whole.read(f"{name}/{member}").split(b"\n")[:KEPT_LINES]
            part.writestr(f"{name}/{member}", b"\n".join(lines))
    return compare_instrument(read_instrument(small), load_rig(RIG))


@pytest.mark.shared_data
def test_on_loads_held_out_it_beats_what_it_is_compared_with(compared: Comparison, tmp_path: Path) -> None:
    odd = next(split for split in compared.splits if split.name == ODD_LOADS)
    assert sorted(odd.held_out) == ["21", "23", "31", "33"]
    for source in ("tau_m_N_m", "current_A"):
        for part in (WHOLE, CLOSING):
            scores = {s.method: s for s in compared.overall if (s.split, s.source, s.part) == (ODD_LOADS, source, part)}
            ours = scores.pop(EXTENDED)
            assert set(scores) == {"rigid", "improved", "kalman", boxes.LINEAR, boxes.QUADRATIC}
            assert ours.tau_w_rmse_N_m < min(score.tau_w_rmse_N_m for score in scores.values())
            if part == WHOLE:
                assert ours.theta_j_rmse_rad < min(score.theta_j_rmse_rad for score in scores.values())
    summary, table = write_comparison(compared, tmp_path)
    assert len(json.loads(summary.read_text(encoding="utf-8"))["overall"]) == len(compared.overall)
    assert len(table.read_text(encoding="utf-8").splitlines()) == 1 + len(compared.per_run)
    tables = comparison_tables(compared)
    assert [name for name, _ in tables][-1] == PUBLISHED_PROTOCOL
    assert tables[-1][1].rows[-1][-2:] == ("4.42", "0.370")
    assert all(path.stat().st_size > 1000 for path in write_comparison_figures(compared, tmp_path))


@pytest.mark.shared_data
def test_whole_motion_from_spindle_torque_is_as_good_as_documented(compared: Comparison) -> None:
    ours = next(
        s
        for s in compared.overall
        if (s.split, s.source, s.method, s.part) == (ODD_LOADS, "tau_m_N_m", EXTENDED, WHOLE)
    )
    assert ours.tau_w_rmse_N_m < 6e-3
    assert np.degrees(ours.theta_j_rmse_rad) < 0.8


def test_regressions_find_what_they_can_and_no_more() -> None:
    rng = np.random.default_rng(4)
    x = rng.standard_normal((400, 3)) * (1.0, 5.0, 0.1) + 2.0
    straight = np.column_stack([x @ (1.0, -2.0, 30.0), x @ (0.0, 1.0, 0.0)])
    bent = straight + np.column_stack([x[:, 0] * x[:, 2], x[:, 1] ** 2])
    fits = boxes.black_boxes(with_learned=False)
    assert np.allclose(fits[boxes.LINEAR](x, straight)(x), straight)
    assert np.allclose(fits[boxes.QUADRATIC](x, bent)(x), bent)
    assert not np.allclose(fits[boxes.LINEAR](x, bent)(x), bent)


def test_learned_boxes_learn_or_name_the_extra(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def absent(name: str) -> object:
        raise ImportError(name)

    monkeypatch.setattr(boxes, "import_module", absent)
    with pytest.raises(UserError, match=r"hil-forceps\[comparison\]"):
        boxes.black_boxes(with_learned=True)
    (tmp_path / "runs.csv").write_text("time_s\n", encoding="utf-8")
    with pytest.raises(SystemExit) as end:
        main(["replay", str(tmp_path), "--rig", str(RIG), "--out", str(tmp_path / "out"), "--black-boxes"])
    assert end.value.code == 2


@pytest.mark.skipif(find_spec("sklearn") is None, reason="scikit-learn, an optional extra, is not here")
def test_learned_boxes_learn() -> None:
    rng = np.random.default_rng(5)
    x = rng.uniform(-2.0, 2.0, (1500, 3))
    y = np.column_stack([np.sin(x[:, 0]) * x[:, 1], np.abs(x[:, 2])])
    for name in (boxes.BOOSTING, boxes.NETWORK):
        predict = boxes.black_boxes(with_learned=True)[name](x[:1000], y[:1000])
        assert np.sqrt(np.mean((predict(x[1000:]) - y[1000:]) ** 2)) < 0.25 * np.std(y)
