"""One case of the campaign: makes its runs, diagnoses them, and keeps what is needed to judge the outcome."""

import time
import traceback
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.anew import quantum_of
from hil_forceps.diagnosis.conclude import silent
from hil_forceps.diagnosis.diagnose import Findings, Options, investigate
from hil_forceps.diagnosis.experiment import prepare
from hil_forceps.diagnosis.extension import Model
from hil_forceps.diagnosis.heldout import floors_of, gains, play
from hil_forceps.diagnosis.judge import TWO_SIDED_95, judge
from hil_forceps.model import parameters
from hil_forceps.rig import Rig
from tests.hidden_effects.cases import NOISES, REST, RIGS, SCENARIO_SETS, Spec, drawn_effect, drawn_shifts
from tests.hidden_effects.generator import Case, generate, make_case, run_seed
from tests.hidden_effects.generator_scenarios import SCENARIOS
from tests.hidden_effects.generator_sizes import size_for

Record = dict[str, Any]

NOISES_OF_SENSORS = ("current_A", "theta_j_rad", "tau_w_N_m")
FINE = 1 << 24  # counts a turn, as good as none
DRAWS = 4


def hidden(spec: Spec) -> dict[str, dict[str, float]]:
    """Return the effects of a case at their size; ValueError when the catalogue's ranges don't reach it."""
    fitted = SCENARIO_SETS[spec.scenarios if spec.scenarios in SCENARIO_SETS else "mixed"][0]
    drop = spec.drop if spec.kind == "no_jaw" else ()
    effects: dict[str, dict[str, float]] = {}
    for name in spec.effects:
        drawn = {name: drawn_effect(name, spec.seed)}
        effects |= size_for(spec.size, drawn, spec.seed, rig=RIGS[spec.rig], scenarios=fitted, drop=drop)
    return effects


def make(spec: Spec) -> Case:
    """Make the runs of a case."""
    return make_case(
        hidden(spec),
        spec.seed,
        scenarios=SCENARIO_SETS.get(spec.scenarios, REST),
        shifts=drawn_shifts(spec.seed) if spec.shifted else None,
        drop=spec.drop,
        noise=NOISES[spec.noise],
        rig=RIGS[spec.rig],
    )


def options_of(spec: Spec, case: Case) -> Options:
    """Return how a case is to be diagnosed."""
    return Options(
        without=frozenset(spec.effects) if spec.deleted else frozenset(),
        hold_out=tuple(run.name for run in case.held_out),
    )


def run_case(spec: Spec, *, gain: bool = False) -> Record:
    """Return what came out of a case, ready for JSON; `gain`: play held-out runs, too, where something was named.

    A size out of reach is told as `skipped`, a crash as `error`; neither raises, so that a campaign goes on.
    """
    record: Record = {"id": spec.id, "kind": spec.kind, "truth": list(spec.effects), "size": spec.size}
    record |= {"seed": spec.seed, "scenarios": spec.scenarios, "noise": spec.noise}
    try:
        case = make(spec)
    except ValueError as problem:
        return record | {"skipped": str(problem)}
    record["hidden"] = {name: dict(values) for name, values in case.true.effects.items()}
    began = time.perf_counter(), time.process_time()
    try:
        record |= _diagnosed(spec, case, gain=gain)
    except Exception as problem:  # whatever goes wrong is a result of the campaign
        where = traceback.extract_tb(problem.__traceback__)[-1]
        record["error"] = f"{type(problem).__name__}: {problem} ({where.name}, line {where.lineno})"
    record["wall_s"] = round(time.perf_counter() - began[0], 2)
    record["cpu_s"] = round(time.process_time() - began[1], 2)
    return record


def _diagnosed(spec: Spec, case: Case, *, gain: bool) -> Record:
    if reasons := silent(case.runs, case.assumed):
        return {"verdict": "undetermined", "named": [], "sets": [], "reasons": list(reasons)}
    options = options_of(spec, case)
    found = investigate(case.runs, case.assumed, options)
    verdict = judge(found)
    record: Record = {
        "verdict": verdict.verdict,
        "named": [named.id for named in verdict.effects],
        "sets": [list(ids) for ids in verdict.sets],
        "confidence": {named.id: round(named.confidence, 4) for named in verdict.effects},
        "parameters": {
            named.id: {name: [e.value, e.low, e.high] for name, e in named.parameters.items()}
            for named in verdict.effects
        },
        "shifts": sorted(verdict.shifts),
        "varies_over": list(verdict.varies_over),
        "left": [round(found.after.gain, 2), round(found.after.threshold, 2)],
        "scores": _scores(found, spec.effects),
        "baseline": _baseline(found.choice.model, case.true),
    }
    if gain and verdict.verdict == "effects":
        record["gain"] = held_out_gain(found, case.assumed, options)
        record["explained"] = explained(found, case, spec, options)
    if spec.deleted:  # whether the data tell the deleted entry from all others
        whole = judge(investigate(case.runs, case.assumed, replace(options, without=frozenset())))
        record["whole"] = [list(ids) for ids in whole.sets]
    return record


