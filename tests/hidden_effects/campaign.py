"""`make hidden-effects`: hides effects in data, has them diagnosed, writes one line of JSON per case.

python -m tests.hidden_effects.campaign --out out/hidden-effects [--jobs 2] [--only KIND] [--first ROUND]
    [--rounds ROUND] [--budget MINUTES] [--resume]
"""

import argparse
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from pathlib import Path
from typing import Any

from hil_forceps.cli.memory import keep_pages
from tests.hidden_effects.cases import PER_ROUND, ROUNDS, Spec, specs
from tests.hidden_effects.trial import run_case

GAIN_EVERY = 3  # held-out runs are played for one case in so many: they cost as much as the diagnosis


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is asked for; returns 0 also when the budget cut it short."""
    options = _parser().parse_args(arguments)
    wanted = chosen(specs(options.rounds, options.first), options.only, options.case)
    if not wanted:
        sys.stderr.write("no such case\n")
        return 2
    options.out.mkdir(parents=True, exist_ok=True)
    results = options.out / "results.jsonl"
    done = finished(results) if options.resume else set()
    if not options.resume:
        results.write_text("")
    tasks = [(spec, number % GAIN_EVERY == 0) for number, spec in enumerate(wanted) if spec.id not in done]
    sys.stderr.write(f"{len(wanted)} cases, {len(wanted) - len(tasks)} of them done before\n")
    run(tasks, results, options.jobs, options.budget * 60.0)
    return 0


def chosen(cases: Sequence[Spec], kinds: Sequence[str], ids: Sequence[str]) -> list[Spec]:
    """Return the cases of some kinds, or with some ids; all when neither is given."""
    return [spec for spec in cases if (not kinds or spec.kind in kinds) and (not ids or spec.id in ids)]


def finished(results: Path) -> set[str]:
    """Return ids of the cases in a file of results; a last line that was cut off is taken out of the file."""
    if not results.exists():
        return set()
    lines = results.read_text().splitlines(keepends=True)
    whole = [line for line in lines if line.endswith("\n")]
    if len(whole) < len(lines):
        results.write_text("".join(whole))
    return {json.loads(line)["id"] for line in whole}


def run(tasks: Sequence[tuple[Spec, bool]], results: Path, jobs: int, budget_s: float) -> None:
    """Run cases in processes of one thread each and append their records; none is begun once the budget is spent."""
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")  # read by the processes when they start
    began = time.monotonic()
    waiting = list(reversed(tasks))
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context, initializer=keep_pages) as pool, results.open("a") as file:
        running: set[Future[dict[str, Any]]] = set()
        count = 0
        while waiting or running:
            while waiting and len(running) < jobs and time.monotonic() - began < budget_s:
                spec, gain = waiting.pop()
                running.add(pool.submit(run_case, spec, gain=gain))
            if not running:
                break
            ready, running = wait(running, return_when=FIRST_COMPLETED)
            for future in ready:
                record = future.result()
                file.write(json.dumps(record) + "\n")
                file.flush()
                count += 1
                _tell(record, count, len(tasks), time.monotonic() - began)
    if waiting:
        sys.stderr.write(f"the budget is spent; {len(waiting)} cases were not run (--resume goes on)\n")


def _tell(record: dict[str, Any], count: int, total: int, elapsed_s: float) -> None:
    left_min = elapsed_s / count * (total - count) / 60.0
    outcome = record.get("error") or record.get("skipped") or record["verdict"]
    named = " + ".join(record.get("named", []))
    sys.stderr.write(f"{count}/{total}, {left_min:.0f} min left: {record['id']}: {outcome} {named}\n")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.hidden_effects.campaign", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/hidden-effects"))
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", action="append", default=[], choices=list(PER_ROUND), metavar="KIND")
    parser.add_argument("--case", action="append", default=[], metavar="ID", help="one case, to look into it")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--first", type=int, default=0, metavar="ROUND", help="the first of them, for fresh seeds")
    parser.add_argument("--budget", type=float, default=1e9, metavar="MINUTES")
    parser.add_argument("--resume", action="store_true", help="keep the results that are there")
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
