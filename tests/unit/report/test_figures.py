"""Figures: every axis has its unit, nothing hides, the same data give the same bytes, nothing leaks out."""

import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from hil_forceps.report.bench import figures as bench
from hil_forceps.report.bench.hero import HeroRuns, hero_figure
from hil_forceps.report.bench.simulation import edge_figure, elongation_figure, jaw_figure, torque_figure
from hil_forceps.report.bench.summary import rmse_figure
from hil_forceps.report.bench.timing import timing_figure
from hil_forceps.report.save import save_figure
from hil_forceps.report.style import DOUBLE_COLUMN, LOOKS, RC, SINGLE_COLUMN, house_style, look, thinned
from hil_forceps.report.traces import RunTraces, SummaryPoint, TimingTraces

ALGORITHMS = ("previous", "improved_as_published", "improved", "kalman")


def run_of(algorithm: str, *, compensated: bool = True, simulation: int = 2, sample_time_s: float = 1e-2) -> RunTraces:
    time_s = np.arange(0.0, 20.0, sample_time_s)
    pulse = np.where((time_s % 5.0 < 2.5) & (time_s >= 10.0), 2e-3, 0.0)
    lag = {"previous": 3.0, "improved": 0.3, "kalman": 0.1}.get(algorithm, 0.0)
    estimate = pulse + lag * 1e-3 * np.gradient(pulse) / 1e-3
    if algorithm == "improved_as_published":
        estimate = np.where(time_s > 3.0, np.nan, estimate)
    reference = np.full_like(time_s, np.radians(10.0))
    jaw = reference - (0.0 if compensated else 1.0) * np.radians(2.249) * pulse / 2e-3
    return RunTraces(
        time_s, pulse, estimate, jaw, reference, pulse * 0.0275, estimate * 0.0275, algorithm, compensated, simulation,
        sample_time_s,
    )  # fmt: skip


def timing() -> TimingTraces:
    generator = np.random.default_rng(1)
    age, late = 6e-4 + generator.gamma(2, 3e-5, 5000), generator.gamma(2, 2e-5, 5000) - 1e-6
    late[3] = 3e-3
    frames = {"delivered": 4998, "lost on the bus": 2}
    return TimingTraces(age, late, {"p50": 6.5e-4, "max": 1e-3}, {"max": 3e-3}, 1e-3, frames, "pty, 5 s")


def points() -> list[SummaryPoint]:
    return [
        SummaryPoint(algorithm, simulation, time, None if "published" in algorithm else 1e-4 * (index + simulation))
        for index, algorithm in enumerate(ALGORITHMS)
        for simulation in (1, 2)
        for time in (1e-3, 1e-4)
    ]


def runs() -> list[RunTraces]:
    return [run_of(algorithm) for algorithm in ALGORITHMS]


def hero_runs() -> HeroRuns:
    return HeroRuns(run_of("previous"), run_of("improved"), run_of("kalman"), run_of("improved", compensated=False))


BUILDERS: dict[str, Callable[[], Figure]] = {
    "torque": lambda: torque_figure(runs()),
    "elongation": lambda: elongation_figure(runs()),
    "jaw": lambda: jaw_figure(run_of("improved", compensated=False), [run_of("previous"), run_of("kalman")]),
    "edge": lambda: edge_figure(runs(), 12.5, before_s=0.1, after_s=0.2),
    "rmse": lambda: rmse_figure(points()),
    "timing": lambda: timing_figure(timing()),
    "hero": lambda: hero_figure(hero_runs()),
}


@cache
def drawn(name: str) -> Figure:
    return BUILDERS[name]()


def words(figure: Figure) -> str:
    texts = [text.get_text() for axes in figure.axes for text in (*axes.texts, axes.title)]
    labels = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    return " | ".join([*texts, *labels, figure.get_supxlabel()])


def outer(axes: Axes) -> bool:
    spec = axes.get_subplotspec()
    assert spec is not None
    return spec.is_last_row()


@pytest.mark.parametrize("name", BUILDERS)
def test_every_outer_axis_names_its_quantity_and_unit(name: str) -> None:
    figure = drawn(name)
    for axes in figure.axes:
        if outer(axes):
            assert axes.get_xlabel().endswith(")"), axes.get_title()
    first = figure.axes[0]
    assert first.get_ylabel().endswith(")") or first.get_ylabel() == "count" or name == "rmse"


@pytest.mark.parametrize("name", BUILDERS)
def test_widths_are_those_of_print(name: str) -> None:
    width = drawn(name).get_size_inches()[0]
    assert width in (SINGLE_COLUMN, DOUBLE_COLUMN)


