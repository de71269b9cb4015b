"""How much of hidden effects shows in a set of runs, and effects of a wanted size.

d is the norm of the whitened difference between runs without noise, with and without the effects, after the plant's own
parameters have been refitted and the zero of the jaw sensor projected out. The noise is that of the
sensors and, of every simulation driven by the measured load, what the load cell's noise does through the closed loop:
below the loop's bandwidth that is many times the encoder's. Of the load its measurement and its spectrum are known.

The encoder's rounding shakes the motor, which works dry friction loose: an effect of friction that would show in an
ideal loop, where the motor sticks, needn't show in data. So both runs are shaken alike, by the rounding as it was in
the run without the effects.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal.windows import tukey

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
from tests.hidden_effects.generator_scenarios import NO_ENVIRONMENT, SCENARIOS, course_of
from virtual_bus.logs import Log
from virtual_bus.plant.load import LoadProfile, piecewise_linear

Effects = Mapping[str, Mapping[str, float]]
FRICTION = ("forceps.motor_coulomb_N_m", "forceps.jaw_coulomb_N_m")
HELD = "forceps.motor_pulley_radius_m"  # both radii times s and the stiffness over s² give the same runs
STEP = 0.01  # of a parameter's logarithm
MAX_LOG, MAX_LOG_FRICTION = 0.3, 3.0  # of a parameter, in one step of a refit
MAX_REFITS = 6
NEAR = 0.02
SAME_AS_ZERO = ("wire_permanent_stretch",)  # nothing but a jaw sensor of known zero can show it
ZERO_SD_RAD = 2.0e-3  # how well that is known, from run to run
MAX_SEARCHES = 20
LOAD = "tau_w_N_m"
PULSE_N_M = 1.0e-3
TAPER = 0.05  # of a run, both ends together
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
    base, explained = _explained(_key(rig), tuple(scenarios), seed, channels, zeros)

    def runs(changed: Rig) -> NDArray[np.float64]:
        return _whitened(changed, scenarios, seed, channels, zeros, rig)

    return _refitted(runs, runs(true_rig(rig, effects, {})), base, explained, rig)


def _refitted(
    runs: Callable[[Rig], NDArray[np.float64]],
    wanted: NDArray[np.float64],
    base: NDArray[np.float64],
    explained: Mapping[str, NDArray[np.float64]],
    rig: Rig,
) -> float:
    """Return the norm of what refitted parameters leave of a difference; they are followed as far as they go.

    Dry friction bends the runs: what it explains is taken anew wherever it comes to.
    """
    logs = dict.fromkeys(explained, 0.0)
    columns = dict(explained)
    left, now = wanted - base, base
    norm = float(np.linalg.norm(left))
    for refit in range(MAX_REFITS):
        basis = np.stack(list(columns.values()), axis=1) if columns else np.zeros((base.size, 0))
        step = np.linalg.lstsq(basis / STEP, left, rcond=1.0e-10)[0]
        expected = float(np.linalg.norm(left - basis @ step / STEP))
        tried = {
            key: value + float(np.clip(d, -MAX_LOG, MAX_LOG))
            for (key, value), d in zip(logs.items(), step, strict=True)
        }
        after = runs(true_rig(rig, rig.effects, _factors(tried)))
        new = float(np.linalg.norm(wanted - after))
        if new >= norm:
            return expected if refit == 0 else norm
        done = abs(new - expected) < NEAR * new or new > (1.0 - NEAR) * norm
        logs, left, now, norm = tried, wanted - after, after, new
        if done:
            break
        for key in FRICTION:
            if key in columns:
                columns[key] = runs(true_rig(rig, rig.effects, _factors(logs | {key: logs[key] + STEP}))) - now
    return norm


def _factors(logs: Mapping[str, float]) -> dict[str, float]:
    return {key: math.exp(value) for key, value in logs.items()}


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
) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
    """Return the runs as assumed, and what each parameter does to them when its logarithm grows by `STEP`."""
    rig = Rig.model_validate_json(rig_json)
    base = _whitened(rig, scenarios, seed, channels, zeros, rig)
    columns = {}
    for section in ("forceps", "motor"):
        for name in type(getattr(rig, section)).model_fields:
            key = f"{section}.{name}"
            if key == HELD:
                continue
            changed = true_rig(rig, rig.effects, {key: math.exp(STEP)})
            column = _whitened(changed, scenarios, seed, channels, zeros, rig) - base
            # Nothing moves, nothing shows: a parameter without any influence explains nothing.
            if np.linalg.norm(column) > 0.0:
                columns[key] = column
    return base, columns


class Shown(NamedTuple):
    """What a rig's runs show without noise."""

    whitened: NDArray[np.float64]  # all channels, weighed by the noise that their sensors and the load cell have
    theta_m_rad: NDArray[np.float64]
    theta_j_rad: NDArray[np.float64]


