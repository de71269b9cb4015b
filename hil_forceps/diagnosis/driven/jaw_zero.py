"""The zero between two encoders, where the measured motion drives the simulation: a property of the data, no effect.

An encoder that counts from where it was switched on has any zero. Zeros of single runs are fitted, and kept near each
other by a prior; what all runs have in common would be taken for a wire stretched by millimetres.

    θ_j = a θ_m − b τ_w − c sgn ω + zero, over all runs at once
"""

from collections.abc import Sequence

import numpy as np

from hil_forceps.diagnosis.driven.rows import DrivenRows, angle_balance

FAR_SHARE = 0.1  # of the jaw's range: a zero nearer than this is left for the fit


def without_jaw_zero(
    records: Sequence[DrivenRows], held_out: Sequence[DrivenRows]
) -> tuple[list[DrivenRows], list[DrivenRows], tuple[str, ...]]:
    """Return the runs with the common zero taken out of the jaw's angle, and a note; as they are where it's near."""
    zero = jaw_zero_rad(records)
    angles = [jaw for record in records if (jaw := record.jaw_rad) is not None]
    if zero is None or abs(zero) <= FAR_SHARE * max(float(np.ptp(angle)) for angle in angles):
        return list(records), list(held_out), ()
    note = f"theta_j_rad has an offset of {zero:.4g} rad against theta_m_rad; it is removed from every run"
    return [_moved(r, zero) for r in records], [_moved(r, zero) for r in held_out], (note,)


def jaw_zero_rad(records: Sequence[DrivenRows]) -> float | None:
    """Return the jaw's angle at the motor's zero without load, by least squares; None where no jaw was measured."""
    columns, jaw = angle_balance(records)
    if jaw.size < 4:
        return None
    with_zero = np.column_stack((columns, np.ones(jaw.size)))
    return float(np.linalg.lstsq(with_zero, jaw, rcond=1e-9)[0][-1])


def _moved(record: DrivenRows, zero: float) -> DrivenRows:
    channels = dict(record.rows.channels)
    if "theta_j_rad" in channels:
        channels["theta_j_rad"] = channels["theta_j_rad"] - zero
    driving = None if record.theta_j_rad is None else record.theta_j_rad - zero
    smoothed = record.smoothed
    if smoothed.theta_j_rad is not None:
        smoothed = smoothed._replace(theta_j_rad=smoothed.theta_j_rad - zero)
    return record._replace(rows=record.rows._replace(channels=channels), theta_j_rad=driving, smoothed=smoothed)
