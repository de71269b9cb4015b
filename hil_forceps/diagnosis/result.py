"""What a diagnosis found, as plain data: `to_json` gives `diagnosis.json`, the evidence is for whoever draws it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hil_forceps.audit.finding import Finding
from hil_forceps.rig.catalogue import Location

Vector = NDArray[np.float64]
Verdict = Literal["consistent", "parameters", "effects", "unnamed", "undetermined"]
SCHEMA = 1
TWO_SIDED_95 = 1.959964  # deviations, of every `ci95`


@dataclass(frozen=True, slots=True)
class Estimate:
    """A fitted number with its 95 % interval."""

    value: float
    low: float
    high: float
    unit: str = ""


@dataclass(frozen=True, slots=True)
class NamedEffect:
    """An effect that was named."""

    id: str
    location: Location
    confidence: float  # 0..1
    parameters: Mapping[str, Estimate]


@dataclass(frozen=True, slots=True)
class Shift:
    """A known parameter that turned out to be another number; `assumed` None: it was unknown."""

    assumed: float | None
    fitted: Estimate


@dataclass(frozen=True, slots=True)
class Gain:
    """What extending the model gains in one channel (or in an estimate, e.g. `tau_w_estimate_N_m`), held-out runs."""

    baseline_rmse: float
    extended_rmse: float
    floor_rmse: float
    explained_share: float  # (E0 − E1)/(E0 − floor) of squared errors
    low: float  # 95 % interval of the share, by bootstrap over blocks
    high: float


@dataclass(frozen=True, slots=True)
class Detectable:
    """The smallest size of an effect that these data would show (80 % power)."""

    parameter: str
    value: float
    unit: str


@dataclass(frozen=True, slots=True)
class NextExperiment:
    """The experiment that would best separate what is still tied."""

    name: str
    separates: tuple[tuple[str, ...], ...]
    predicted_separation: float  # effect size d between the tied models, in standard deviations
    why: str = ""


@dataclass(frozen=True, slots=True)
class Candidate:
    """An entry of the catalogue as it was judged in one step of the choice."""

    id: str
    step: int  # 0: beside the refitted baseline, 1: beside the first named effect, ...
    score: float  # fall of the misfit, χ², when it joins the model
    threshold: float  # what is asked: what chance gives in `FALSE_ALARMS` of data sets, more beside an effect
    state: Literal["named", "tied", "weaker", "below threshold", "at a bound", "not excited"]


@dataclass(frozen=True, slots=True)
class Rung:
    """A step of the ladder: an entry that joined, and the errors that were left then."""

    id: str  # "": the known parameters alone
    rmse: Mapping[str, float]  # of each channel, on runs never used where there are any
    gain: Mapping[str, float]  # of this step: share of the squared error that the known parameters leave above noise
    parameters: Mapping[str, Estimate]  # of the entry, in the model with all of them


@dataclass(frozen=True, slots=True)
class Balance:
    """What curves find left at one balance (motor, wire, jaw, sensor, timing), before and after."""

    location: Location
    channel: str
    before: float  # root of the fall of χ² by the best family of curves there, over what chance gives
    after: float


@dataclass(frozen=True, slots=True)
class Trend:
    """What smooth curves over one variable explain of a residual, over what they would of noise; before and after."""

    channel: str  # or the place of a balance
    variable: str  # "theta", "omega", "tension", "time", "time_since_reversal", "load", "acceleration"
    before: float
    after: float


@dataclass(frozen=True, slots=True, eq=False)
class RunEvidence:
    """One run for the figures: rows over time; keys are column names."""

    name: str
    held_out: bool
    time_s: Vector
    measured: Mapping[str, Vector]
    baseline: Mapping[str, Vector]  # simulated with the refitted parameters
    extended: Mapping[str, Vector]  # the same with the named effects; equal to baseline when none is named
    nominal: Mapping[str, Vector]  # the rig as given
    variables: Mapping[str, Vector]  # "theta", "omega", "tension", "time_since_reversal", "load", ...
    estimates: Mapping[str, Vector]  # "tau_w_before_N_m", "tau_w_after_N_m", "theta_j_before_rad", ... where estimated


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """Everything that came out."""

    verdict: Verdict
    sentence: str  # the verdict for a reader
    effects: tuple[NamedEffect, ...] = ()
    candidate_sets: tuple[tuple[str, ...], ...] = ()
    parameter_shifts: Mapping[str, Shift] = field(default_factory=dict)
    gain: Mapping[str, Gain] = field(default_factory=dict)
    held_out: tuple[str, ...] = ()
    data_audit: tuple[Finding, ...] = ()
    minimum_detectable: Mapping[str, Detectable] = field(default_factory=dict)
    next_experiment: NextExperiment | None = None
    varies_over: tuple[str, ...] = ()  # of what no entry explains
    reasons: tuple[str, ...] = ()  # why undetermined, what can't be told apart and why
    candidates: tuple[Candidate, ...] = ()
    balances: tuple[Balance, ...] = ()
    trends: tuple[Trend, ...] = ()
    noise_sd: Mapping[str, float] = field(default_factory=dict)  # floor of each channel
    runs: tuple[RunEvidence, ...] = ()
    ladder: tuple[Rung, ...] = ()  # where the drive's law isn't known


def to_json(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the content of `diagnosis.json`, schema 1; numbers that aren't finite become None."""
    data: dict[str, Any] = {
        "schema": SCHEMA,
        "verdict": diagnosis.verdict,
        "sentence": diagnosis.sentence,
        "effects": [_effect(effect) for effect in diagnosis.effects],
        "candidate_sets": [list(ids) for ids in diagnosis.candidate_sets],
        "parameter_shifts": {name: _shift(shift) for name, shift in diagnosis.parameter_shifts.items()},
        "gain": {name: _gain(gain) for name, gain in diagnosis.gain.items()},
        "held_out": list(diagnosis.held_out),
        "data_audit": [_fields(finding) for finding in diagnosis.data_audit],
        "minimum_detectable": {name: _fields(least) for name, least in diagnosis.minimum_detectable.items()},
        "next_experiment": None if diagnosis.next_experiment is None else _fields(diagnosis.next_experiment),
        "varies_over": list(diagnosis.varies_over),
        "reasons": list(diagnosis.reasons),
        "candidates": [_fields(candidate) for candidate in diagnosis.candidates],
        "balances": [_fields(balance) for balance in diagnosis.balances],
        "trends": [_fields(trend) for trend in diagnosis.trends],
        "ladder": [_rung(rung) for rung in diagnosis.ladder],
        "noise_sd": {name: plain(sd) for name, sd in diagnosis.noise_sd.items()},
    }
    return data


