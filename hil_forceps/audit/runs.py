"""Audit of what the runs excite, and of the runs among each other: the same one twice, one of another rig."""

from collections.abc import Iterator, Sequence
from hashlib import blake2b

import numpy as np

from hil_forceps.audit.balance import jaw_ratio
from hil_forceps.audit.finding import Finding, View

_MOVES = 5.0  # counts or deviations of the noise, from which something moves ...
_MOVES_RAD = 1e-3  # ... and the least way
_LOAD_SD = 10.0  # deviations of the noise, from which there is a load
_RATIO_SPREAD = 0.1  # of the usual ratio: how far runs of one instrument may differ
_HEAD_ROWS = 500  # that are the same only in cuts of one recording, or simulations that begin alike


def audit_excitation(view: View) -> Iterator[Finding]:
    """Yield what one run lets anyone learn: travel, speed, reversals, load and its directions."""
    theta = view.piece("theta_m_rad")
    travel = float(np.ptp(theta))
    still = max(_MOVES * view.quanta["theta_m_rad"], _MOVES * view.noise_sd["theta_m_rad"], _MOVES_RAD)
    rows = min(max(round(0.02 / view.interval_s), 1), len(theta) - 1)  # motion is looked at over 20 ms
    step = theta[rows:] - theta[:-rows]
    noise = max(2.0 * view.quanta["theta_m_rad"], 4.0 * view.noise_sd["theta_m_rad"], 1e-3 * travel)
    direction = np.sign(step) * (np.abs(step) > noise)
    moving = direction[direction != 0]
    reversals = float(np.count_nonzero(np.diff(moving)))
    if travel < still:
        text = f"no motion: theta_m_rad moves by {travel:.3g} rad; this run shows neither friction nor inertia"
        yield view.finding("excitation", "theta_m_rad", "warning", text)
        return
    load = _load_text(view)
    turns = travel / (2.0 * np.pi)
    text = f"range of {travel:.3g} rad ({turns:.2g} turns), {reversals:.0f} reversals, {load}"
    yield view.finding("excitation", "", "note", text)
    if moving.size and np.all(moving == moving[0]):
        text = "theta_m_rad moves in one direction only: friction and load can't be distinguished"
        yield view.finding("one_direction", "theta_m_rad", "warning", text)


def _load_text(view: View) -> str:
    if "tau_w_N_m" not in view.columns:
        return "load not measured"
    load = view.columns["tau_w_N_m"]
    noise = max(_LOAD_SD * view.noise_sd["tau_w_N_m"], 2.0 * view.quanta["tau_w_N_m"])
    low, high = float(np.min(load)), float(np.max(load))
    if high - low <= noise and max(abs(low), abs(high)) <= noise:
        return "no load"
    sides = "in both directions" if low < -noise and high > noise else "in one direction"
    return f"load from {low:.3g} to {high:.3g} N m, {sides}"


def audit_together(views: Sequence[View]) -> Iterator[Finding]:
    """Yield what the runs say of each other."""
    yield from _duplicates(views)
    ratios = {}
    for view in views:
        if "theta_j_rad" in view.columns and not view.is_constant["theta_m_rad"]:
            ratio, share = jaw_ratio(view)
            if share > 0.9:
                ratios[view.name] = ratio
    if len(ratios) > 2:
        usual = float(np.median(list(ratios.values())))
        for name, ratio in ratios.items():
            if abs(ratio / usual - 1.0) > _RATIO_SPREAD:
                text = f"theta_j_rad moves {ratio:.4g} times as far as theta_m_rad, but {usual:.4g} times in other runs"
                yield Finding("odd_run", "problem", name, "theta_j_rad", text)
    loads = [view.columns["tau_w_N_m"] for view in views if "tau_w_N_m" in view.columns]
    if not loads:
        text = "tau_w_N_m was measured in no run: the load is unknown, stiffness and jaw friction hardly show"
        yield Finding("no_load_cell", "note", "", "tau_w_N_m", text)
    if not any("theta_j_rad" in view.columns for view in views):
        text = "theta_j_rad was measured in no run: the wire shows only in the motor's torque"
        yield Finding("no_jaw_sensor", "note", "", "theta_j_rad", text)


def _duplicates(views: Sequence[View]) -> Iterator[Finding]:
    whole: dict[bytes, str] = {}
    heads: dict[bytes, str] = {}
    for view in views:
        columns = (view.columns["theta_m_rad"], view.columns[view.torque_channel])
        if any(np.ptp(column[:_HEAD_ROWS]) == 0.0 for column in columns):
            continue  # standing still at the beginning is no likeness
        key = _digest(columns, len(view))
        head = _digest(columns, _HEAD_ROWS)
        if key in whole:
            text = f"the same data as run {whole[key]}: used twice, they would make all intervals too narrow"
            yield view.finding("duplicate", "", "problem", text)
        elif head in heads:
            text = (
                f"the first {_HEAD_ROWS} rows are those of run {heads[head]}: two parts of one recording, or two "
                "simulations with the same start"
            )
            yield view.finding("duplicate", "", "warning", text)
        whole.setdefault(key, view.name)
        heads.setdefault(head, view.name)


def _digest(columns: tuple[np.ndarray[tuple[int], np.dtype[np.float64]], ...], rows: int) -> bytes:
    digest = blake2b(digest_size=16)
    for column in columns:
        digest.update(np.ascontiguousarray(column[:rows]).tobytes())
    return digest.digest()
