"""Figures of a diagnosis: the ladder, constant channels, files for papers, and nothing outside of a figure."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.patches import Rectangle

from hil_forceps.diagnosis.result import (
    Diagnosis,
    Estimate,
    Gain,
    Rung,
    Trend,
)
from hil_forceps.report.diagnosis.figures.captions import panels
from hil_forceps.report.diagnosis.figures.evidence import ladder_figure
from hil_forceps.report.diagnosis.files import write_figures
from hil_forceps.report.diagnosis.ladder import ladder_section
from hil_forceps.report.style import house_style
from tests.unit.report.diagnosis.cases import CASES, page_of, run_evidence, wire_slack

LADDER = (
    Rung("", {"current_A": 5.1e-3, "theta_j_rad": 3.9e-3}, {}, {}),
    Rung(
        "wire_slack",
        {"current_A": 4.9e-3, "theta_j_rad": 4e-4},
        {"current_A": 0.08, "theta_j_rad": 0.991},
        {"half_width_m": Estimate(2.06e-6, 1.98e-6, 2.14e-6, "m")},
    ),
    Rung("jaw_coupling", {"current_A": 5.2e-3, "theta_j_rad": 3e-4}, {"current_A": -0.12, "theta_j_rad": 2e-3}, {}),
)


def test_ladder_is_drawn_and_tabulated_with_the_gain_of_each_step(tmp_path: Path) -> None:
    gain = {
        "current_A": Gain(5.1e-3, 5.2e-3, 1e-3, 0.0, 0.0, 0.0),
        "theta_j_rad": Gain(3.9e-3, 3e-4, 2e-4, 1.0, 1.0, 1.0),
    }
    diagnosis = Diagnosis("effects", "", gain=gain, held_out=("a",), ladder=LADDER, varies_over=("theta",))
    page = page_of(diagnosis, tmp_path)
    assert "The ladder" in page.headings
    assert page.images == 2
    for words in ("known parameters", "99.1 %", "−12 %", "1.98", "1.5 times its noise floor", "motor angle"):
        assert words in page.text, words
    left = (Trend("wire", "memory of tension", 30.0, 55.7), Trend("jaw", "omega", 40.0, 0.7))
    told = ladder_section(replace(diagnosis, varies_over=(), trends=left), "")
    assert "it varies over memory of tension (wire, 55.7 times the threshold)." in told
    alone = replace(diagnosis, ladder=LADDER[:1], held_out=(), gain={})
    assert "none was held out" in ladder_section(alone, "")
    assert "Remaining error" not in ladder_section(alone, "")


def test_ladder_s_figure_has_a_bar_a_step_and_a_panel_a_channel() -> None:
    drawn = ladder_figure(Diagnosis("effects", "", ladder=LADDER, noise_sd={"current_A": 1e-3}))
    assert [text.get_text() for text in drawn.axes[0].get_yticklabels()] == [
        "known parameters", "+ wire slack", "+ jaw coupling",
    ]  # fmt: skip
    widths = [bar.get_width() for bar in drawn.axes[0].patches if isinstance(bar, Rectangle)]
    assert widths == pytest.approx([5.1, 4.9, 5.2])
    assert "(mA)" in drawn.axes[0].get_xlabel()
    assert len(drawn.axes) == 2


def test_constant_channels_are_drawn(tmp_path: Path) -> None:
    run = run_evidence(seconds=2.0)
    still = {name: np.zeros_like(run.time_s) for name in run.measured}
    run = replace(run, measured=still, baseline=still, extended=still, nominal=still, variables=still, estimates=still)
    page_of(replace(wire_slack(runs=1), runs=(run,)), tmp_path)


def test_figures_for_papers_and_progress(tmp_path: Path) -> None:
    told: list[tuple[int, int, str]] = []
    diagnosis = replace(wire_slack(runs=1, jaw=False), candidates=())
    files = write_figures(diagnosis, tmp_path, progress=lambda *step: told.append(step))
    drawn = [panel.name for panel in panels(diagnosis)]
    assert [path.name for path in files] == [f"{name}{end}" for name in drawn for end in (".pdf", ".png")]
    assert all(path.stat().st_size > 1000 for path in files)
    assert [done for done, _, _ in told] == list(range(len(drawn) + 1))
    assert {total for _, total, _ in told} == {len(drawn)}


@pytest.mark.parametrize("case", ["effects", "one_run_no_jaw"])
def test_nothing_sticks_out_of_a_figure(case: str) -> None:
    for panel in panels(CASES[case]()):
        figure = panel.draw()
        assert figure is not None
        with house_style():
            figure.draw_without_rendering()
        room = figure.bbox
        for axes in (one for one in figure.axes if one.get_visible()):
            box = axes.get_tightbbox()
            assert box is not None
            assert room.x0 - 1 <= box.x0, panel.name
            assert room.y0 - 1 <= box.y0, panel.name
            assert box.x1 <= room.x1 + 1, panel.name
            assert box.y1 <= room.y1 + 1, panel.name