@pytest.mark.parametrize("name", ["torque", "hero", "timing", "rmse"])
def test_same_data_same_bytes(name: str, tmp_path: Path) -> None:
    first = save_figure(BUILDERS[name](), tmp_path / "a", name)
    second = save_figure(BUILDERS[name](), tmp_path / "b", name)
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in second]
    assert b"CreationDate" not in first[0].read_bytes()


def test_a_run_that_is_not_finite_is_named_in_words() -> None:
    assert "not finite from 3" in words(drawn("torque"))
    assert "not finite from 3" in words(drawn("elongation"))
    assert "(not finite)" in words(drawn("edge"))
    assert "not finite at 1, 0.1 ms" in words(drawn("rmse"))


def test_frames_are_accounted_for_in_the_caption() -> None:
    assert "Frames: 5,000 = 4,998 delivered + 2 lost on the bus" in words(drawn("timing"))


def test_the_histogram_holds_every_sample() -> None:
    for axes in drawn("timing").axes:
        bars = [patch for patch in axes.patches if isinstance(patch, Rectangle)]
        assert sum(bar.get_height() for bar in bars) == 5000


def test_a_run_without_a_single_sample_is_drawn_as_such() -> None:
    empty = timing()._replace(age_s=np.zeros(0), lateness_s=np.zeros(0), age_marks_s={}, lateness_marks_s={}, frames={})
    assert words(timing_figure(empty)).count("none measured") == 2


def test_the_steady_error_stands_in_the_hero() -> None:
    assert "−2.25°" in words(drawn("hero"))


def test_looks_differ_without_colour() -> None:
    dashes = [str(style.dash) for style in LOOKS.values()]
    markers = [style.marker for style in LOOKS.values()]
    grey = sorted(float(np.dot(to_rgb(style.color), (0.299, 0.587, 0.114))) for style in LOOKS.values())
    assert len(set(dashes)) == len(dashes)
    assert len(set(markers)) == len(markers)
    assert min(np.diff(grey)) > 0.0
    assert look("something_new").label == "something new"


def test_thinning_keeps_the_spikes_and_the_ends_of_the_range() -> None:
    time = np.linspace(0.0, 20.0, 200_000)
    values: NDArray[np.float64] = np.sin(time)
    values[123_457] = 9.0
    values[45_678] = -7.0
    thin_time, thin_values = thinned(time, values, bins=500)
    assert len(thin_time) <= 1002
    assert thin_time[[0, -1]].tolist() == [0.0, 20.0]
    assert thin_values.max() == 9.0
    assert thin_values.min() == -7.0
    assert np.all(np.diff(thin_time) > 0)
    values[100_000] = np.nan
    assert np.isnan(thinned(time, values, bins=500)[1]).sum() == 1  # a hole stays a hole


def test_style_does_not_leak_and_ignores_a_users_settings() -> None:
    with mpl.rc_context({"lines.linewidth": 9.0, "axes.grid": False}):
        before = dict(mpl.rcParams)
        with house_style():
            assert mpl.rcParams["lines.linewidth"] == RC["lines.linewidth"]
            assert mpl.rcParams["axes.grid"]
        assert dict(mpl.rcParams) == before


def test_bench_draws_what_its_runs_allow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def note(figure: Figure, folder: Path, name: str) -> tuple[Path, ...]:
        assert figure.axes
        return (folder / name,)

    monkeypatch.setattr(bench, "save_figure", note)
    many = [run_of(a, compensated=c, simulation=s) for s in (1, 2) for a in ALGORITHMS for c in (False, True)]
    names = {path.name for path in bench.write_bench_figures(many, points(), tmp_path)}
    expected = {f"simulation{s}_{what}" for s in (1, 2) for what in ("torque", "elongation", "jaw")}
    assert names == expected | {"rmse", "bench", "simulation2_edge"}
    alone = bench.write_bench_figures([run_of("improved", compensated=False, simulation=1)], [], tmp_path)
    assert {path.name for path in alone} == {"simulation1_torque", "simulation1_elongation", "simulation1_jaw"}
    assert bench.write_bench_figures([], [], tmp_path) == []


def test_importing_the_package_does_not_import_matplotlib() -> None:
    code = (
        "import sys, hil_forceps.report, hil_forceps.report.traces\n"
        "assert 'matplotlib' not in sys.modules\n"
        "import hil_forceps.report.bench.figures\n"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
