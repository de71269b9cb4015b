"""The campaign over drawn cases: `python -m tests.hidden_effects.drawn_campaign --out DIR`; goes on where it stopped.

Each case is a line of JSON in `cases.jsonl`; `--counts` prints the table of counts with 95 % intervals from it, over
all levels of friction and over a tenth of the load and more.
"""

import argparse
import json
import resource
import sys
import time
import traceback
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from hil_forceps.diagnosis.identification import identify
from hil_forceps.diagnosis.identified import Identified
from hil_forceps.diagnosis.options import Options
from hil_forceps.diagnosis.result import TWO_SIDED_95
from hil_forceps.diagnosis.validation.verdict import judge
from hil_forceps.rig import Rig
from tests.hidden_effects.drawn_cases import KINDS, Drawn, draw, even_parts, make

Outcome = dict[str, Any]
SURE = 0.95  # a confidence from which on a cause counts as surely named
STICKING = 0.1  # share of the load's torque from which friction counts as much


def run_case(case: Drawn, *, usual: bool) -> Outcome:
    """Return what came out of a case, ready for JSON; a size out of reach and a crash are told, neither raises."""
    record: Outcome = {"usual": usual, **asdict(case)}
    try:
        made = make(case)
    except ValueError as problem:
        return record | {"skipped": str(problem)}
    began = time.perf_counter()
    try:
        without = frozenset(case.effects) if case.kind == "deleted" else frozenset()
        fitted, unseen = even_parts(made)
        found = identify(fitted, unseen, made.assumed, Options(without))
        record |= _told(found, made.assumed, made.true)
        if case.kind == "deleted":
            whole = judge(identify(fitted, unseen, made.assumed, Options()), made.assumed)
            record["only_candidate"] = whole.sets == (case.effects,)
    except Exception as problem:  # whatever goes wrong is a result of the campaign
        where = traceback.extract_tb(problem.__traceback__)[-1]
        record["error"] = f"{type(problem).__name__}: {problem} ({where.name}, line {where.lineno})"
    record["wall_s"] = round(time.perf_counter() - began, 2)
    record["peak_MB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    return record


def _told(found: Identified, assumed: Rig, true: Rig) -> Outcome:
    verdict = judge(found, assumed)
    plant = true.plant()
    inside = {}
    fitted = found.found.best.fit
    for free, value, deviation in zip(fitted.free, fitted.values, fitted.deviations, strict=True):
        if free.name.startswith("effects."):
            _, effect_id, key = free.name.split(".")
            if key not in true.effects.get(effect_id, {}):
                continue
            truth = true.effects[effect_id][key]
        else:
            truth = getattr(plant, free.name.partition(".")[2])
        inside[free.name] = bool(abs(value - truth) <= TWO_SIDED_95 * deviation)
    return {
        "verdict": verdict.verdict,
        "named": [effect.id for effect in verdict.effects],
        "confidence": [round(effect.confidence, 3) for effect in verdict.effects],
        "sets": [list(ids) for ids in verdict.sets],
        "inside": inside,
        "shows": {name: round(shows(found, name, values), 1) for name, values in true.effects.items()},
        "left": [round(found.after.gain, 1), round(found.after.threshold, 1)],
        "unseen": None if found.unseen is None else [round(found.unseen.gain, 1), round(found.unseen.threshold, 1)],
    }


def shows(found: Identified, effect_id: str, values: Mapping[str, float]) -> float:
    """Return d of an effect in the case's own runs: by the information that the filter has of its amplitudes there.

    0 for an effect without amplitudes of its own.
    """
    step = found.found.steps[0]
    places = [p for p in step.places if p.effect_id == effect_id and p.stop - p.first == len(p.amplitudes) > 0]
    if not places:
        return 0.0
    nearest = min(_log_distance(p.shape, values) for p in places)
    largest = 0.0
    for place in places:
        if _log_distance(place.shape, values) == nearest:
            sizes = np.array([values.get(name, 0.0) / unit for name, unit in place.amplitudes.items()])
            own = step.tested.information[place.first : place.stop, place.first : place.stop]
            largest = max(largest, float(np.sqrt(max(0.0, sizes @ own @ sizes))))
    return largest


def _log_distance(shape: Mapping[str, float], values: Mapping[str, float]) -> float:
    """Return the distance between a shape (a harmonic, a time constant) and that of an effect, in logarithms."""
    both = [(value, values.get(name, 0.0)) for name, value in shape.items()]
    return sum(abs(float(np.log(one / other))) for one, other in both if one > 0.0 and other > 0.0)


def counts(records: Iterable[Outcome]) -> list[str]:
    """Return the table of counts."""
    done = [r for r in records if "skipped" not in r]
    lines = ["| quantity | all | friction of 10 % and more |", "|---|---|---|"]

    def row(name: str, chosen: Sequence[Outcome], good: Sequence[bool]) -> None:
        hard = [g for r, g in zip(chosen, good, strict=True) if r["friction"] >= STICKING]
        lines.append(f"| {name} | {share(sum(good), len(good))} | {share(sum(hard), len(hard))} |")

    for kind in ("none", "shift"):
        here = [r for r in done if r["kind"] == kind]
        row(f"false alarms, {kind}", here, [r.get("verdict") not in {"consistent", "parameters"} for r in here])
    single = [r for r in done if r["kind"] == "effect"]
    for low, high, name in ((20.0, np.inf, "d ≥ 20"), (0.0, 20.0, "d = 8 and 12")):
        here = [r for r in single if low <= r["size"] < high]
        row(f"{name}: named first, or the truth in the set", here, [_found(r) for r in here])
    for low, name in ((20.0, "d ≥ 20"), (8.0, "d ≥ 8")):
        here = [r for r in single if _shows(r) >= low]
        row(f"{name} in the case's own runs: the same", here, [_found(r) for r in here])
    for kind in ("pair", "triple"):
        for low, name in ((0.0, kind), (8.0, f"{kind}, each d ≥ 8 in the case's own runs")):
            here = [r for r in done if r["kind"] == kind and _shows(r) >= low]
            row(f"{name}: all named and nothing else", here, [_all_named(r) for r in here])
            row(f"{name}: or the truth in the set", here, [_all_named(r) or _found(r) for r in here])
    here = [r for r in done if r["kind"] == "deleted"]
    row("deleted: unnamed", here, [r.get("verdict") == "unnamed" for r in here])
    here = [r for r in here if r.get("only_candidate")]
    row(
        "deleted, with the whole catalogue its only candidate: unnamed", here, [r["verdict"] == "unnamed" for r in here]
    )
    quiet = [r for r in done if r["kind"] in {"none", "shift"} and r.get("verdict") in {"consistent", "parameters"}]
    named = [
        (r, c, e in r["effects"])
        for r in done
        for e, c in zip(r.get("named", []), r.get("confidence", []), strict=True)
    ]
    sure = [(r, right) for r, confidence, right in named if confidence >= SURE and r["kind"] != "deleted"]
    row(f"named with confidence ≥ {SURE}: right", [r for r, _ in sure], [right for _, right in sure])
    pairs = [(r, inside) for r in quiet for inside in r["inside"].values()]
    row("known parameters within 95 %", [r for r, _ in pairs], [inside for _, inside in pairs])
    if walls := [r["wall_s"] for r in done if "wall_s" in r]:
        lines.append(f"| time of a set, one core | {np.median(walls):.0f} s, at most {max(walls):.0f} s | |")
        lines.append(f"| peak memory of a worker | {max(r['peak_MB'] for r in done if 'peak_MB' in r)} MB | |")
    return lines


def _found(record: Outcome) -> bool:
    truth = sorted(record["effects"])
    return record.get("verdict") == "effects" and any(sorted(ids) == truth for ids in record["sets"])


def _all_named(record: Outcome) -> bool:
    return sorted(record.get("named", [])) == sorted(record["effects"])


def _shows(record: Outcome) -> float:
    """Return d of the effect that shows least in the case's own runs; 0 where that isn't known."""
    return min(record.get("shows", {}).values(), default=0.0)


def share(good: int, count: int) -> str:
    """Return a count with its 95 % interval (Clopper and Pearson)."""
    if count == 0:
        return "–"
    low = float(stats.beta.ppf(0.025, good, count - good + 1)) if good else 0.0
    high = float(stats.beta.ppf(0.975, good + 1, count - good)) if good < count else 1.0
    return f"{good} of {count}: {100 * good / count:.1f} % [{100 * low:.1f}, {100 * high:.1f}]"


def _one(told: tuple[str, int, bool]) -> Outcome:
    kind, seed, usual = told
    return run_case(draw(kind, seed, usual=usual), usual=usual)


def main() -> None:
    """Run the cases that are missing, or print the counts of those that are there."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, nargs=2, default=(0, 100), metavar=("FIRST", "BEHIND"))
    parser.add_argument("--only", action="append", choices=KINDS)
    parser.add_argument("--usual", action="store_true", help="a drive of 1 ms, all sensors, white noise, six runs")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--counts", action="store_true")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    path = given.out / "cases.jsonl"
    there = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    if given.counts:
        sys.stdout.write("\n".join(counts(there)) + "\n")
        return
    known = {(r["kind"], r["seed"], r["usual"]) for r in there}
    wanted = [(kind, seed, given.usual) for seed in range(*given.seeds) for kind in given.only or KINDS]
    todo = [case for case in wanted if case not in known]
    with ProcessPoolExecutor(given.jobs) as pool, path.open("a") as file:
        for done in as_completed([pool.submit(_one, case) for case in todo]):
            record = done.result()
            file.write(json.dumps(record) + "\n")
            file.flush()
            sys.stdout.write(
                f"{record['kind']} {record['seed']}: {record.get('verdict', record.get('error', 'skipped'))}\n"
            )
            sys.stdout.flush()


if __name__ == "__main__":
    main()