def _effect(effect: NamedEffect) -> dict[str, Any]:
    return {
        "id": effect.id,
        "confidence": plain(effect.confidence),
        "location": effect.location,
        "parameters": _estimates(effect.parameters),
    }


def _rung(rung: Rung) -> dict[str, Any]:
    return {
        "id": rung.id,
        "rmse": {name: plain(error) for name, error in rung.rmse.items()},
        "gain": {name: plain(gain) for name, gain in rung.gain.items()},
        "parameters": _estimates(rung.parameters),
    }


def _estimates(parameters: Mapping[str, Estimate]) -> dict[str, Any]:
    return {name: {"value": plain(p.value), "unit": p.unit, "ci95": _interval(p)} for name, p in parameters.items()}


def _shift(shift: Shift) -> dict[str, Any]:
    return {
        "assumed": plain(shift.assumed),
        "fitted": plain(shift.fitted.value),
        "unit": shift.fitted.unit,
        "ci95": _interval(shift.fitted),
    }


def _gain(gain: Gain) -> dict[str, Any]:
    return {
        "baseline_rmse": plain(gain.baseline_rmse),
        "extended_rmse": plain(gain.extended_rmse),
        "floor_rmse": plain(gain.floor_rmse),
        "explained_share": plain(gain.explained_share),
        "ci95": [plain(gain.low), plain(gain.high)],
    }


def _interval(estimate: Estimate) -> list[float | None]:
    return [plain(estimate.low), plain(estimate.high)]


def plain(value: float | None) -> float | None:
    """Return a number as JSON can have it: None where it isn't finite."""
    return float(value) if value is not None and math.isfinite(value) else None


def _fields(item: object) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name in item.__slots__:  # type: ignore[attr-defined]  # frozen slotted dataclasses of numbers and text only
        value = getattr(item, name)
        if isinstance(value, float):
            value = plain(value)
        elif isinstance(value, tuple):
            value = [list(part) if isinstance(part, tuple) else part for part in value]
        found[name] = value
    return found
