"""A fitting problem: measured runs, a simulator, the unknowns; residuals and their sensitivities in the flat layout."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.experiment import Record
from hil_forceps.diagnosis.mapper import Mapper
from hil_forceps.diagnosis.spectrum import Flat, Layout, Noise, Whitener, fill_run, transform, whitening
from hil_forceps.diagnosis.unknowns import STEP, Unknowns

Vector = NDArray[np.float64]
Matrix = NDArray[np.float32]
Outputs = list[dict[str, Vector]]

EDGE_SD = 0.29  # of a number that is uniform between 0 and 1
EDGE_STEP = 0.02
HALF = 0.5 / EDGE_SD  # the ends of a fraction, from the middle
OWN_STEP = 0.1  # of a run's zero and integral, in standard deviations
RESPONSE_S = 0.2  # a jump of the load has died away after this


class Nuisance(NamedTuple):
    """What is unknown of one run: not of interest, and fitted along."""

    theta_j_zero_rad: float
    integral_rad_s: float
    edge_fractions: Vector


class Simulator(Protocol):
    """Simulates all runs for one vector of model parameters; returns the transformed channels of each run."""

    def __call__(self, theta: Vector, nuisances: Sequence[Nuisance], mapper: Mapper = map) -> Outputs:
        """Return one mapping of channels per run; `mapper` may take the runs at once."""

    def only(self, run: int) -> "Simulator":
        """Return the same of one run."""

    def coarse(self) -> "Simulator":
        """Return the same in longer steps."""

    def calmed(self) -> "Simulator":
        """Return the same without the encoder's rounding and what is quick in the load."""


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Everything a fit needs; vectors u are the shared unknowns, then each run's nuisances."""

    records: tuple[Record, ...]
    layout: Layout
    measured: Flat
    simulate_runs: Simulator
    base: Vector  # model parameters that are not fitted (effects off)
    index_of: Callable[[str], int]
    shared: Unknowns
    zero_sd_rad: float
    integral_sd_rad_s: float
    mapper: Mapper = map

    def with_shared(self, shared: Unknowns) -> "Problem":
        """Return the same problem with other shared unknowns."""
        return Problem(
            self.records,
            self.layout,
            self.measured,
            self.simulate_runs,
            self.base,
            self.index_of,
            shared,
            self.zero_sd_rad,
            self.integral_sd_rad_s,
            self.mapper,
        )

    @property
    def nuisance_count(self) -> int:
        """Number of nuisances of all runs."""
        return sum(2 + record.edge_rows.size for record in self.records)

    @property
    def size(self) -> int:
        """Length of u."""
        return len(self.shared.items) + self.nuisance_count

    def whitener(self, noise: Noise) -> Whitener:
        """Return what makes this noise of the channels white."""
        return whitening(self.layout, noise, self.mapper)

    def theta(self, u: Vector) -> Vector:
        """Return the model's parameters at u."""
        theta = self.base.copy()
        for item, value in zip(self.shared.items, self.shared.values(u[: len(self.shared.items)]), strict=True):
            theta[self.index_of(item.name)] = value
        return theta

    def nuisances(self, u: Vector) -> list[Nuisance]:
        """Return each run's nuisances at u."""
        found = []
        at = len(self.shared.items)
        for record in self.records:
            edges = record.edge_rows.size
            fractions = np.clip(0.5 + EDGE_SD * u[at + 2 : at + 2 + edges], 0.0, 1.0)
            found.append(
                Nuisance(self.zero_sd_rad * float(u[at]), self.integral_sd_rad_s * float(u[at + 1]), fractions)
            )
            at += 2 + edges
        return found

    def prior_weights(self) -> Vector:
        """Return the weight of u² in the objective, entry by entry."""
        return np.concatenate((self.shared.prior_weights(), np.ones(self.nuisance_count)))

    def bounds(self) -> tuple[Vector, Vector]:
        """Return the least and the greatest u."""
        low, high = self.shared.bounds()
        least, greatest = [low], [high]
        for record in self.records:
            edges = record.edge_rows.size
            least.append(np.concatenate(([-np.inf, -np.inf], np.full(edges, -HALF))))
            greatest.append(np.concatenate(([np.inf, np.inf], np.full(edges, HALF))))
        return np.concatenate(least), np.concatenate(greatest)

    def simulate(self, u: Vector) -> Outputs:
        """Return the transformed channels of each run at u."""
        return self.simulate_runs(self.theta(u), self.nuisances(u), self.mapper)

    def _simulate_in_task(self, u: Vector) -> Outputs:
        """Return the same from within a task of the mapper, which must not wait for tasks of its own."""
        return self.simulate_runs(self.theta(u), self.nuisances(u))

    def predicted(self, u: Vector) -> Flat:
        """Return the flat vector of what the model says at u."""
        return transform(self.layout, self.simulate(u))

    def shared_columns(self, u: Vector, outputs: Outputs, which: Sequence[int]) -> Matrix:
        """Return the sensitivities to some of the shared unknowns, one column each; one-sided differences."""
        _, high = self.bounds()
        steps = [STEP if u[i] + STEP <= high[i] else -STEP for i in which]

        def column(task: tuple[int, float]) -> Flat:
            i, step = task
            moved = u.copy()
            moved[i] += step
            return transform(self.layout, difference(self._simulate_in_task(moved), outputs, step))

        columns = list(self.mapper(column, zip(which, steps, strict=True)))
        return np.stack(columns, axis=1) if columns else np.empty((self.layout.size, 0), dtype=np.float32)

    def _nuisance_columns(self, u: Vector, outputs: Outputs) -> Matrix:
        """Return the sensitivities to all nuisances. A nuisance acts on its run alone, so runs are moved together."""
        first = len(self.shared.items)
        columns = np.zeros((self.layout.size, self.nuisance_count), dtype=np.float32)
        starts = np.cumsum([0, *(2 + record.edge_rows.size for record in self.records)])

        # A fraction at its upper end is moved down: beyond it nothing changes, and a column of nothing let its prior
        # draw it to the middle, at tens of thousands of χ², so that the fit ended there.
        edge_steps = [_edge_steps(u[first + a + 2 : first + b]) for a, b in pairwise(starts)]

        def moved(kind: str) -> Outputs:
            v = u.copy()
            for start, steps in zip(starts, edge_steps, strict=False):
                at = first + start
                if kind == "edges":
                    v[at + 2 : at + 2 + steps.size] += steps
                else:
                    v[at + (0 if kind == "zero" else 1)] += OWN_STEP
            return difference(self._simulate_in_task(v), outputs, 1.0 if kind == "edges" else OWN_STEP)

        kinds = ["zero", "integral", *(["edges"] if any(steps.size for steps in edge_steps) else [])]
        results = dict(zip(kinds, self.mapper(moved, kinds), strict=True))
        for k, (start, record) in enumerate(zip(starts, self.records, strict=False)):
            fill_run(columns[:, start], self.layout, k, results["zero"][k])
            fill_run(columns[:, start + 1], self.layout, k, results["integral"][k])
            for j, (window, step) in enumerate(zip(_windows(record), edge_steps[k], strict=True)):
                part = {name: _only(values, window) / step for name, values in results["edges"][k].items()}
                fill_run(columns[:, start + 2 + j], self.layout, k, part)
        return columns

    def jacobian(self, u: Vector, outputs: Outputs) -> Matrix:
        """Return the sensitivities to every entry of u."""
        shared = self.shared_columns(u, outputs, range(len(self.shared.items)))
        return np.concatenate((shared, self._nuisance_columns(u, outputs)), axis=1)


def difference(after: Outputs, before: Outputs, step: float) -> Outputs:
    """Return (after − before)/step for every channel of every run."""
    return [{name: (a[name] - b[name]) / step for name in a} for a, b in zip(after, before, strict=True)]


def _edge_steps(u: Vector) -> Vector:
    """Return how far the fraction of each jump is moved for its sensitivity."""
    step = EDGE_STEP / EDGE_SD
    return np.where(u + step <= HALF, step, -step)


def _windows(record: Record) -> list[tuple[int, int]]:
    """Return the rows that each jump of the load shows in: up to the next one, or until its response has died away."""
    rows = record.edge_rows
    length = round(RESPONSE_S / record.period_s)
    ends = np.minimum(rows + length, np.append(rows[1:], record.time_s.size))
    return [(int(a), int(b)) for a, b in zip(rows, ends, strict=True)]


def _only(values: Vector, window: tuple[int, int]) -> Vector:
    kept = np.zeros_like(values)
    kept[window[0] : window[1]] = values[window[0] : window[1]]
    return kept
