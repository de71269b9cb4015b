"""The runs of a bench file, as data."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError

PAPER_DURATION_S = 20.0
ESTIMATOR_RIG = "estimator_rig"  # part of the file names of runs with another rig for the estimator


class RunSpec(NamedTuple):
    """One run of the bench: simulation, algorithm, sample time, and with or without bus."""

    simulation: int
    algorithm: str
    compensated: bool
    sample_time_s: float
    on_bus: bool  # False: samples go directly to the estimator, for rates that are too high for CAN
    duration_s: float = PAPER_DURATION_S  # a shorter run is recorded, too, and counts as not finished
    estimator_rig: str = ""  # name of the estimator's rig; empty: that of the bench

    @property
    def name(self) -> str:
        """Return the file name of this run's results."""
        compensation = "compensated" if self.compensated else "uncompensated"
        believed = f"_{ESTIMATOR_RIG}" if self.estimator_rig else ""
        return f"sim{self.simulation}_{self.algorithm}_{compensation}_{self.sample_time_s:g}s{believed}"


def run_matrix(
    rig: Rig, simulation: int | None = None, algorithm: str | None = None, estimator_rig: str = ""
) -> list[RunSpec]:
    """List the runs of a bench file, those on the bus first.

    Every algorithm runs compensated and uncompensated on the bus; at the direct sample times only compensated, since
    the uncompensated jaw error does not depend on the rate. With the name of an `estimator_rig` each run comes twice,
    first with the bench's own rig for the estimator. UserError for a simulation or algorithm that the file does not
    have.
    """
    bench = rig.bench
    simulations = _chosen("simulation", bench.simulations, simulation)
    algorithms = _chosen("algorithm", bench.algorithms, algorithm)
    on_bus = [
        RunSpec(s, a, compensated, bench.host_period_s, True)
        for s in simulations
        for a in algorithms
        for compensated in (True, False)
    ]
    direct = [
        RunSpec(s, a, True, period_s, False)
        for period_s in bench.direct_sample_times_s
        for s in simulations
        for a in algorithms
    ]
    specs = on_bus + direct
    if not estimator_rig:
        return specs
    return [spec._replace(estimator_rig=name) for spec in specs for name in ("", estimator_rig)]


def _chosen(what: str, available: Sequence[int | str], wanted: int | str | None) -> list[Any]:
    if wanted is None:
        return list(available)
    if wanted not in available:
        raise UserError(f"--{what} {wanted}: this bench has {', '.join(map(str, available))}")
    return [wanted]
