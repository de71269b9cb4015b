"""Audit of single channels: constant, stuck, held, spikes, quantum, noise."""

import math
from collections.abc import Iterator

import numpy as np

from hil_forceps.audit.finding import Finding, Severity, View
from hil_forceps.data.run import Column
from hil_forceps.rig.schema import Rig

_STUCK_ROWS = 20  # the least that is told
_STUCK_FACTOR = 10.0  # times as long as the channel stands otherwise
_STUCK_QUANTA = 3.5  # counts: a jump behind a stop
_STUCK_JUMP = 3.0  # times the steps that follow
_SPIKE_SD = 12.0  # deviations of the noise: an outlier's height ...
_SPIKE_QUANTA = 8.0  # ... and in counts
_AROUND = (-4, -3, -2, 2, 3, 4)  # rows beside an outlier of one or two samples
_CALM = 0.25  # of the outlier's height: beside a true transient the signal moves as well
_COARSE_STEPS = 20.0  # that a channel moves over: fewer are coarse
_NOISE_FACTOR = 3.0  # times what the rig says, or less than that share of it
_SAME_COUNTS = 0.03  # share by which steps of one encoder differ
_SURELY_OTHER = 1.5  # a wrong scale of some percent is for the diagnosis
_FINEST_COUNTS = 1 << 20  # a turn: finer ones are printed decimals


def audit_channels(view: View, rig: Rig | None) -> Iterator[Finding]:
    """Yield what each channel of one run shows by itself."""
    for channel, values in view.channels.items():
        if view.is_constant[channel]:
            yield _constant(view, channel, float(values[0]))
            continue
        yield from _stuck(view, channel)
        yield from _spikes(view, channel)
        yield from _noise(view, channel, rig)
        if channel != "theta_m_ref_rad":
            yield from _quantum(view, channel, rig)


def _constant(view: View, channel: str, value: float) -> Finding:
    is_needed = channel in ("theta_m_rad", view.torque_channel)
    if channel == "tau_w_N_m" and value == 0.0:
        text = "tau_w_N_m is always 0: no load, or no load cell (leave out a channel that was not measured)"
    elif channel == "theta_m_ref_rad":
        text = f"theta_m_ref_rad is constant at {value:.6g}: the drive holds its position"
    else:
        text = f"{channel} is constant at {value:.6g}: a dead sensor, or nothing happened"
    severity: Severity = "problem" if is_needed else "note" if channel == "theta_m_ref_rad" else "warning"
    return view.finding("constant", channel, severity, text)


def _stuck(view: View, channel: str) -> Iterator[Finding]:
    """Find stretches in which a channel that otherwise changes at every sample, stands; and channels held for some."""
    values = view.piece(channel)
    changes = np.flatnonzero(np.diff(values) != 0.0)
    if channel == "theta_m_ref_rad" or len(changes) < 50:
        return
    spacing = np.diff(changes)
    usual = int(np.median(spacing))
    longest = int(np.argmax(spacing))
    rows = int(spacing[longest])
    at = float(view.time_s[view.stretch][changes[longest] + 1])
    if usual > 1 and np.mean(spacing % usual == 0) > 0.95:
        text = f"{channel} changes only once in {usual} rows: it is sampled more slowly than the rest, and held"
        yield view.finding("held", channel, "warning", text)
        return
    is_long = rows >= max(_STUCK_ROWS, _STUCK_FACTOR * np.quantile(spacing, 0.995))
    if is_long and _jumps(view, channel, int(changes[longest + 1])):
        seconds = rows * view.interval_s
        text = f"{channel} is constant for {seconds:.4g} s from {at:.6g} s on; elsewhere it changes at almost every row"
        yield view.finding("stuck", channel, "warning", text)


def _jumps(view: View, channel: str, row: int) -> bool:
    """Tell whether a channel that counts goes on with a jump: what stood by itself begins to move as it goes on."""
    if view.quanta[channel] == 0.0:
        return True  # with noise on it, it never stands by itself
    steps = np.abs(np.diff(view.piece(channel)[row : row + 5]))
    return bool(steps[0] > max(_STUCK_QUANTA * view.quanta[channel], _STUCK_JUMP * np.max(steps[1:], initial=0.0)))


