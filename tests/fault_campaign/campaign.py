"""`python -m tests.fault_campaign.campaign N`: N seeds, each one run of the service under its schedule of faults.

The same seeds give the same runs; every `AGAIN_EVERY`th is made twice, and both must give the same bytes. What fails is
shrunk and told with the command that makes it again:

    python -m tests.fault_campaign.campaign --replay SEED
    python -m tests.fault_campaign.campaign --schedule FILE     # as `--out` leaves it, or written by hand
"""

import argparse
import json
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, Final, NamedTuple

from tests.fault_campaign.invariants import findings
from tests.fault_campaign.rigs import PROFILES
from tests.fault_campaign.run import Record, run
from tests.fault_campaign.schedule import Kind, Schedule, draw, from_json
from tests.fault_campaign.shrink import shrink

AGAIN_EVERY: Final = 8
CHUNK: Final = 16  # seeds that a process takes at a time
TELL_EVERY: Final = 500


class Verdict(NamedTuple):
    """What came of a seed."""

    seed: int
    profile: str
    kinds: tuple[str, ...]
    end: str  # the reason, or what else ended it
    findings: tuple[str, ...]


def judge(schedule: Schedule, again: bool = False) -> Verdict:
    """Run a schedule and look at what happened; `again`: once more, for the same bytes."""
    record = run(schedule)
    found = findings(record)
    if again and run(schedule).digest() != record.digest():
        found.append("same bytes: the same schedule gave other ones")
    kinds = tuple(sorted({fault.kind.value for fault in schedule.faults}))
    return Verdict(schedule.seed, schedule.profile, kinds, _end_of(record), tuple(found))


def _end_of(record: Record) -> str:
    if record.was_killed:
        return "killed"
    return "crashed" if record.result is None else record.result.reason.value


def judge_seed(seed: int) -> Verdict:
    """Run the schedule of a seed."""
    return judge(draw(seed), again=seed % AGAIN_EVERY == 0)


def judge_seeds(seeds: Iterable[int], jobs: int) -> Iterator[Verdict]:
    """Run seeds in processes; verdicts come in the order of the seeds."""
    if jobs == 1:
        yield from map(judge_seed, seeds)
        return
    with ProcessPoolExecutor(jobs) as pool:
        yield from pool.map(judge_seed, seeds, chunksize=CHUNK)


def summary(verdicts: Sequence[Verdict]) -> dict[str, Any]:
    """Return the counts as JSON: how runs ended, and of each kind of fault how many runs of each profile had it."""
    of_kind = {kind.value: dict.fromkeys(PROFILES, 0) for kind in Kind}
    ends = {profile: Counter[str]() for profile in PROFILES}
    for verdict in verdicts:
        ends[verdict.profile][verdict.end] += 1
        for kind in verdict.kinds:
            of_kind[kind][verdict.profile] += 1
    return {
        "runs": len(verdicts),
        "seeds": [verdicts[0].seed, verdicts[-1].seed] if verdicts else [],
        "made_twice": sum(verdict.seed % AGAIN_EVERY == 0 for verdict in verdicts),
        "failed": [verdict.seed for verdict in verdicts if verdict.findings],
        "faults": of_kind,
        "ends": {profile: dict(sorted(counts.items())) for profile, counts in ends.items()},
    }


def table(counts: dict[str, Any]) -> str:
    """Return the summary as text: kinds and ends down, profiles across."""
    ends = sorted({end for each in counts["ends"].values() for end in each})
    rows = [("runs with", *PROFILES), *((kind, *each.values()) for kind, each in counts["faults"].items())]
    rows += [("ended as", *PROFILES)]
    rows += [(end, *(counts["ends"][profile].get(end, 0) for profile in PROFILES)) for end in ends]
    return "\n".join(f"{name:<18}" + "".join(f"{value!s:>11}" for value in values) for name, *values in rows)


def campaign(count: int, first: int, jobs: int, out: Path) -> int:
    """Run `count` seeds; write `summary.json` and what failed into `out`. Return how many failed."""
    verdicts: list[Verdict] = []
    out.mkdir(parents=True, exist_ok=True)
    for verdict in judge_seeds(range(first, first + count), jobs):
        verdicts.append(verdict)
        if verdict.findings:
            tell_failure(draw(verdict.seed), verdict.findings, out)
        if len(verdicts) % TELL_EVERY == 0:
            sys.stdout.write(f"{len(verdicts)} of {count}\n")
            sys.stdout.flush()
    counts = summary(verdicts)
    (out / "summary.json").write_text(json.dumps(counts, indent=2) + "\n", encoding="utf-8")
    failed = len(counts["failed"])
    sys.stdout.write(f"{table(counts)}\n{count} runs, {counts['made_twice']} of them twice: {failed} failed\n")
    return failed


def names_of(found: Iterable[str]) -> set[str]:
    """Return the invariants that findings are about."""
    return {text.partition(":")[0] for text in found}


def tell_failure(schedule: Schedule, found: Sequence[str], out: Path) -> None:
    """Shrink a schedule that failed; write it, and say what is wrong and how to see it again."""
    names = names_of(found)
    least = schedule
    if "same bytes" not in names:
        least = shrink(schedule, lambda candidate: bool(names & names_of(judge(candidate).findings)))
    path = out / f"seed-{schedule.seed}.json"
    path.write_text(least.to_json() + "\n", encoding="utf-8")
    lines = "".join(f"    {text}\n" for text in found)
    faults = "".join(f"    {fault}\n" for fault in least.faults)
    sys.stdout.write(
        f"seed {schedule.seed}, {schedule.profile}: FAILED\n{lines}  shrunk from {len(schedule.faults)} faults to\n"
        f"{faults}  again: python -m tests.fault_campaign.campaign --replay {schedule.seed}\n"
        f"  short: python -m tests.fault_campaign.campaign --schedule {path}\n"
    )
    sys.stdout.flush()


def replay(schedule: Schedule, out: Path) -> int:
    """Run one schedule and tell what came of it; 1 where it fails."""
    verdict = judge(schedule, again=True)
    sys.stdout.write(f"{schedule.to_json()}\nended: {verdict.end}\n")
    if not verdict.findings:
        sys.stdout.write("all invariants hold\n")
        return 0
    out.mkdir(parents=True, exist_ok=True)
    tell_failure(schedule, verdict.findings, out)
    return 1


def main(arguments: Sequence[str]) -> int:
    """Run a campaign or one schedule; 1 when anything failed."""
    parser = argparse.ArgumentParser(prog="python -m tests.fault_campaign.campaign")
    parser.add_argument("runs", type=int, nargs="?", default=1000)
    parser.add_argument("--seed", type=int, default=0, help="the first")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("out/fault-campaign"))
    parser.add_argument("--replay", type=int, metavar="SEED")
    parser.add_argument("--schedule", type=Path, metavar="FILE")
    chosen = parser.parse_args(arguments)
    if chosen.replay is not None:
        return replay(draw(chosen.replay), chosen.out)
    if chosen.schedule is not None:
        return replay(from_json(chosen.schedule.read_text(encoding="utf-8")), chosen.out)
    return 1 if campaign(chosen.runs, chosen.seed, chosen.jobs, chosen.out) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
