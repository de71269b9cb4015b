"""How much of hidden effects shows in a set of runs, and effects of a wanted size.

d is the norm of the whitened difference between runs without noise, with and without the effects, after what the
plant's own parameters and the zero of the jaw sensor can explain has been projected out. The noise is that of the
sensors and, of every simulation driven by the measured load, what the load cell's noise does through the closed loop:
below the loop's bandwidth that is many times the encoder's. Of the load its measurement and its spectrum are known.
"""

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hil_forceps.rig import Rig
from hil_forceps.rig.catalogue import effect
from tests.hidden_effects.generator import (
    CHANNELS,
    FIT_SCENARIOS,
    RIG,
    answer,
    quantum_rad,
    run_seed,
    simulate,
    true_rig,
)
from tests.hidden_effects.generator_scenarios import SCENARIOS
from virtual_bus.load import piecewise_linear

Effects = Mapping[str, Mapping[str, float]]
STEPS = {"forceps.motor_coulomb_N_m": 1.0, "forceps.jaw_coulomb_N_m": 1.0}  # relative; so small that 1 % is nothing
STEP = 0.01
SAME_AS_ZERO = ("wire_permanent_stretch",)  # nothing but a jaw sensor of known zero can show it
MAX_SEARCHES = 20
LOAD = "tau_w_N_m"
PULSE_N_M = 1.0e-3
HANN_POWER = 0.375
SMOOTHED_BINS = 25
UNKNOWN_LOAD_N_M = 1.0  # deviation of a load that was not measured: all that it could explain is lost


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
    difference = _whitened(true_rig(rig, effects, {}), scenarios, seed, channels, zeros, rig) - base
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
    base = _whitened(rig, scenarios, seed, channels, zeros, rig)
    columns = []
    for section in ("forceps", "motor"):
        for name in type(getattr(rig, section)).model_fields:
            key = f"{section}.{name}"
            changed = true_rig(rig, rig.effects, {key: 1.0 + STEPS.get(key, STEP)})
            columns.append(_whitened(changed, scenarios, seed, channels, zeros, rig) - base)
    # Nothing moves, nothing shows: a parameter without any influence explains nothing.
    columns = [column / np.linalg.norm(column) for column in columns if np.linalg.norm(column) > 0.0]
    if not columns:
        return base, np.zeros((base.size, 0))
    basis, triangle = np.linalg.qr(np.stack(columns, axis=1))
    independent = np.abs(np.diag(triangle)) > 1.0e-6
    return base, np.ascontiguousarray(basis[:, independent])


def _whitened(
    rig: Rig, scenarios: Sequence[str], seed: int, channels: Sequence[str], zeros: bool, assumed: Rig
) -> NDArray[np.float64]:
    """Return the spectra of all runs, made white, without the mean of the jaw sensor; linear in the runs."""
    outputs = tuple(channel for channel in channels if channel != LOAD)
    parts = []
    for place, name in enumerate(scenarios):
        scenario = SCENARIOS[name]
        _, log = simulate(rig, scenario, run_seed(seed, place), ideal=True)
        spectra = np.stack([np.fft.rfft(getattr(log, channel), norm="ortho") for channel in outputs], axis=1)
        response, root = _noise(_key(assumed), name, run_seed(seed, place), outputs, LOAD in channels)
        if LOAD in channels:  # the load as measured is what a simulation is driven by
            spectra = spectra - response * np.fft.rfft(log.tau_w_N_m, norm="ortho")[:, np.newaxis]
        if zeros and "theta_j_rad" in outputs:
            spectra[0, outputs.index("theta_j_rad")] = 0.0
        white = np.linalg.solve(root, spectra[:, :, np.newaxis])[:, :, 0] * math.sqrt(2.0)
        white[0] /= math.sqrt(2.0)
        parts += [white.real.ravel(), white.imag.ravel()]
    return np.concatenate(parts)


@lru_cache(maxsize=16)
def _noise(
    rig_json: str, name: str, seed: int, outputs: tuple[str, ...], load_known: bool
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Return what the load does to each channel, and the Cholesky root of the channels' noise, frequency by frequency.

    The noise is each sensor's own, and what is left of the load cell's after the best filter (Wiener's) for this load.
    """
    rig = Rig.model_validate_json(rig_json)
    _, log = simulate(rig, SCENARIOS[name], seed, ideal=True)
    response = load_response(rig, log.tau_w_N_m.size, SCENARIOS[name].row_s, outputs)
    load_sd = rig.noise.tau_w_N_m if load_known else UNKNOWN_LOAD_N_M
    left = np.full(response.shape[0], load_sd**2)
    if load_known:
        power = np.abs(np.fft.rfft(log.tau_w_N_m * np.hanning(log.tau_w_N_m.size), norm="ortho")) ** 2 / HANN_POWER
        power = np.convolve(power, np.full(SMOOTHED_BINS, 1.0 / SMOOTHED_BINS), mode="same")
        left = left * power / (power + left)
    deviation = {
        "theta_m_rad": quantum_rad(rig) / math.sqrt(12.0),
        "current_A": rig.noise.current_A,
        "theta_j_rad": rig.noise.theta_j_rad,
    }
    own = np.diag([deviation[channel] ** 2 for channel in outputs])
    load = response[:, :, np.newaxis] * response[:, np.newaxis].conj()
    root = np.linalg.cholesky(own + left[:, np.newaxis, np.newaxis] * load)
    return response, np.asarray(root, dtype=np.complex128)


def load_response(rig: Rig, rows: int, row_s: float, outputs: Sequence[str]) -> NDArray[np.complex128]:
    """Return what the load does to each channel, frequency by frequency, through the loop without friction."""
    still = true_rig(rig, {}, {"forceps.motor_coulomb_N_m": 0.0, "forceps.jaw_coulomb_N_m": 0.0})
    row = rows // 4
    pulse = piecewise_linear([(row - 1) * row_s, row * row_s, (row + 1) * row_s], [0.0, PULSE_N_M, 0.0])
    log = answer(still, pulse, rows, row_s)
    shift = np.exp(2.0j * math.pi * np.fft.rfftfreq(rows) * row)
    return np.stack([np.fft.rfft(getattr(log, channel)) * shift / PULSE_N_M for channel in outputs], axis=1)
