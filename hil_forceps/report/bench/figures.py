"""All figures of a bench, with their runs and names."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from hil_forceps.report.bench.hero import HeroRuns, hero_figure
from hil_forceps.report.bench.simulation import edge_figure, elongation_figure, jaw_figure, torque_figure
from hil_forceps.report.bench.summary import rmse_figure
from hil_forceps.report.save import save_figure
from hil_forceps.report.traces import RunTraces, SummaryPoint

PULSE_SIMULATION = 2
PULSE_EDGE_S = 12.5  # the load ends: the highest spike of the previous algorithm


def write_bench_figures(runs: Sequence[RunTraces], points: Sequence[SummaryPoint], out: Path) -> list[Path]:
    """Draw the figures that `runs` and `points` allow into `out`, as PDF and PNG; return the files. Raises OSError.

    Per simulation and sample time: `simulationN[_Tms]_torque`, `_elongation`, `_jaw` (where an uncompensated run is
    there), `_edge` (simulation 2); once: `rmse`, and `bench` (the README's picture) where its four runs are there. The
    longest sample time, the bus's, goes without `_Tms`.
    """
    figures: dict[str, Figure] = {}
    times = sorted({run.sample_time_s for run in runs}, reverse=True)
    for simulation in sorted({run.simulation for run in runs}):
        for time_s in times:
            suffix = "" if time_s == times[0] else f"_{time_s * 1e3:g}ms"
            here = [run for run in runs if run.simulation == simulation and run.sample_time_s == time_s]
            for name, figure in _of_simulation(here).items():
                figures[f"simulation{simulation}{suffix}_{name}"] = figure
    if points:
        figures["rmse"] = rmse_figure(points)
    hero = _hero([run for run in runs if (run.simulation, run.sample_time_s) == (PULSE_SIMULATION, times[0])])
    if hero:
        figures["bench"] = hero_figure(hero, PULSE_EDGE_S)
    return [path for name, figure in figures.items() for path in save_figure(figure, out, name)]


def _of_simulation(runs: Sequence[RunTraces]) -> dict[str, Figure]:
    compensated = [run for run in runs if run.compensated]
    uncompensated = [run for run in runs if not run.compensated]
    shown = compensated or uncompensated
    if not shown:
        return {}
    figures = {"torque": torque_figure(shown), "elongation": elongation_figure(shown)}
    if uncompensated:
        figures["jaw"] = jaw_figure(uncompensated[0], [run for run in compensated if _finite(run)])
    if shown[0].simulation == PULSE_SIMULATION:
        figures["edge"] = edge_figure(shown, PULSE_EDGE_S)
    return figures


def _hero(runs: Sequence[RunTraces]) -> HeroRuns | None:
    by_algorithm = {run.algorithm: run for run in runs if run.compensated and _finite(run)}
    uncompensated = [run for run in runs if not run.compensated]
    if not uncompensated or not {"previous", "improved", "kalman"} <= by_algorithm.keys():
        return None
    return HeroRuns(by_algorithm["previous"], by_algorithm["improved"], by_algorithm["kalman"], uncompensated[0])


def _finite(run: RunTraces) -> bool:
    return bool(np.all(np.isfinite(run.tau_w_est)) and np.all(np.isfinite(run.theta_j_true)))
