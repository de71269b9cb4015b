"""A run: what was measured, as columns of SI numbers over one time axis."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil_forceps.data.pandas_frame import to_pandas

Column = NDArray[np.float64]

REQUIRED_COLUMNS = ("time_s", "theta_m_rad")
TORQUE_COLUMNS = ("current_A", "tau_m_N_m")  # at least one: without either nothing drives the motor pulley
OPTIONAL_COLUMNS = ("theta_m_ref_rad", "theta_drive_rad", "voltage_V", "theta_j_rad", "tau_w_N_m")
KNOWN_COLUMNS = (
    "time_s",
    "theta_m_ref_rad",
    "theta_m_rad",
    "theta_drive_rad",  # the motor's own encoder before a gear, in turns of the pulley that it drives
    "current_A",
    "voltage_V",
    "theta_j_rad",
    "tau_w_N_m",
    "tau_m_N_m",
)

# The note of a run whose angle has a zero of its own: what depends on the angle isn't the same in another run.
ANGLE_FROM_SPEED = "no position was recorded: theta_m_rad is the integral of the speed and begins at 0 in each run"

GAP_IN_INTERVALS = 1.5  # an interval longer than this many usual ones is a gap: at least one sample is missing
WHOLE_MULTIPLE = 0.01  # share by which rows may miss a whole multiple of a drive's sample time: clocks are off by less
MAX_UNTOLD_JITTER_SHARE = 0.01  # of the usual interval; printed stamps of three decimals stay below it


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One measurement: named float64 columns of equal length, read-only.

    `columns` holds `time_s` (finite, strictly increasing), `theta_m_rad`, and `current_A` or `tau_m_N_m`; the others
    of `KNOWN_COLUMNS` where they were measured. A channel that was not measured is absent, never zero. `notes` says
    what a reader should know; gaps and jitter of the stamps are added to it here. Raises ValueError when the columns
    break these rules (readers of files check first and raise UserError with the line).
    """

    name: str
    columns: dict[str, Column]
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        given: Any = self.columns
        if not isinstance(given, Mapping):
            raise TypeError(f"columns: must be a mapping of names to arrays, not {type(given).__name__}")
        for name, values in given.items():
            if not isinstance(values, np.ndarray):
                told = f"must be an array of numbers, not {type(values).__name__}; hf.read_runs takes lists and tables"
                raise TypeError(f"columns[{name!r}]: {told}")
        problem = columns_problem(self.columns)
        if problem:
            raise ValueError(f"run {self.name!r}: {problem}")
        columns = {name: _frozen(values) for name, values in self.columns.items()}
        bad = {name: bad_row(columns[name], increasing=name == "time_s") for name in columns}
        for name, row in bad.items():
            if row is not None:
                raise ValueError(f"run {self.name!r}: {name}[{row}] is not finite or does not increase")
        new = tuple(note for note in timing_notes(columns["time_s"]) if note not in self.notes)
        object.__setattr__(self, "columns", columns)
        object.__setattr__(self, "notes", self.notes + new)

    def __repr__(self) -> str:
        seconds = float(self.columns["time_s"][-1] - self.columns["time_s"][0])
        return f"<Run {self.name!r}: {len(self)} samples over {seconds:.6g} s; {', '.join(self.columns)}>"

    def __len__(self) -> int:
        return len(self.columns["time_s"])

    def __getitem__(self, column: str) -> Column:
        """Return a column; KeyError where it was not measured."""
        if column not in self.columns:
            raise KeyError(f"{column}: was not measured in {self.name}; there are {', '.join(self.columns)}")
        return self.columns[column]

    def to_pandas(self) -> Any:
        """Return the columns as a pandas DataFrame; UserError if pandas is not installed."""
        return to_pandas(self.columns)

    @property
    def sample_time_s(self) -> float:
        """The usual interval: the median of the differences of `time_s`."""
        return float(np.median(np.diff(self.columns["time_s"])))

    @property
    def time_ns(self) -> NDArray[np.int64]:
        """`time_s` as whole nanoseconds, as the estimators take it."""
        return np.rint(self.columns["time_s"] * 1e9).astype(np.int64)


def columns_problem(columns: Mapping[str, Column]) -> str | None:
    """Say what is wrong with the set of columns and their lengths, None when nothing is."""
    missing = [name for name in REQUIRED_COLUMNS if name not in columns]
    if missing:
        return f"column {missing[0]} is missing"
    if not any(name in columns for name in TORQUE_COLUMNS):
        return f"neither {TORQUE_COLUMNS[0]} nor {TORQUE_COLUMNS[1]} is there"
    unknown = [name for name in columns if name not in KNOWN_COLUMNS]
    if unknown:
        return f"column {unknown[0]!r} is not one of {', '.join(KNOWN_COLUMNS)}"
    length = len(columns["time_s"])
    if length < 2:
        return f"{length} samples are too few: at least 2 are needed"
    for name, values in columns.items():
        if values.ndim != 1 or len(values) != length:
            return f"column {name} has shape {values.shape}, time_s has {length} samples"
    return None


def bad_row(values: Column, *, increasing: bool) -> int | None:
    """Return the first index whose value is not finite or, where asked, not above the one before it."""
    bad = ~np.isfinite(values)
    if increasing:
        bad[1:] |= ~(np.diff(values) > 0)
    rows = np.flatnonzero(bad)
    return int(rows[0]) if rows.size else None


def timing_notes(time_s: Column) -> tuple[str, ...]:
    """Report gaps and jitter of the stamps in words, nothing when there are none.

    Jitter is the standard deviation of the intervals that are not gaps, over the median interval.
    """
    intervals = np.diff(time_s)
    usual = float(np.median(intervals))
    gaps = np.flatnonzero(intervals > GAP_IN_INTERVALS * usual)
    notes = []
    if gaps.size:
        lost = int(np.sum(np.rint(intervals[gaps] / usual)) - gaps.size)
        longest = int(gaps[np.argmax(intervals[gaps])])
        notes.append(
            f"{gaps.size} gap{'s' if gaps.size > 1 else ''} in time, about {lost} samples missing; "
            f"longest {intervals[longest]:.6g} s after {time_s[longest]:.6g} s"
        )
    regular = intervals[intervals <= GAP_IN_INTERVALS * usual]
    jitter = float(np.std(regular)) / usual
    if jitter > MAX_UNTOLD_JITTER_SHARE:
        notes.append(f"jitter of the sample interval: {100 * jitter:.2g} % of {usual:.6g} s (standard deviation)")
    return tuple(notes)


def _frozen(values: Column) -> Column:
    copy = np.array(values, dtype=np.float64)
    copy.flags.writeable = False
    return copy
