"""How much of hidden effects shows in a set of runs, and effects of a wanted size.

d is the norm of the whitened difference between runs without noise, with and without the effects, after what the
plant's own parameters and the zero of the jaw sensor can explain has been projected out. It counts every row as if
sensor noise were all there is, so no diagnosis can see more than that.
"""

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hil_forceps.rig import Rig
from hil_forceps.rig.catalogue import effect
from tests.hidden_effects.generator import CHANNELS, FIT_SCENARIOS, RIG, quantum_rad, run_seed, simulate, true_rig
from tests.hidden_effects.generator_scenarios import SCENARIOS

Effects = Mapping[str, Mapping[str, float]]
STEPS = {"forceps.motor_coulomb_N_m": 1.0, "forceps.jaw_coulomb_N_m": 1.0}  # relative; so small that 1 % is nothing
STEP = 0.01
SAME_AS_ZERO = ("wire_permanent_stretch",)  # nothing but a jaw sensor of known zero can show it
MAX_SEARCHES = 20


def effect_size(
    effects: Effects,
    seed: int,
    *,
    rig: Rig = RIG,
    scenarios: Sequence[str] = FIT_SCENARIOS,
    drop: Sequence[str] = (),
) -> float:
    """Return d of `effects` in the runs that `make_case` makes to be fitted from the same arguments."""
    channels = tuple(channel for channel in CHANNELS if channel not in drop)
    zeros = not any(name in effects for name in SAME_AS_ZERO)
    base, basis = _explained(_key(rig), tuple(scenarios), seed, channels, zeros)
    difference = _whitened(true_rig(rig, effects, {}), scenarios, seed, channels, zeros) - base
    return float(np.linalg.norm(difference - basis @ (basis.T @ difference)))


def size_for(
    wanted: float,
    effects: Effects,
    seed: int,
    *,
    rig: Rig = RIG,
    scenarios: Sequence[str] = FIT_SCENARIOS,
    drop: Sequence[str] = (),
    tolerance: float = 0.05,
) -> dict[str, dict[str, float]]:
    """Return `effects` with their amplitudes times one factor, so that d is `wanted` within the tolerance (relative).

    The search brackets and halves on the logarithm of the factor. ValueError when no amplitude within the catalogue's
    ranges is that large, or d jumps over it.
    """
    low, high, factor = 0.0, math.inf, 1.0
    for search in range(MAX_SEARCHES):
        sized = scaled(effects, factor)
        size = effect_size(sized, seed, rig=rig, scenarios=scenarios, drop=drop)
        if abs(size - wanted) <= tolerance * wanted:
            return sized
        low, high = (factor, high) if size < wanted else (low, factor)
        factor *= min(max(wanted / size if size > 0.0 else 4.0, 0.01), 4.0)  # most effects are in proportion
        if search > 3 or not low < factor < high:
            factor = math.sqrt(max(low, 1.0e-2 * high) * high) if high < math.inf else 4.0 * low
    raise ValueError(f"no size of {', '.join(effects)} gives d = {wanted}; the last was {size:.3g}")


def scaled(effects: Effects, factor: float) -> dict[str, dict[str, float]]:
    """Return effects with amplitudes times a factor, within their ranges; a limit becomes lower by it."""
    result: dict[str, dict[str, float]] = {}
    for name, values in effects.items():
        result[name] = dict(values)
        for parameter in effect(name).parameters:
            if parameter.name not in values:
                continue
            value = values[parameter.name]
            if parameter.neutral is not None:
                value = parameter.neutral + factor * (value - parameter.neutral)
            elif name == "current_saturation":
                value = value / factor
            result[name][parameter.name] = min(max(value, parameter.minimum), parameter.maximum)
    return result


def _key(rig: Rig) -> str:
    return rig.model_dump_json(by_alias=True, exclude_unset=True)


@lru_cache(maxsize=8)
def _explained(
    rig_json: str, scenarios: tuple[str, ...], seed: int, channels: tuple[str, ...], zeros: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the runs as assumed, and an orthonormal basis of what changed parameters do to them."""
    rig = Rig.model_validate_json(rig_json)
    base = _whitened(rig, scenarios, seed, channels, zeros)
    columns = []
    for section in ("forceps", "motor"):
        for name in type(getattr(rig, section)).model_fields:
            key = f"{section}.{name}"
            changed = true_rig(rig, rig.effects, {key: 1.0 + STEPS.get(key, STEP)})
            columns.append(_whitened(changed, scenarios, seed, channels, zeros) - base)
    # Nothing moves, nothing shows: a parameter without any influence explains nothing.
    columns = [column / np.linalg.norm(column) for column in columns if np.linalg.norm(column) > 0.0]
    if not columns:
        return base, np.zeros((base.size, 0))
    basis, triangle = np.linalg.qr(np.stack(columns, axis=1))
    independent = np.abs(np.diag(triangle)) > 1.0e-6
    return base, np.ascontiguousarray(basis[:, independent])


def _whitened(
    rig: Rig, scenarios: Sequence[str], seed: int, channels: Sequence[str], zeros: bool
) -> NDArray[np.float64]:
    """Return all rows of all runs over the deviation of their sensors, without the mean of the jaw sensor."""
    grain = quantum_rad(rig) / math.sqrt(12.0)
    deviation = {
        "theta_m_rad": grain,
        "current_A": rig.noise.current_A,
        "theta_j_rad": rig.noise.theta_j_rad,
        "tau_w_N_m": rig.noise.tau_w_N_m,
    }
    parts = []
    for place, name in enumerate(scenarios):
        _, log = simulate(rig, SCENARIOS[name], run_seed(seed, place), ideal=True)
        for channel in channels:
            values = getattr(log, channel) / deviation[channel]
            parts.append(values - values.mean() if channel == "theta_j_rad" and zeros else values)
    return np.concatenate(parts)
