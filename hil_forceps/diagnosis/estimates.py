"""What an estimator makes of runs: τ̂_w and θ̂_j from motor angle and current alone, sample by sample, with a given rig.

Before: the rig with its known parameters refitted; after: the same with the effects named. The load and jaw that were
measured judge the estimates and nothing more.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.experiment import Record
from hil_forceps.diagnosis.heldout import blocks, gain_of
from hil_forceps.diagnosis.result import Gain
from hil_forceps.estimation import batch
from hil_forceps.estimation.registry import make_estimator
from hil_forceps.model.sensors import late
from hil_forceps.rig import Rig

Vector = NDArray[np.float64]

ALGORITHM = "kalman"  # of the published gains
SHORT = {"theta_m_rad": "theta_m_s", "current_A": "current_s", "theta_j_rad": "theta_j_s", "tau_w_N_m": "tau_w_s"}


class Estimates(NamedTuple):
    """Estimates at the rows of a run."""

    tau_w_N_m: Vector
    theta_j_rad: Vector


def estimate(record: Record, rig: Rig, algorithm: str = ALGORITHM) -> Estimates:
    """Return the estimates at each row of a run (n); causal.

    Where the rig says that a channel is stamped late, the others wait for it. θ̂_j = (r_m θ_m − x̂)/r_j (10), with what
    the effects of the rig do to it in x̂. UserError when the rig doesn't know a value; ValueError for an unknown
    algorithm.
    """
    skew = _skew(rig)
    plant = rig.plant()
    behind_s = max(skew["theta_m_rad"], skew["current_A"])
    angle = _waiting(record, record.channels["theta_m_rad"], behind_s - skew["theta_m_rad"])
    if "tau_m_N_m" in record.channels:
        torque = record.channels["tau_m_N_m"]
    else:
        torque = plant.torque_constant_N_m_per_A * record.channels["current_A"]
    torque = _waiting(record, torque, behind_s - skew["current_A"], linear=True)
    estimator = make_estimator(algorithm, rig, record.period_s, over_wire=False)
    time_ns = np.rint(record.time_s * 1e9).astype(np.int64)
    tau_w, elongation = batch.run(estimator, time_ns, angle, torque)
    theta_j = (plant.motor_pulley_radius_m * angle - elongation) / plant.jaw_pulley_radius_m
    return Estimates(
        _waiting(record, tau_w, skew["tau_w_N_m"] - behind_s), _waiting(record, theta_j, skew["theta_j_rad"] - behind_s)
    )


def _skew(rig: Rig) -> dict[str, float]:
    told = rig.effects.get("channel_skew", {})
    return {channel: told.get(name, 0.0) for channel, name in SHORT.items()}


def _waiting(record: Record, values: Vector, wait_s: float, *, linear: bool = False) -> Vector:
    """Return values as they were a while ago; what would have to be foretold stays as it is."""
    return late(values, max(0.0, wait_s) / record.period_s, linear=linear)


def measured(record: Record) -> dict[str, Vector]:
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
    records: Sequence[Record],
    before: Rig,
    after: Rig,
    simulated: Sequence[Mapping[str, Vector]],
    noise_sd: Mapping[str, float],
    seed: int,
    algorithm: str = ALGORITHM,
) -> tuple[list[dict[str, Vector]], dict[str, Gain]]:
    """Return the estimates of each run before and after, and what was gained where the truth was measured.

    `simulated`: the channels of each run as the model after has them. The floor is the error that the same estimator
    leaves there, where its rig is the truth, and the noise (`noise_sd`) of the sensor that it is compared with.
    """
    rng = np.random.default_rng(seed)
    pairs = [(estimate(record, before, algorithm), estimate(record, after, algorithm)) for record in records]
    shown = [compared(*pair) for pair in pairs]
    gains = {}
    for name in ("tau_w_N_m", "theta_j_rad"):
        first, second, ideal = [], [], []
        for record, pair, channels in zip(records, pairs, simulated, strict=True):
            if name in measured(record):
                truth = measured(record)[name]
                first += blocks(record, truth - getattr(pair[0], name))
                second += blocks(record, truth - getattr(pair[1], name))
                play = record._replace(channels={**record.channels, **channels})
                ideal += blocks(record, measured(play)[name] - getattr(estimate(play, after, algorithm), name))
        if first:
            squares, counts = np.array(ideal).sum(axis=0)
            sd = noise_sd.get(name, 0.0)
            floor = float(np.sqrt(squares / max(counts, 1.0) + sd * sd))
            stem, unit = (name.removesuffix("_N_m"), "N_m") if name.endswith("_N_m") else ("theta_j", "rad")
            gains[f"{stem}_estimate_{unit}"] = gain_of(np.array(first), np.array(second), floor, rng)
    return shown, gains
