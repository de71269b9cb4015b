"""Audit of the current against the drive's law: what the drive must have commanded is known from θ_ref and θ."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.signal import correlate

from hil_forceps.audit.channels import noise_finding
from hil_forceps.audit.finding import Finding, View, noise_of
from hil_forceps.data.run import Column
from hil_forceps.model.drive_law import DriveState, law_current, law_vector
from hil_forceps.rig.schema import Rig
from hil_forceps.rig.sections import DriveLaw

FEWEST_ROWS = 200  # of a piece in which channels are held against each other
_MOST_LAG_ROWS = 120  # either way
BELIEVED = 0.5  # share of variance explained, from which a law, a sign or a factor is believed
_LAW_HOLDS = 0.9  # share of the current's variance that the law explains, beyond noise
_SAME_UNIT = 3.0  # a factor this near to that of a unit is the unit
_CLIPPED_ROWS = 5  # in a row
_PLATEAU_SD = 4.0  # deviations of the noise: how wide a plateau is
_ASKED_MORE = 1.1  # a little more is asked wherever a channel is late


class Match(NamedTuple):
    """How one channel follows from another at the shift that suits best: y(t) ≈ slope · x(t − lag) + offset."""

    lag_rows: int
    slope: float
    share: float  # of y's variance that is explained
    share_unshifted: float  # the same at the lag that is expected


def best_match(x: Column, y: Column, expected_lag: int) -> Match:
    """Find the lag, in rows, at which `x` explains most of `y`; nothing is explained where either stands still."""
    most = min(_MOST_LAG_ROWS, len(y) // 4)
    inner = y[most : len(y) - most] - np.mean(y)
    count = len(inner)
    products = correlate(x - np.mean(x), inner - np.mean(inner), mode="valid", method="fft")
    sums = np.concatenate([[0.0], np.cumsum(x - np.mean(x))])
    squares = np.concatenate([[0.0], np.cumsum(np.square(x - np.mean(x)))])
    starts = np.arange(len(products))
    mean = (sums[starts + count] - sums[starts]) / count
    variance = (squares[starts + count] - squares[starts]) / count - np.square(mean)
    own = float(np.var(inner))
    if own <= 0.0 or not np.any(variance > 0.0):
        return Match(expected_lag, 0.0, 0.0, 0.0)
    slopes = np.where(variance > 1e-12 * np.max(variance), products / count / np.maximum(variance, 1e-300), 0.0)
    shares = np.square(slopes) * variance / own
    best = int(np.argmax(shares))
    # x from row `start` on stands beside y from row `most` on: y is late by most - start.
    return Match(most - best, float(slopes[best]), float(shares[best]), float(shares[most - expected_lag]))


def commanded(theta_ref: Column, theta: Column, interval_s: float, law: DriveLaw) -> Column:
    """Return what the law commands at each row, taken as its samples, the integral starting at 0."""
    numbers = law_vector(law.model_copy(update={"sample_time_s": interval_s}))
    return law_current(numbers, theta_ref, theta, DriveState(0.0, math.nan, 0.0, 0.0))


def audit_law(view: View, rig: Rig | None) -> Iterator[Finding]:
    """Yield what current and law say of each other; nothing without a law, a reference or a current."""
    law = None if rig is None else rig.drive
    needed = ("theta_m_ref_rad", "current_A")
    if rig is None or law is None or any(name not in view.columns for name in needed):
        yield from _clipped_without_law(view)
        return
    current, theta = view.piece("current_A"), view.piece("theta_m_rad")
    if len(current) < FEWEST_ROWS or view.is_constant["current_A"] or view.is_constant["theta_m_rad"]:
        return
    command = commanded(view.piece("theta_m_ref_rad"), theta, view.interval_s, law)
    clipped = list(_clipped(view, command, current, law))
    yield from clipped
    noise = view.noise_sd["current_A"]
    if np.std(current) < 4.0 * max(noise, rig.noise.current_A):
        return
    match = best_match(command, current, 1)
    ratio = view.interval_s / law.sample_time_s
    if match.share < BELIEVED:
        text = (
            f"the rig's drive law does not explain current_A by theta_m_ref_rad and theta_m_rad "
            f"({100 * match.share:.0f} % explained): another rig, or channels of different runs"
        )
        yield view.finding("drive_law", "current_A", "problem", text)
        return
    yield from _scale(view, match)
    if match.lag_rows not in ((1,) if ratio < 1.5 else (0, 1)) and match.share > match.share_unshifted + 1e-3:
        late = (match.lag_rows - 1) * view.interval_s
        told = "lags" if late > 0 else "leads"
        text = f"current_A {told} the command of the drive's law by {1e3 * abs(late):.4g} ms"
        yield view.finding("channel_shift", "current_A", "warning", text)
    if abs(match.slope) < _SAME_UNIT and match.share < _LAW_HOLDS and ratio < 1.5 and not clipped:
        text = f"the rig's drive law explains only {100 * match.share:.0f} % of current_A: check its gains"
        yield view.finding("drive_law", "current_A", "warning", text)
    if rig.noise.current_A > 0.0 and ratio < 1.5 and match.share > 0.99:
        left = current[1:] - match.slope * command[:-1]
        yield from noise_finding(view, "current_A", noise_of(left), rig.noise.current_A)


def _scale(view: View, match: Match) -> Iterator[Finding]:
    if match.slope < 0.0:
        text = "current_A has the opposite sign of the command of the drive's law: invert it"
        yield view.finding("sign", "current_A", "problem", text)
    factor = abs(match.slope)
    for unit, thousandths in (("mA", factor), ("kA", 1.0 / factor if factor else 0.0)):
        if in_thousandths(thousandths):
            text = f"current_A is {factor:.4g} times the command of the drive's law: it seems to be in {unit}"
            yield view.finding("unit", "current_A", "problem", text)


def in_thousandths(factor: float) -> bool:
    """Tell whether what is too large by a factor is in thousandths of its unit."""
    return 1.0 / _SAME_UNIT < abs(factor) / 1000.0 < _SAME_UNIT


def _clipped(view: View, command: Column, current: Column, law: DriveLaw) -> Iterator[Finding]:
    """Find where the current stands at an extreme while the law asks for more."""
    if law.ki_A_per_rad_s > 0.0:  # what the integral held when the run began is in all commands
        command = command + float(np.median(current[1:] - command[:-1]))
    top = float(np.quantile(np.abs(current), 0.999))
    width = max(_PLATEAU_SD * view.noise_sd["current_A"], 1e-3 * top)
    at_top = np.abs(current[1:]) > top - width
    is_flat = (
        at_top
        & (np.abs(command[:-1]) > _ASKED_MORE * top + 2.0 * width)
        & (np.sign(command[:-1]) == np.sign(current[1:]))
    )
    at_limit = np.abs(current[1:]) > law.current_limit_A - width
    if _longest(at_limit) >= _CLIPPED_ROWS:
        share = float(np.mean(at_limit))
        text = f"current_A is at the rig's limit of {law.current_limit_A:.4g} A for {100 * share:.2g} % of the run"
        yield view.finding("clipped", "current_A", "warning", text)
    elif _longest(is_flat) >= _CLIPPED_ROWS and np.std(np.abs(current[1:][is_flat])) < width:
        share = float(np.mean(is_flat))
        text = (
            f"current_A stays at {top:.4g} A for {100 * share:.2g} % of the run although the law commands more: "
            f"it is clipped below the rig's limit of {law.current_limit_A:.4g} A"
        )
        yield view.finding("clipped", "current_A", "warning", text)


def _clipped_without_law(view: View) -> Iterator[Finding]:
    """Find a flat top that comes back: several stretches at exactly the same extreme, on either side."""
    values = view.columns[view.torque_channel]
    if view.is_constant[view.torque_channel]:
        return
    for extreme, side in ((float(np.max(values)), "highest"), (float(np.min(values)), "lowest")):
        at = np.concatenate([[0], (values == extreme).astype(np.int8), [0]])
        begins = np.flatnonzero(np.diff(at) == 1)
        lengths = np.flatnonzero(np.diff(at) == -1) - begins
        if np.count_nonzero(lengths >= _CLIPPED_ROWS) >= 2 and view.quanta[view.torque_channel] < 0.01 * np.ptp(values):
            share = float(np.mean(values == extreme))
            text = f"{view.torque_channel} stays at its {side} value, {extreme:.5g}, for {100 * share:.2g} % of the run"
            yield view.finding("clipped", view.torque_channel, "warning", f"{text}: it may be clipped")


def _longest(flags: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return int(np.max(edges[1::2] - edges[::2])) if edges.size else 0
