"""What the audit says, and the run as it looks at it."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from hil_forceps.data.run import GAP_IN_INTERVALS, Column, Run

Severity = Literal["note", "warning", "problem"]


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing found in the data before any physics.

    `run` and `channel` are empty where it concerns all of them. A note is good to know, a warning costs accuracy or
    may explain a later finding, a problem makes the channel or the run unfit until it is mended.
    """

    kind: str
    severity: Severity
    run: str
    channel: str
    text: str


class View:
    """A run with what several checks need, each computed once."""

    def __init__(self, run: Run) -> None:
        self.run = run
        self.name = run.name
        self.notes = run.notes
        self.columns = run.columns
        self.time_s = run.columns["time_s"]
        self.interval_s = run.sample_time_s
        self.torque_channel = "current_A" if "current_A" in run.columns else "tau_m_N_m"
        self.jaw_ratio: tuple[float, float] | None = None  # filled when asked for the first time

    def __len__(self) -> int:
        return len(self.time_s)

    def finding(self, kind: str, channel: str, severity: Severity, text: str) -> Finding:
        """Make a finding of this run."""
        return Finding(kind, severity, self.name, channel, text)

    @cached_property
    def channels(self) -> dict[str, Column]:
        """The columns but time."""
        return {name: values for name, values in self.columns.items() if name != "time_s"}

    @cached_property
    def stretch(self) -> slice:
        """The longest piece without a gap, for whatever differentiates or shifts."""
        gaps = np.flatnonzero(np.diff(self.time_s) > GAP_IN_INTERVALS * self.interval_s) + 1
        edges = np.concatenate([[0], gaps, [len(self)]])
        longest = int(np.argmax(np.diff(edges)))
        return slice(int(edges[longest]), int(edges[longest + 1]))

    def piece(self, channel: str) -> Column:
        """Return a channel over the longest piece without a gap."""
        return self.columns[channel][self.stretch]

    @cached_property
    def is_constant(self) -> dict[str, bool]:
        """Whether a channel has one value only."""
        return {name: bool(np.ptp(values) == 0.0) for name, values in self.channels.items()}

    @cached_property
    def quanta(self) -> dict[str, float]:
        """The step in which a channel counts; 0 where it shows none."""
        return {name: quantum_of(values) for name, values in self.channels.items()}

    @cached_property
    def noise_sd(self) -> dict[str, float]:
        """What is left of a channel that no smooth motion explains, as a standard deviation."""
        return {name: noise_of(values[self.stretch]) for name, values in self.channels.items()}


_FEWEST_STEPS = 6  # between distinct values; fewer show no lattice
_LARGEST_MULTIPLE = 20.0  # of the step: beyond, printed decimals blur which multiple it is
_OFF_LATTICE = 0.2  # of the step
_ON_LATTICE_SHARE = 0.98  # of the steps


def quantum_of(values: Column) -> float:
    """Return the step of the lattice on which all values lie, 0 when they lie on none.

    Judged by the steps between neighbouring distinct values, so that an offset or a scale does not matter.
    """
    distinct = np.unique(values)
    steps = np.diff(distinct)
    steps = steps[steps > 1e-9 * max(abs(float(distinct[0])), abs(float(distinct[-1])))]
    if len(steps) < _FEWEST_STEPS:
        return 0.0
    ordered = np.sort(steps)
    for candidate in (ordered[0], ordered[len(ordered) // 20], ordered[len(ordered) // 2]):
        near = steps[steps < _LARGEST_MULTIPLE * candidate]
        multiples = np.rint(near / candidate)
        fits = np.abs(near / candidate - multiples) < _OFF_LATTICE
        if len(near) >= _FEWEST_STEPS and np.mean(fits & (multiples > 0)) > _ON_LATTICE_SHARE:
            return float(np.sum(near[fits]) / np.sum(multiples[fits]))
    return 0.0


def noise_of(values: Column) -> float:
    """Return the standard deviation of white noise on top of a smooth signal, from third differences.

    The largest twentieth of the differences, edges and spikes, is left out. White noise of sd s has third differences
    of variance 20 s².
    """
    if len(values) < 8:
        return 0.0
    squares = np.square(np.diff(values, 3))
    count = int(0.95 * len(squares))
    kept = np.partition(squares, count)[: max(count, 1)]
    return float(np.sqrt(np.mean(kept) / 0.7588 / 20.0))  # the central 95 % of a Gaussian have 0.7588 of its variance