def _spikes(view: View, channel: str) -> Iterator[Finding]:
    """Find single or double samples far from their neighbours; an edge or a pulse of three samples is none."""
    values = view.columns[channel]
    if len(values) < 20 or channel == "theta_m_ref_rad":
        return
    # Against the neighbours but one: an outlier of one or two samples stands out, a smooth signal hardly does.
    usual = max(view.noise_sd[channel], 1e-9 * float(np.ptp(values)))
    limit = max(_SPIKE_SD * usual, _SPIKE_QUANTA * view.quanta[channel])
    jump = np.abs(values[_AROUND[-1] : -_AROUND[-1]] - 0.5 * (values[2:-6] + values[6:-2]))
    candidates = np.flatnonzero(jump > limit) + _AROUND[-1]
    around = values[candidates[:, None] + np.array(_AROUND)]
    base = np.median(around, axis=1)
    away = np.abs(values[candidates] - base)
    is_alone = (away > limit) & (np.max(np.abs(around - base[:, None]), axis=1) < _CALM * away)
    rows, away = candidates[is_alone], away[is_alone]
    if rows.size and rows.size < 0.01 * len(values):
        worst = int(rows[np.argmax(away)])
        text = (
            f"{channel}: {rows.size} outlier{'s' if rows.size > 1 else ''}, the largest {values[worst]:.5g} "
            f"at {view.time_s[worst]:.6g} s"
        )
        yield view.finding("outliers", channel, "warning", text)


def _noise(view: View, channel: str, rig: Rig | None) -> Iterator[Finding]:
    expected = 0.0 if rig is None else float(getattr(rig.noise, channel, 0.0))
    if expected <= 0.0 or channel == "current_A":  # what the drive makes of counts is no noise: see the drive's law
        return
    yield from noise_finding(view, channel, view.noise_sd[channel], expected)


def noise_finding(view: View, channel: str, seen: float, expected: float) -> Iterator[Finding]:
    """Compare noise seen in a channel with what the rig says of it."""
    counted = math.hypot(expected, view.quanta[channel] / math.sqrt(12.0))
    if seen > _NOISE_FACTOR * counted:
        text = f"{channel}: noise of {seen:.3g}, {seen / counted:.3g} times the value in the rig's `noise`"
        yield view.finding("noise", channel, "warning", text)
    elif (
        seen < expected / _NOISE_FACTOR and expected > 1.1 * view.quanta[channel]
    ):  # counts while it stands have no noise
        text = (
            f"{channel}: noise of only {seen:.3g}, but {expected:.3g} in the rig's `noise`: filtered, or another sensor"
        )
        yield view.finding("noise", channel, "warning", text)


def _quantum(view: View, channel: str, rig: Rig | None) -> Iterator[Finding]:
    quantum = view.quanta[channel]
    if channel == "theta_m_rad":
        if rig is not None:
            yield from _encoder(view, quantum, rig.encoder.counts_per_rev)
    elif quantum > 0.0:
        steps = float(np.ptp(view.columns[channel])) / quantum
        if steps < _COARSE_STEPS:
            text = f"{channel} covers only {steps:.0f} steps of {quantum:.4g}: its resolution is coarse for this motion"
            yield view.finding("quantum", channel, "warning", text)


def _encoder(view: View, quantum: float, counts: int | None) -> Iterator[Finding]:
    """Compare the encoder's step in the data with the rig's; a log may leave out counts, so multiples are weighed."""
    wire = 2.0 * math.pi / (1 << 24)
    expected = wire if counts is None else 2.0 * math.pi / counts
    values = view.columns["theta_m_rad"]
    told = "ideal" if counts is None else str(counts)
    if quantum == 0.0:
        if counts is not None and _is_dense(values, expected):
            text = f"theta_m_rad shows no counts, but the rig's encoder has {told} a turn: filtered, or another encoder"
            yield view.finding("quantum", "theta_m_rad", "warning", text)
        return
    ratio = quantum / expected
    steps = float(np.ptp(values)) / quantum
    seen = 2.0 * math.pi / quantum
    if abs(ratio / math.degrees(1.0) - 1.0) < _SAME_COUNTS:
        text = f"theta_m_rad has steps of {quantum:.5g}: the rig's encoder ({told} a turn) in degrees"
        yield view.finding("unit", "theta_m_rad", "problem", text)
    elif counts is None:
        if seen < _FINEST_COUNTS and steps > 10:  # finer ones are printed decimals
            text = f"theta_m_rad has steps of {quantum:.5g} rad, {seen:.0f} a turn, but the rig's encoder is ideal"
            yield view.finding("quantum", "theta_m_rad", "warning", text)
    # A short log may happen to leave out every second count; not every eighth, and no log adds any.
    elif ratio < 1.0 / _SURELY_OTHER or ratio > (_SURELY_OTHER if steps > 30 else 8.0):
        text = f"theta_m_rad has steps of {quantum:.5g} rad, {seen:.0f} a turn, but the rig's encoder has {told}"
        yield view.finding("quantum", "theta_m_rad", "problem", text)


def _is_dense(values: Column, quantum: float) -> bool:
    """Tell whether a channel has moved enough for a lattice of `quantum` to show."""
    return bool(np.ptp(values) > 30 * quantum) and len(np.unique(values)) > 30
