"""The noise floor of runs that repeat themselves: how far one stroke differs from the next at the same phase.

Where a motion comes again after a period T, what the sensors show should come again, too. d(t) = y(t + T) − y(t) is
then twice the noise in variance, whatever the model. The drive never repeats quite, and no load either: what of d
follows the differences of motor angle, its speed and acceleration, and load, in proportion, is no noise and is taken
out. What changes slowly from stroke to stroke hardly counts between neighbours.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.interpolate import CubicSpline

from hil_forceps.audit.finding import Finding
from hil_forceps.diagnosis.validation.rows import Rows

Vector = NDArray[np.float64]

SAME = 0.1  # of the motion's deviation: how far strokes that count as the same may differ
SAME_LOAD = 0.5  # the same of the load, which is never set as well; what follows it is taken out
FEWEST_ROWS = 20  # of a period, and that count in both strokes
LONGEST = 0.7  # of a run: what remains is to be compared


class Strokes(NamedTuple):
    """What repeats in one run."""

    run: str
    period_s: float
    times: float  # strokes in the run
    floor_rms: Mapping[str, float]  # of each channel


class Differences(NamedTuple):
    """How strokes of one run differ from the next, over √2: as noisy as one stroke is."""

    period_rows: float
    both: NDArray[np.bool_]  # rows that count in both strokes
    channels: Mapping[str, Vector]  # of each channel (n)


def stroke_differences(record: Rows) -> Differences | None:
    """Return what differs from stroke to stroke; None where the motion, or the load on it, doesn't come again."""
    period = period_rows(record.reference_rad)
    if period is None:
        return None
    both = record.weights * _later(record.weights, period) > 0.5
    if int(both.sum()) < FEWEST_ROWS:
        return None
    driving = [(record.reference_rad, SAME)]
    if record.tau_w_N_m is not None:
        driving.append((record.tau_w_N_m, SAME_LOAD))
    changes = []
    for values, share in driving:
        change = _later(values, period) - values
        if float(np.sqrt(np.mean(change[both] ** 2))) > share * float(np.std(values)):
            return None
        changes.append(change)
    speed = np.gradient(changes[0])
    changes += [speed, np.gradient(speed)]
    columns = np.column_stack([each / max(float(np.std(each[both])), 1e-30) for each in changes])
    freedom = max(1.0 - columns.shape[1] / int(both.sum()), 1e-3)
    found = {}
    for name, values in record.channels.items():
        change = _later(values, period) - values
        follows = np.linalg.lstsq(columns[both], change[both], rcond=1e-9)[0]
        found[name] = (change - columns @ follows) * np.sqrt(0.5 / freedom)
    return Differences(period, both, found)


def strokes_of(record: Rows) -> Strokes | None:
    """Return period and floors of a run; None where its motion, or the load on it, doesn't come again."""
    differences = stroke_differences(record)
    if differences is None:
        return None
    both, period = differences.both, differences.period_rows
    floors = {name: float(np.sqrt(np.mean(left[both] ** 2))) for name, left in differences.channels.items()}
    span_s = float(record.time_s[-1] - record.time_s[0])
    return Strokes(record.name, period * record.period_s, span_s / (period * record.period_s), floors)


def period_rows(motion: Vector) -> float | None:
    """Return after how many rows (a fraction, too) a motion comes again; None where it doesn't within the run."""
    values = motion - motion.mean()
    rows = values.size
    if rows < 2 * FEWEST_ROWS or not float(np.std(values)) > 0.0:
        return None
    apart = _all_apart(values)
    left = np.flatnonzero(apart > 1.0)  # it has to go away before it can come again
    if left.size == 0:
        return None
    valley = np.flatnonzero(apart < SAME)
    valley = valley[(valley > max(int(left[0]), FEWEST_ROWS)) & (valley < LONGEST * rows)]
    if valley.size == 0:
        return None
    # The first valley, not its multiples, which may fit better by chance.
    ends = np.flatnonzero(np.diff(valley) > 1)
    first = valley[: int(ends[0]) + 1] if ends.size else valley
    best = int(first[int(np.argmin(apart[first]))])
    if best == valley[-1] and best + 1 >= LONGEST * rows:
        return None  # still falling where the run ends
    near = best + np.linspace(-1.0, 1.0, 41)  # by twentieths of a row
    return float(near[int(np.argmin([_apart(values, float(lag)) for lag in near]))])


def _all_apart(values: Vector) -> Vector:
    """Return how far a signal differs from itself at every lag of whole rows, as a share of its deviation."""
    rows = values.size
    spectrum = fft.rfft(values, 2 * rows)
    products = fft.irfft(np.abs(spectrum) ** 2, 2 * rows)[:rows]
    squares = np.cumsum(values**2)
    before = squares[::-1]  # the sum without the last rows, lag by lag
    after = squares[-1] - np.concatenate(([0.0], squares[:-1]))
    counts = rows - np.arange(rows)
    return np.asarray(np.sqrt(np.maximum(before + after - 2.0 * products, 0.0) / counts) / np.std(values))


def _apart(values: Vector, lag: float) -> float:
    kept = values.size - int(np.ceil(lag))
    return float(np.sqrt(np.mean((_later(values, lag)[:kept] - values[:kept]) ** 2)) / np.std(values))


def _later(values: Vector, lag: float) -> Vector:
    """Return a signal as it is `lag` rows later, by a cubic spline between rows; 0 beyond its end."""
    whole = round(lag)
    shifted = np.zeros(values.size)
    if abs(lag - whole) < 1e-9:
        shifted[: values.size - whole] = values[whole:]
        return shifted
    rows = np.arange(values.size, dtype=np.float64)
    kept = values.size - int(np.ceil(lag))
    shifted[:kept] = CubicSpline(rows, values)(rows[:kept] + lag)
    return shifted


def floors_with_strokes(
    records: Sequence[Rows], floors: Mapping[str, float]
) -> tuple[dict[str, float], tuple[Strokes, ...]]:
    """Return each channel's floor over all runs, and what repeats in which.

    A run that repeats itself has the floor that its strokes show, any other the one of `floors`; runs count alike. Each
    is at least the noise, so the lower one counts: strokes that differ by more than a motion shows say nothing.
    """
    found = {record.name: strokes for record in records if (strokes := strokes_of(record)) is not None}
    merged = dict(floors)
    for name in floors:
        squares = [
            min(found[record.name].floor_rms[name] if record.name in found else np.inf, floors[name]) ** 2
            for record in records
            if name in record.channels and (record.name not in found or name in found[record.name].floor_rms)
        ]
        if squares:
            merged[name] = float(np.sqrt(np.mean(squares)))
    return merged, tuple(found.values())


def repetition(strokes: Strokes) -> Finding:
    """Say what a run that repeats itself shows of its noise."""
    floors = ", ".join(f"{floor:.3g} in {name}" for name, floor in strokes.floor_rms.items())
    repeated = f"a stroke repeats every {strokes.period_s:.4g} s, {strokes.times:.1f} times"
    text = f"{repeated}; its repetitions differ by {floors}"
    return Finding("strokes", "note", strokes.run, "", text)
