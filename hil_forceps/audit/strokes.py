"""Audit of what strokes there and back tell, all runs together: counts and play of a gear, zeros of the torques.

In the middle of a stroke friction pushes the torque up one way and down the other, and play puts an encoder ahead one
way and behind the other; the mean of both ways is without either.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.signal import savgol_filter

from hil_forceps.audit.finding import Finding, View
from hil_forceps.data.run import Column

_SPEED_SHARE = 0.3  # of the top speed: faster than that counts as moving
_ENDS = 0.02  # of the rows: the ends of a stroke are where it spends least
_FEWEST_ROWS = 30  # each way, in the middle third of the stroke
_SURELY = 3.0  # deviations
_LEAST_SCALE = 0.01  # a wrong scale smaller than this is for the diagnosis
_FEWEST_LOADS = 4  # runs
_SURE_SLOPE = 10.0  # standard errors
_LEAST_ZERO = 0.02  # of the channel's range over the runs


class Middle(NamedTuple):
    """Rows in the middle third of a stroke."""

    forth: NDArray[np.bool_]
    back: NDArray[np.bool_]

    def mean(self, values: Column) -> float:
        """Return the mean of both ways."""
        return 0.5 * (float(np.mean(values[self.forth])) + float(np.mean(values[self.back])))

    def width(self, values: Column) -> float:
        """Return how much more it is forth than back."""
        return float(np.mean(values[self.forth])) - float(np.mean(values[self.back]))


def audit_strokes(views: Sequence[View], *, law_known: bool) -> Iterator[Finding]:
    """Yield what is found; zeros of the current only where the drive's law doesn't tell them better."""
    middles = [(view, middle) for view in views if (middle := _middle(view)) is not None]
    yield from _gear([pair for pair in middles if "theta_drive_rad" in pair[0].columns])
    if not law_known:
        for channel in ("tau_m_N_m", "current_A"):
            yield from _zero([p for p in middles if {channel, "tau_w_N_m"} <= p[0].columns.keys()], channel)


def _middle(view: View) -> Middle | None:
    angle = view.piece("theta_m_rad")
    rows = 2 * round(0.05 / view.interval_s) + 1  # speed is that over 0.1 s
    if view.is_constant["theta_m_rad"] or len(angle) < max(4 * rows, _FEWEST_ROWS) or rows < 5:
        return None
    speed = savgol_filter(angle, rows, 2, deriv=1)
    moving = _SPEED_SHARE * float(np.quantile(np.abs(speed), 0.99))
    low, high = np.quantile(angle, (_ENDS, 1.0 - _ENDS))
    third = (high - low) / 3.0
    inside = (angle > low + third) & (angle < high - third)
    found = Middle(inside & (speed > moving), inside & (speed < -moving))
    return found if min(found.forth.sum(), found.back.sum()) >= _FEWEST_ROWS else None


def _gear(pairs: Sequence[tuple[View, Middle]]) -> Iterator[Finding]:
    """Compare the travel of the encoder before a gear, less its play, with that of the one behind it."""
    if not pairs:
        return
    ratios, widths = [], []
    for view, middle in pairs:
        before, behind = view.piece("theta_drive_rad"), view.piece("theta_m_rad")
        widths.append(abs(middle.width(before - behind)))
        ratios.append((float(np.ptp(before)) - widths[-1]) / float(np.ptp(behind)))
    ratio = float(np.median(ratios))
    spread = float(stats.median_abs_deviation(ratios, scale="normal"))
    if len(ratios) < _FEWEST_LOADS:
        spread = max(spread, _LEAST_SCALE)  # one or two runs don't tell how much they differ
    error = math.sqrt(0.5 * math.pi / len(ratios)) * spread  # of a median
    told = f"theta_drive_rad moves {ratio:.4f} ± {2.0 * error:.4f} times as far as theta_m_rad, without the play"
    if abs(ratio - 1.0) > max(_SURELY * error, _LEAST_SCALE):
        text = f"{told}: multiply its counts per turn, or the gear's ratio, by {ratio:.4f}"
        yield Finding("gear_counts", "warning", "", "theta_drive_rad", text)
    else:
        yield Finding("gear_counts", "note", "", "theta_drive_rad", f"{told}: counts and gear ratio agree")
    low, high = min(widths), max(widths)
    text = f"theta_drive_rad leads theta_m_rad by {low:.3g} to {high:.3g} rad more forth than back: play, wind-up"
    yield Finding("gear_play", "note", "", "theta_drive_rad", text)


def _zero(pairs: Sequence[tuple[View, Middle]], channel: str) -> Iterator[Finding]:
    """Draw a line through torque over load, both ways in the mean, a point a run, down to no load."""
    if len(pairs) < _FEWEST_LOADS:
        return
    loads = np.array([middle.mean(view.piece("tau_w_N_m")) for view, middle in pairs])
    torques = np.array([middle.mean(view.piece(channel)) for view, middle in pairs])
    if not float(np.ptp(loads)) > 0.0:
        return
    line = stats.linregress(loads, torques)
    slope, zero, zero_se = float(line.slope), float(line.intercept), float(line.intercept_stderr)
    if abs(slope) < _SURE_SLOPE * float(line.stderr):
        return
    if abs(zero) > max(_SURELY * zero_se, _LEAST_ZERO * float(np.ptp(torques))):
        unit = "A" if channel == "current_A" else "N m"
        text = (
            f"{channel} is {zero:.3g} ± {2.0 * zero_se:.2g} {unit} without load (mean of both directions): an offset "
            f"of this sensor or of the load cell ({-zero / slope:.3g} N m), or a weight or spring at the jaw"
        )
        yield Finding("zero", "warning", "", channel, text)
