"""One case of the campaign: makes its runs, diagnoses them, and keeps what is needed to judge the outcome."""

import time
import traceback
from dataclasses import replace
from typing import Any

import numpy as np

from hil_forceps.diagnosis.anew import quantum_of
from hil_forceps.diagnosis.conclude import silent
from hil_forceps.diagnosis.diagnose import Findings, Options, investigate
from hil_forceps.diagnosis.extension import Model
from hil_forceps.diagnosis.fit import sum_of_squares
from hil_forceps.diagnosis.validation.heldout import floors_of, gains, play
from hil_forceps.diagnosis.judge import burst_beside, judge
from hil_forceps.diagnosis.lack_of_fit.curves import Leftover
from hil_forceps.diagnosis.result import TWO_SIDED_95
from hil_forceps.rig import Rig
from tests.hidden_effects.cases import NOISES, REST, RIGS, SCENARIO_SETS, Spec, drawn_effect, drawn_shifts
from tests.hidden_effects.explained import explained
from tests.hidden_effects.generator import Case, make_case
from tests.hidden_effects.generator_sizes import size_for

Outcome = dict[str, Any]

GAUGES = frozenset({"encoder_scale"})


def hidden(spec: Spec) -> dict[str, dict[str, float]]:
    """Return the effects of a case at their size; ValueError when the catalogue's ranges don't reach it."""
    fitted = SCENARIO_SETS[spec.scenarios if spec.scenarios in SCENARIO_SETS else "mixed"][0]
    drop = spec.drop if spec.kind == "no_jaw" else ()
    effects: dict[str, dict[str, float]] = {}
    if gauges := GAUGES & set(spec.effects):
        raise ValueError(f"{min(gauges)}: other values of the rig give the same runs")
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


def run_case(spec: Spec, *, gain: bool = False, whole: bool = True) -> Outcome:
    """Return what came out of a case, ready for JSON.

    `gain`: play held-out runs, too, where something was named. `whole`: diagnose runs of a deleted entry once more with
    it, to tell whether the data tell it from all others.

    A size out of reach is told as `skipped`, a crash as `error`; neither raises, so that a campaign goes on.
    """
    record: Outcome = {"id": spec.id, "kind": spec.kind, "truth": list(spec.effects), "size": spec.size}
    record |= {"seed": spec.seed, "scenarios": spec.scenarios, "noise": spec.noise}
    try:
        case = make(spec)
    except ValueError as problem:
        return record | {"skipped": str(problem)}
    record["hidden"] = {name: dict(values) for name, values in case.true.effects.items()}
    began = time.perf_counter(), time.process_time()
    try:
        record |= _diagnosed(spec, case, gain=gain, whole=whole)
    except Exception as problem:  # whatever goes wrong is a result of the campaign
        where = traceback.extract_tb(problem.__traceback__)[-1]
        record["error"] = f"{type(problem).__name__}: {problem} ({where.name}, line {where.lineno})"
    record["wall_s"] = round(time.perf_counter() - began[0], 2)
    record["cpu_s"] = round(time.process_time() - began[1], 2)
    return record


def _diagnosed(spec: Spec, case: Case, *, gain: bool, whole: bool) -> Outcome:
    if reasons := silent(case.runs, case.assumed):
        return {"verdict": "undetermined", "named": [], "sets": [], "reasons": list(reasons)}
    options = options_of(spec, case)
    found = investigate(case.runs, case.assumed, options)
    verdict = judge(found)
    record: Outcome = {
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
        "rivals": [[list(rival.model.effects), round(rival.behind, 2)] for rival in found.choice.rivals],
        "left": _left(found.after),
        "burst": None if (burst := burst_beside(found.choice)) is None else round(burst.gain, 1),
        "left_unseen": None if found.unseen is None else _left(found.unseen),
        "scores": _scores(found, spec.effects),
        "baseline": _baseline(found.choice.model, case.true),
    }
    if gain and verdict.verdict == "effects":
        record["gain"] = held_out_gain(found, case.assumed, options)
        record["explained"] = explained(found, case, spec, SCENARIO_SETS.get(spec.scenarios, REST)[1])
    if spec.deleted and whole:
        with_it = investigate(case.runs, case.assumed, replace(options, without=frozenset()))
        record["whole"] = [list(ids) for ids in judge(with_it).sets]
        record["worse"] = round(_worse(found, with_it), 1)
    return record


def _worse(found: Findings, whole: Findings) -> float:
    """Return how much χ² is above that of another choice in the fitted runs, both by the other's noise."""
    whitener = whole.choice.whitener
    there, here = (sum_of_squares(whitener.apply(f.choice.model.fit.residual)) for f in (whole, found))
    return here - there


def _left(left: Leftover) -> list[float]:
    """Return what curves find, and what they find by chance."""
    return [round(left.gain, 2), round(left.threshold, 2)]


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
