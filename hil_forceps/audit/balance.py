"""Audit of channels against each other by kinematics and torque: signs, units, ratio, shift."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.signal import savgol_filter

from hil_forceps.audit.finding import Finding, View
from hil_forceps.audit.law import BELIEVED, FEWEST_ROWS, best_match, in_thousandths
from hil_forceps.data.run import Column
from hil_forceps.rig.schema import Rig

_UNIT_MATCH = 1.5  # a factor this near to that of a unit is the unit
_RATIO_TOLERANCE = 0.25  # of the ratio by the rig's pulleys: less is for the diagnosis
_UNRELATED = 0.2  # share of variance explained, below which a jaw doesn't follow
_LOAD_MATTERS = 0.1  # share of the torque's variance, from which a load is judged by it
_SHIFT_GAIN = 1.25  # times less is left unexplained by a shift that is told
_VELOCITY_TRUST = 0.8  # share of a velocity's variance explained, from which its shift is looked at


def audit_kinematics(view: View, rig: Rig | None) -> Iterator[Finding]:
    """Yield what reference, motor angle and jaw angle say of each other."""
    if len(view.piece("time_s")) < FEWEST_ROWS or view.is_constant["theta_m_rad"]:
        return
    if "theta_m_ref_rad" in view.columns and not view.is_constant["theta_m_ref_rad"]:
        yield from _reference(view)
    if "theta_j_rad" in view.columns and not view.is_constant["theta_j_rad"]:
        yield from _jaw(view, rig)


def jaw_ratio(view: View) -> tuple[float, float]:
    """Return (Δθ_j/Δθ_m, share of θ_j's variance that it explains), a load's part of θ_j taken out."""
    if view.jaw_ratio is None:
        regressors = [view.piece("theta_m_rad")]
        if "tau_w_N_m" in view.columns and not view.is_constant["tau_w_N_m"]:
            regressors.append(view.piece("tau_w_N_m"))
        fit = _fit(regressors, view.piece("theta_j_rad"))
        view.jaw_ratio = float(fit.slopes[0]), fit.shares[0]
    return view.jaw_ratio


class _Fit(NamedTuple):
    slopes: Column
    shares: list[float]  # of the variance that would be lost without each regressor
    partial: list[float]  # the same, of what the other regressors leave


def _fit(regressors: list[Column], values: Column) -> _Fit:
    """Least squares with an offset; regressors that stand still get slope 0."""
    centred = [each - np.mean(each) for each in regressors]
    scales = [float(np.std(each)) or 1.0 for each in centred]
    matrix = np.column_stack([each / scale for each, scale in zip(centred, scales, strict=True)])
    target = values - np.mean(values)
    gram, moments = matrix.T @ matrix, matrix.T @ target
    inverse = np.linalg.pinv(gram, rcond=1e-10)
    slopes = inverse @ moments
    total = float(target @ target) or 1.0
    losses = [float(slope**2 / inverse[k, k]) / total if inverse[k, k] > 0.0 else 0.0 for k, slope in enumerate(slopes)]
    rest = target - matrix @ slopes
    left = float(rest @ rest) / total
    return _Fit(slopes / np.array(scales), losses, [loss / (loss + left) if loss > 0.0 else 0.0 for loss in losses])


def _reference(view: View) -> Iterator[Finding]:
    match = best_match(view.piece("theta_m_ref_rad"), view.piece("theta_m_rad"), 0)
    if match.share < BELIEVED:
        text = f"theta_m_rad does not follow theta_m_ref_rad ({100 * match.share:.0f} % explained)"
        yield view.finding("reference", "theta_m_ref_rad", "warning", text)
    elif match.slope < 0.0:
        text = "theta_m_rad moves opposite to theta_m_ref_rad: one of them has the wrong sign"
        yield view.finding("sign", "theta_m_ref_rad", "problem", text)
    else:
        yield from _degrees(view, match.slope, ("theta_m_ref_rad", "theta_m_rad"))


def _degrees(view: View, factor: float, pair: tuple[str, str]) -> Iterator[Finding]:
    """Tell which of two angles is in degrees when the second is `factor` times what the first lets expect."""
    degree = math.degrees(1.0)
    for channel, other, size in ((pair[1], pair[0], degree), (pair[0], pair[1], 1.0 / degree)):
        if 1.0 / _UNIT_MATCH < factor / size < _UNIT_MATCH:
            text = f"{channel} seems to be in degrees: it is 57 times as large as {other} predicts"
            yield view.finding("unit", channel, "problem", text)


def _jaw(view: View, rig: Rig | None) -> Iterator[Finding]:
    ratio, share = jaw_ratio(view)
    if share < BELIEVED:
        if share < _UNRELATED and np.std(view.piece("theta_m_rad")) > 20.0 * max(
            view.noise_sd["theta_j_rad"], view.quanta["theta_m_rad"]
        ):
            text = f"theta_j_rad does not follow theta_m_rad ({100 * share:.0f} % explained)"
            yield view.finding("kinematics", "theta_j_rad", "warning", text)
        return
    if ratio < 0.0:
        text = "theta_j_rad falls where theta_m_rad rises: one of them has the wrong sign"
        yield view.finding("sign", "theta_j_rad", "problem", text)
    expected = None if rig is None else _ratio(rig)
    if expected is not None:
        factor = abs(ratio) / expected
        found = list(_degrees(view, factor, ("theta_m_rad", "theta_j_rad")))
        yield from found
        if not found and abs(factor - 1.0) > _RATIO_TOLERANCE:
            text = (
                f"theta_j_rad moves {abs(ratio):.4g} times as far as theta_m_rad, but the rig's radii give "
                f"{expected:.4g}: the instrument is another one, or the radii are wrong"
            )
            yield view.finding("kinematics", "theta_j_rad", "problem", text)
    yield from _shift(view)


def _shift(view: View) -> Iterator[Finding]:
    """Compare the velocities of both angles at all shifts; what the load does to the wire has no part in the shift."""
    steps = [view.piece(name)[5:] - view.piece(name)[:-5] for name in ("theta_m_rad", "theta_j_rad")]
    match = best_match(steps[0], steps[1], 0)
    if match.share < _VELOCITY_TRUST or abs(match.lag_rows) < 2:
        return
    gain = (1.0 - match.share_unshifted) / max(1.0 - match.share, 1e-12)
    if gain > _SHIFT_GAIN:
        late = match.lag_rows * view.interval_s
        text = f"theta_j_rad {'lags' if late > 0 else 'leads'} theta_m_rad by {1e3 * abs(late):.4g} ms"
        yield view.finding("channel_shift", "theta_j_rad", "warning", text)


def audit_torque(view: View, rig: Rig, is_judged_by_law: bool) -> Iterator[Finding]:
    """Yield what motor torque and load say of each other: signs and units.

    The load is looked at only where it makes a fair part of the torque; the sign and unit of the current only where
    the drive's law does not already tell.
    """
    torque = view.piece(view.torque_channel)
    if len(torque) < FEWEST_ROWS or view.is_constant[view.torque_channel] or view.is_constant["theta_m_rad"]:
        return
    constant = rig.motor.torque_constant_N_m_per_A.value if view.torque_channel == "current_A" else 1.0
    load = view.columns.get("tau_w_N_m")
    has_load = load is not None and not view.is_constant["tau_w_N_m"]
    motion = _motion_torque(view, rig)
    if motion is None or constant is None:
        return
    parts = [motion, view.piece("tau_w_N_m")] if has_load else [motion]
    fit = _fit(parts, torque * constant)
    factor = float(fit.slopes[0]) if fit.partial[0] > BELIEVED else 1.0
    if not is_judged_by_law:
        yield from _torque_scale(view, view.torque_channel, factor, factor)
    ratio = _ratio(rig)
    if has_load and ratio and fit.partial[1] > BELIEVED and fit.shares[1] > _LOAD_MATTERS:
        # A torque in mN m, or turned round, is already told: the load is judged beside it.
        load_factor = float(fit.slopes[1]) / ratio / (factor if factor < 0.0 or in_thousandths(factor) else 1.0)
        yield from _torque_scale(view, "tau_w_N_m", load_factor, 1.0 / load_factor if load_factor else 1.0)


def _torque_scale(view: View, channel: str, factor: float, size: float) -> Iterator[Finding]:
    """Tell a wrong sign by `factor`, the torque per expected torque, a wrong unit by how much too large it is."""
    if factor < 0.0:
        text = f"{channel} has the wrong sign: motion and load require the opposite"
        yield view.finding("sign", channel, "problem", text)
    if in_thousandths(size):
        text = f"{channel} is about {abs(size):.3g} times too large: it seems to be in thousandths of its unit"
        yield view.finding("unit", channel, "problem", text)


def _motion_torque(view: View, rig: Rig) -> Column | None:
    """Return what inertia and friction take at the motor pulley; None where the rig doesn't know them."""
    forceps = rig.forceps
    ratio = _ratio(rig)
    known = [
        forceps.motor_inertia_kg_m2.value,
        forceps.jaw_inertia_kg_m2.value,
        forceps.motor_viscous_N_m_s_per_rad.value,
        forceps.motor_coulomb_N_m.value,
    ]
    if ratio is None or any(value is None for value in known):
        return None
    motor, jaw, viscous, coulomb = (value or 0.0 for value in known)
    theta, step = view.piece("theta_m_rad"), view.interval_s
    velocity = savgol_filter(theta, 11, 2, deriv=1, delta=step)
    acceleration = savgol_filter(theta, 45, 2, deriv=2, delta=step)
    torque: Column = (motor + ratio**2 * jaw) * acceleration + viscous * velocity + coulomb * np.sign(velocity)
    return torque


def _ratio(rig: Rig) -> float | None:
    motor, jaw = rig.forceps.motor_pulley_radius_m.value, rig.forceps.jaw_pulley_radius_m.value
    return None if motor is None or jaw is None else motor / jaw