def _scores(found: Findings, truth: tuple[str, ...]) -> list[list[Any]]:
    """Return the best candidates of the first step, and those that are the truth: id, gain, threshold, state."""
    first = [c for c in found.choice.candidates if c.step == 0]
    first.sort(key=lambda c: -c.score)
    return [
        [c.id, round(c.score, 1), round(c.threshold, 1), c.state] for n, c in enumerate(first) if n < 4 or c.id in truth
    ]


def _baseline(model: Model, true: Rig) -> dict[str, list[float]]:
    """Return fitted known parameters: value, its 95 % interval, and the truth."""
    items = model.problem.shared.items
    values = model.problem.shared.values(model.fit.u[: len(items)])
    sd = np.sqrt(np.maximum(np.diag(model.fit.covariance)[: len(items)], 0.0))
    plant = true.plant()
    found = {}
    for item, value, deviation in zip(items, values, sd, strict=True):
        if not item.name.startswith("effects."):
            half = TWO_SIDED_95 * float(deviation) * item.scale
            truth = float(getattr(plant, item.name.partition(".")[2]))
            found[item.name] = [float(value), float(value) - half, float(value) + half, truth]
    return found


def explained(found: Findings, case: Case, spec: Spec, options: Options) -> dict[str, list[float]]:
    """Return the share of the baseline's error on held-out runs that the extended model takes away, by channel.

    On the same runs as ideal sensors would show them. Noise would be hundreds of times what an effect of d = 20 does,
    and rounding lets the jaw ring otherwise after a change of 1e-5 of any parameter. As share; rms before, after, and
    with the true parameters; the share of models whose parameters lie round the truth as the fit says that they do
    (of the truth where the extension has other effects).
    """
    ideal = {f"noise.{name}": 0.0 for name in NOISES_OF_SENSORS} | {"encoder.counts_per_rev": FINE}
    runs = []
    for record in found.held_out:
        place, _, name = record.name.partition("_")
        silent_rig = case.true.with_changes(ideal)
        runs.append(generate(silent_rig, SCENARIOS[name], run_seed(spec.seed, int(place)), name=record.name))
    records, _ = prepare(runs, case.assumed)
    extended, truth = found.choice.model, parameters.vector(case.true)
    thetas = [model.problem.theta(model.fit.u) for model in (found.baseline, extended)]
    right = set(extended.effects) == set(spec.effects)
    thetas += [truth, *(_round_truth(extended, truth, spec.seed) if right else [truth])]
    squares: dict[str, list[float]] = {}
    for theta in thetas:
        played = play(records, case.assumed, theta, 0.0, options.mapper)
        for channel in ("theta_m_rad", "theta_j_rad"):
            left = [
                (r.channels[channel] - p[channel]) * r.weights for r, p in zip(records, played.channels, strict=True)
            ]
            squares.setdefault(channel, []).append(float(np.mean([np.mean(values**2) for values in left])))
    return {
        channel: [
            (before - after) / max(before - least, 1e-300),
            *np.sqrt([before, after, least]).tolist(),
            (before - float(np.mean(drawn))) / max(before - least, 1e-300),
        ]
        for channel, (before, after, least, *drawn) in squares.items()
    }


def _round_truth(model: Model, truth: NDArray[np.float64], seed: int) -> list[NDArray[np.float64]]:
    """Return the truth with errors drawn as the model's fit has them, within the parameters' ranges."""
    rng = np.random.default_rng([seed, 0xD12A])
    items, found = model.problem.shared.items, model.fit
    at = [parameters.index(item.name) for item in items]
    scale, low, high = (np.array([getattr(item, key) for item in items]) for key in ("scale", "low", "high"))
    values, vectors = np.linalg.eigh(found.covariance[: len(items), : len(items)])
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    drawn = []
    for _ in range(DRAWS):
        theta = truth.copy()
        theta[at] = np.clip(theta[at] + scale * (root @ rng.standard_normal(len(items))), low, high)
        drawn.append(theta)
    return drawn


def held_out_gain(found: Findings, rig: Rig, options: Options) -> dict[str, list[float]]:
    """Return the explained share on held-out runs with its interval, channel by channel."""
    layout = found.choice.model.problem.layout
    floors = floors_of(found.choice.noise, layout, found.setting.simulator.integral_per_s)
    quantum = quantum_of(rig)
    models = (found.baseline, found.choice.model)
    before, after = (
        play(found.held_out, rig, model.problem.theta(model.fit.u), quantum, options.mapper) for model in models
    )
    shares = gains(found.held_out, before, after, floors, options.seed)
    return {
        name: [g.explained_share, g.low, g.high, g.baseline_rmse, g.extended_rmse, g.floor_rmse]
        for name, g in shares.items()
    }
