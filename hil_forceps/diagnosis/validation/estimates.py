"""What an estimator makes of runs: τ̂_w and θ̂_j from motor angle and current alone, sample by sample, with a given rig.

Before: the rig with its known parameters refitted; after: the same with the effects named. The load and jaw that were
measured judge the estimates and nothing more.
"""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from hil_forceps.diagnosis.result import Gain
from hil_forceps.diagnosis.validation.heldout import blocks, gain_of
from hil_forceps.diagnosis.validation.rows import Rows
from hil_forceps.estimation import batch
from hil_forceps.estimation.registry import make_estimator
from hil_forceps.model.sensors import late
from hil_forceps.rig import Rig, UserError

Vector = NDArray[np.float64]

ALGORITHM = "kalman"  # of the gains that a diagnosis tells
GAINS = {"tau_w_N_m": "tau_w_estimate_N_m", "theta_j_rad": "theta_j_estimate_rad"}
SKEWS = {"theta_m_rad": "theta_m_s", "current_A": "current_s", "theta_j_rad": "theta_j_s", "tau_w_N_m": "tau_w_s"}


class Estimates(NamedTuple):
    """Estimates at the rows of a run."""

    tau_w_N_m: Vector
    theta_j_rad: Vector


def estimate(record: Rows, rig: Rig, algorithm: str = ALGORITHM) -> Estimates:
    """Return the estimates at each row of a run (n); causal.

    θ̂_j = (r_m θ_m − x̂)/r_j (10), with what the effects of the rig do to it in x̂. Where the rig says that channels are
    stamped late against each other, the early ones wait, as do the estimates for a late sensor that they are compared
    with; an angle that comes late goes on at its speed. UserError when the rig doesn't know a value; ValueError for an
    unknown algorithm.
    """
    plant, late_s = rig.plant(), _lateness(rig)
    # What is stamped late can't be hurried; what is stamped early would be of the future.
    angle = _waiting(record, record.channels["theta_m_rad"], -late_s["theta_m_rad"])
    if "tau_m_N_m" in record.channels:
        torque = record.channels["tau_m_N_m"]
    else:
        torque = plant.torque_constant_N_m_per_A * record.channels["current_A"]
    torque = _waiting(record, torque, -late_s["current_A"])
    estimator = make_estimator(algorithm, rig, record.period_s, over_wire=False)
    time_ns = np.rint(record.time_s * 1e9).astype(np.int64)
    tau_w, elongation = batch.run(estimator, time_ns, angle, torque)
    now = angle + max(0.0, late_s["theta_m_rad"]) * _speed(angle, record.period_s, rig.estimators.rfob_cutoff_Hz)
    theta_j = (plant.motor_pulley_radius_m * now - elongation) / plant.jaw_pulley_radius_m
    return Estimates(_waiting(record, tau_w, late_s["tau_w_N_m"]), _waiting(record, theta_j, late_s["theta_j_rad"]))


def ready_estimator(rig: Rig, period_s: float) -> None:
    """Run the estimator over two rows, so that it is compiled; nothing where the rig doesn't know a value."""
    with suppress(UserError):
        estimator = make_estimator(ALGORITHM, rig, period_s, over_wire=False)
        batch.run(estimator, np.array([0, round(period_s * 1e9)]), np.zeros(2), np.zeros(2))


def _lateness(rig: Rig) -> dict[str, float]:
    told = rig.effects.get("channel_skew", {})
    return {channel: told.get(name, 0.0) for channel, name in SKEWS.items()}


def _waiting(record: Rows, values: Vector, wait_s: float) -> Vector:
    """Return values as they were a while ago; for less than no time they stay. A cubic would need rows to come."""
    return late(values, max(0.0, wait_s) / record.period_s, linear=True)


def _speed(angle: Vector, period_s: float, corner_Hz: float) -> Vector:
    """Return the backward difference through a low-pass of first order."""
    kept = float(np.exp(-2.0 * np.pi * corner_Hz * period_s))
    difference = np.diff(angle, prepend=angle[0]) / period_s
    return np.asarray(lfilter([1.0 - kept], [1.0, -kept], difference), dtype=np.float64)


def measured(record: Rows) -> dict[str, Vector]:
    """Return what was measured of what is estimated."""
    truth = {} if record.tau_w_N_m is None else {"tau_w_N_m": record.tau_w_N_m}
    if "theta_j_rad" in record.channels:
        truth["theta_j_rad"] = record.channels["theta_j_rad"]
    return truth


def compared(before: Estimates, after: Estimates) -> dict[str, Vector]:
    """Return the estimates under the names that `RunEvidence.estimates` has for them."""
    return {
        "tau_w_before_N_m": before.tau_w_N_m,
        "tau_w_after_N_m": after.tau_w_N_m,
        "theta_j_before_rad": before.theta_j_rad,
        "theta_j_after_rad": after.theta_j_rad,
    }


def estimate_gains(
    records: Sequence[Rows],
    rigs: tuple[Rig, Rig],
    simulated: Sequence[Mapping[str, Vector]],
    noise_sd: Mapping[str, float],
    seed: int,
    algorithm: str = ALGORITHM,
) -> tuple[list[dict[str, Vector]], dict[str, Gain]]:
    """Return the estimates of each run before and after, and what was gained where the truth was measured.

    `rigs`: with its parameters refitted, and the same with effects. `simulated`: the channels of each run as the latter
    has them. The floor is the error that the same estimator leaves there, where its rig is the truth, with the noise
    (`noise_sd`) of the sensor that it is compared with. An unknown zero of that sensor is in both errors.
    """
    rng = np.random.default_rng(seed)
    pairs = [(estimate(record, rigs[0], algorithm), estimate(record, rigs[1], algorithm)) for record in records]
    played = [r._replace(channels={**r.channels, **own}) for r, own in zip(records, simulated, strict=True)]
    ideal = [estimate(record, rigs[1], algorithm) for record in played]
    gains = {}
    for name, key in GAINS.items():
        first, second, least = [], [], []
        for k, record in enumerate(records):
            if name in measured(record):
                truth = measured(record)[name]
                first += blocks(record, truth - getattr(pairs[k][0], name))
                second += blocks(record, truth - getattr(pairs[k][1], name))
                least += blocks(record, measured(played[k])[name] - getattr(ideal[k], name))
        if first:
            squares, count = np.sum(least, axis=0)
            floor = math.hypot(math.sqrt(squares / max(count, 1.0)), noise_sd.get(name, 0.0))
            gains[key] = gain_of(np.array(first), np.array(second), floor, rng)
    return [compared(*pair) for pair in pairs], gains