def shown(rig: Rig, scenarios: Sequence[str], seed: int, *, assumed: Rig, drop: Sequence[str] = ()) -> Shown:
    """Return what runs of a rig show, shaken by the encoder's rounding as it is in the runs of the rig as assumed.

    Left to itself, rounding shakes each run otherwise after a change of 1e-5 of any parameter: as much as an effect of
    d = 20 does to the jaw.
    """
    channels = tuple(channel for channel in CHANNELS if channel not in drop)
    logs = [_shaken(rig, name, run_seed(seed, place), _key(assumed)) for place, name in enumerate(scenarios)]
    return Shown(
        _whitened(rig, scenarios, seed, channels, zeros=True, assumed=assumed),
        np.concatenate([log.theta_m_rad for log in logs]),
        np.concatenate([log.theta_j_rad for log in logs]),
    )


def _shaken(rig: Rig, name: str, seed: int, key: str) -> Log:
    """Return a run under the load that the rig as assumed meets: what is touched answers to an effect, too.

    That answer is measured and drives every simulation, so it is no part of what shows of the effect.
    """
    _, log = simulate(
        rig, SCENARIOS[name], seed, ideal=True, rounding_rad=_rounding(key, name, seed), load=_load(key, name, seed)
    )
    return log


@lru_cache(maxsize=16)
def _ideal(rig_json: str, name: str, seed: int) -> Log:
    """Return the run without effects and without counting."""
    _, log = simulate(Rig.model_validate_json(rig_json), SCENARIOS[name], seed, ideal=True)
    return log


@lru_cache(maxsize=16)
def _load(rig_json: str, name: str, seed: int) -> LoadProfile | None:
    """Return the load of the run without effects where the jaw touches something; None where it doesn't."""
    if course_of(SCENARIOS[name], seed).environment == NO_ENVIRONMENT:
        return None
    log = _ideal(rig_json, name, seed)
    return piecewise_linear((SCENARIOS[name].row_s * np.arange(log.tau_w_N_m.size)).tolist(), log.tau_w_N_m.tolist())


def _whitened(
    rig: Rig, scenarios: Sequence[str], seed: int, channels: Sequence[str], zeros: bool, assumed: Rig
) -> NDArray[np.float64]:
    """Return the spectra of all runs, made white, without the mean of the jaw sensor; linear in the runs.

    The runs are faded in and out: a step where the transform closes them to a ring shows at high frequencies, where
    the noise is low.
    """
    outputs = tuple(channel for channel in channels if channel != LOAD)
    parts = []
    for place, name in enumerate(scenarios):
        key, own_seed = _key(assumed), run_seed(seed, place)
        log = _shaken(rig, name, own_seed, key)
        rows = log.theta_m_rad.size
        window = tukey(rows, TAPER)
        window /= math.sqrt(float(np.mean(window**2)))
        signals = {channel: getattr(log, channel) for channel in outputs}
        if "theta_j_rad" in signals:
            mean = float(np.average(signals["theta_j_rad"], weights=window**2))
            spread = math.sqrt(rows) * ZERO_SD_RAD / assumed.noise.theta_j_rad
            kept = 0.0 if zeros else 1.0 / math.hypot(1.0, spread)
            signals["theta_j_rad"] = signals["theta_j_rad"] - (1.0 - kept) * mean
        spectra = np.stack([np.fft.rfft(window * signals[channel], norm="ortho") for channel in outputs], axis=1)
        response, root = _noise(key, name, own_seed, outputs, LOAD in channels)
        if LOAD in channels:  # the load as measured is what a simulation is driven by
            spectra = spectra - response * np.fft.rfft(window * log.tau_w_N_m, norm="ortho")[:, np.newaxis]
        white = np.linalg.solve(root, spectra[:, :, np.newaxis])[:, :, 0] * math.sqrt(2.0)
        white[0] /= math.sqrt(2.0)
        parts += [white.real.ravel(), white.imag.ravel()]
    return np.concatenate(parts)


@lru_cache(maxsize=16)
def _rounding(rig_json: str, name: str, seed: int) -> NDArray[np.float64]:
    """Return what counting adds to the encoder's angle in the run without effects."""
    _, log = simulate(Rig.model_validate_json(rig_json), SCENARIOS[name], seed)
    return log.rounding_rad


@lru_cache(maxsize=16)
def _noise(
    rig_json: str, name: str, seed: int, outputs: tuple[str, ...], load_known: bool
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Return what the load does to each channel, and the Cholesky root of the channels' noise, frequency by frequency.

    The noise is each sensor's own, and what is left of the load cell's after the best filter (Wiener's) for this load.
    """
    rig = Rig.model_validate_json(rig_json)
    log = _ideal(rig_json, name, seed)
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
