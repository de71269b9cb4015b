"""Counts of a campaign: the table of figures, misses by name, the confusion matrix.

python -m tests.hidden_effects.tally out/hidden-effects --markdown docs/diagnosis.md --figures docs/figures
"""

import argparse
import csv
import json
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from hil_forceps.rig.catalogue import EFFECT_IDS, effect
from tests.hidden_effects.confusion import confusion, draw
from tests.hidden_effects.tally_text import between_marks, table

Record = dict[str, Any]

CONFIDENCE = 0.95
REQUIRED_SIZE = 20.0
BOOTSTRAPS = 2000
SHOWN = (
    23.0  # of χ²: what `unnamed` asks of the best curve, 1.5 times chance; no data say more of a cause that fits less
)
FIGURE_TEXT = (
    "![Confusion matrix](figures/confusion.png)\n\n"
    "Hidden against said: shades are shares of a row, numbers are counts, as in `confusion.csv` beside the results."
)


def interval(hits: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share (Clopper, Pearson, Biometrika 26, 1934)."""
    tail = 0.5 * (1.0 - CONFIDENCE)
    low = 0.0 if hits == 0 else float(stats.beta.ppf(tail, hits, count - hits + 1))
    high = 1.0 if hits == count else float(stats.beta.isf(tail, hits + 1, count - hits))
    return low, high


def share(outcomes: Iterable[bool]) -> str:
    """Return "17/18 = 94 % [73, 100]"; "none run" without any."""
    told = list(outcomes)
    if not told:
        return "none run"
    hits, count = sum(told), len(told)
    low, high = interval(hits, count)
    return f"{hits}/{count} = {100 * hits / count:.1f} % [{100 * low:.1f}, {100 * high:.1f}]"


def named_right(record: Record) -> bool:
    """Whether the named effects are exactly the hidden ones."""
    return record.get("verdict") == "effects" and sorted(record["named"]) == sorted(record["truth"])


def in_set(record: Record) -> bool:
    """Whether effects were named and the hidden ones are among the sets that the data can't tell apart."""
    return record.get("verdict") == "effects" and sorted(record["truth"]) in [sorted(ids) for ids in record["sets"]]


def false_alarm(record: Record) -> bool:
    """Whether an effect was named, or something unnamed seen; a crash counts, too."""
    return record.get("verdict") not in {"consistent", "parameters"}


def ran(records: Iterable[Record], *kinds: str) -> list[Record]:
    """Return the records of these kinds whose wanted size could be made."""
    return [r for r in records if r["kind"] in kinds and "skipped" not in r]


def covered(records: Iterable[Record]) -> list[bool]:
    """Return for each parameter of each effect that was named rightly whether its interval holds the truth."""
    outcomes = []
    for record in records:
        if not named_right(record):
            continue
        for effect_id, found in record["parameters"].items():
            truth = record["hidden"][effect_id]
            for parameter in effect(effect_id).parameters:
                if parameter.name in found:
                    _, low, high = found[parameter.name]
                    true = truth.get(parameter.name, parameter.neutral)
                    outcomes.append(low <= true <= high)
    return outcomes


def covered_baseline(records: Iterable[Record]) -> list[bool]:
    """Return for each fitted known parameter of a case judged rightly whether its interval holds the truth."""
    outcomes = []
    for record in records:
        right = named_right(record) if record["truth"] else not false_alarm(record)
        if right:
            outcomes += [low <= true <= high for _, low, high, true in record["baseline"].values()]
    return outcomes


def explained(records: Iterable[Record], name: str = "whitened", *, possible: bool = False) -> list[bool]:
    """Return for each case named rightly whether the effect is explained on runs of other kinds.

    `name`: of what; `possible`: whether it would be with parameters as far off as the fit says that they are.
    """
    found = [r["explained"][name] for r in records if named_right(r) and r.get("explained")]
    return [shares[-1 if possible else 0] >= CONFIDENCE for shares in found]


def explained_together(records: Iterable[Record], *, possible: bool = False) -> str:
    """Return what is explained of all cases named rightly together, by noise, and the median case.

    With a 95 % interval by a bootstrap over the cases. `possible`: as above.
    """
    found = [r["explained"]["whitened"] for r in records if named_right(r) and r.get("explained")]
    if not found:
        return "none run"
    shares = np.array([shares[-1 if possible else 0] for shares in found])
    squares = np.array([shares[1] for shares in found]) ** 2

    def together(which: NDArray[np.intp]) -> float:
        return float(np.sum((shares * squares)[which]) / np.sum(squares[which]))

    rng = np.random.default_rng(0)
    drawn = [together(rng.integers(shares.size, size=shares.size)) for _ in range(BOOTSTRAPS)]
    low, high = 100.0 * np.quantile(drawn, (0.5 - 0.5 * CONFIDENCE, 0.5 + 0.5 * CONFIDENCE))
    whole = 100.0 * together(np.arange(shares.size))
    return f"{whole:.1f} % [{low:.1f}, {high:.1f}] of {shares.size}; median {100.0 * np.median(shares):.1f} %"


def told_apart(record: Record) -> bool:
    """Whether the whole catalogue names a deleted entry, and nothing else would do."""
    return [sorted(ids) for ids in record.get("whole", [])] == [sorted(record["truth"])]


def figures(records: Sequence[Record]) -> list[tuple[str, str, str]]:
    """Return the rows of the main table: quantity, required, reached."""
    far, records = of_large(records), [r for r in records if r["kind"] != "large"]
    single = ran(records, "effect")
    large = [r for r in single if r["size"] >= REQUIRED_SIZE]
    rows = [
        ("named first, or the truth in the set, d ≥ 20", "≥ 95 %", share(named_right(r) or in_set(r) for r in large)),
        ("named first alone, d ≥ 20", "", share(named_right(r) for r in large)),
    ]
    for size in sorted({r["size"] for r in single}):
        here = [r for r in single if r["size"] == size]
        rows.append((f"set holds the truth, d = {size:g}", "≥ 95 %", share(in_set(r) for r in here)))
        sizes = [len(r["sets"]) for r in here if r.get("verdict") == "effects"]
        mean = f"{sum(sizes) / len(sizes):.2f} of {len(sizes)}" if sizes else "none named"
        rows.append((f"mean size of the set, d = {size:g}", "≤ 1.5", mean))
    for kind, words in (("none", "no effect"), ("shift", "parameter shift only")):
        here = ran(records, kind)
        rows.append((f"false alarms, {words}", "≤ 2 %", share(map(false_alarm, here))))
        for noise in ("white", "coloured"):
            of_noise = [r for r in here if r["noise"] == noise]
            rows.append((f"of those in {noise} noise", "", share(map(false_alarm, of_noise))))
    none = ran(records, "none")
    rows.append(("a shift told where there is none", "", share(r.get("verdict") == "parameters" for r in none)))
    deleted = ran(records, "deleted")
    rows.append(("deleted entry: `unnamed`", "≥ 80 %", share(r.get("verdict") == "unnamed" for r in deleted)))
    alone = [r.get("verdict") == "unnamed" for r in deleted if told_apart(r)]
    rows.append(("of those that the whole catalogue tells from all others: `unnamed`", "≥ 80 %", share(alone)))
    shown = [r.get("verdict") == "unnamed" for r in deleted if r.get("worse", 0.0) > SHOWN]
    rows.append((f"of those that their own entry fits better by χ² > {SHOWN:g}: `unnamed`", "≥ 80 %", share(shown)))
    rows.append(("deleted entry: its neighbour named", "", share(r.get("verdict") == "effects" for r in deleted)))
    rows += [
        (words, required, share(map(named_right, ran(records, kind))))
        for kind, words, required in (
            ("pair", "two at once, both named, nothing else", "≥ 85 %"),
            ("triple", "three at once, all named, nothing else", ""),
            ("no_jaw", "no jaw sensor: named first", ""),
            ("other_controller", "another controller: named first", ""),
            ("fast_drive", "drive at 2 kHz: named first", ""),
        )
    ]
    pairs = ran(records, "pair")
    words = "two at once: both named, or one set of those that can't be told apart"
    rows.append((words, "≥ 85 %", share(named_right(r) or in_set(r) for r in pairs)))
    silent = ran(records, "uninformative")
    rows.append(
        ("uninformative runs: `undetermined`", "all", share(r.get("verdict") == "undetermined" for r in silent))
    )
    large = [r for r in records if r["size"] >= REQUIRED_SIZE]
    small = [r for r in records if 0.0 < r["size"] < REQUIRED_SIZE]
    for size, some, required in (("d ≥ 20", large, "≥ 95 %"), ("smaller", small, "")):
        words = f"{size}: explained share on held-out kinds of runs, all cases together, by noise"
        rows.append((words, required, explained_together(some)))
        rows.append(("the same, with errors as the fit tells them", "", explained_together(some, possible=True)))
        words = f"{size}: explained ≥ 95 % on held-out kinds of runs"
        rows.append((f"{words}, by noise", required, share(explained(some))))
        if size == "d ≥ 20":
            also = [r for r in some if r.get("explained") and r["explained"]["whitened"][1] >= REQUIRED_SIZE]
            rows.append(("of those that show there with d ≥ 20, too", required, share(explained(also))))
        rows.append((f"{words}, with errors as the fit tells them", "", share(explained(some, possible=True))))
        rows.append((f"{words}, motor's angle", "", share(explained(some, "theta_m_rad"))))
        rows.append((f"{words}, jaw's angle", "", share(explained(some, "theta_j_rad"))))
    rows += far
    rows.append(("effect's parameter within its 95 % interval", "90–99 %", share(covered(records))))
    rows.append(("known parameter within its 95 % interval", "90–99 %", share(covered_baseline(records))))
    rows.append(("crashes", "0", share("error" in r for r in records)))
    times = sorted(r["cpu_s"] for r in records if r.get("verdict") not in {None, "undetermined"})
    if times:
        middle, most = times[len(times) // 2], times[-1]
        words = "processor time, six runs of 12 s at 1 kHz, one thread"
        rows.append((words, "", f"median {middle} s, longest {most} s"))
    return rows


def of_large(records: Sequence[Record]) -> list[tuple[str, str, str]]:
    """Return the rows of effects that leave the noise far below."""
    far = ran(records, "large")
    rows = []
    for size in sorted({r["size"] for r in far}):
        here = [r for r in far if r["size"] == size]
        rows.append((f"set holds the truth, d = {size:g}", "≥ 95 %", share(in_set(r) for r in here)))
        wrong = share(r.get("verdict") == "effects" and not in_set(r) for r in here)
        rows.append((f"another cause named, d = {size:g}", "", wrong))
    return rows


def misses(records: Sequence[Record]) -> list[tuple[str, str, str]]:
    """Return every effect with its counts: by size the share named or in the set, and what was said instead."""
    rows = []
    for effect_id in EFFECT_IDS:
        here = [r for r in ran(records, "effect", "large") if r["truth"] == [effect_id]]
        skipped = sum(r["kind"] == "effect" and r["truth"] == [effect_id] and "skipped" in r for r in records)
        by_size = []
        for size in sorted({r["size"] for r in here}):
            told = [named_right(r) or in_set(r) for r in here if r["size"] == size]
            by_size.append(f"d{size:g}: {sum(told)}/{len(told)}")
        if skipped:
            by_size.append(f"out of reach: {skipped}")
        wrong = sorted(outcome(r) for r in here if not (named_right(r) or in_set(r)))
        said = ", ".join(f"{name} ×{wrong.count(name)}" for name in dict.fromkeys(wrong))
        rows.append((f"`{effect_id}`", ", ".join(by_size) or "none run", said))
    return rows


def outcome(record: Record) -> str:
    """Return what was said in a word: the names, or the verdict, or that it crashed."""
    if "error" in record:
        return "crash"
    return " + ".join(record["named"]) if record["verdict"] == "effects" else str(record["verdict"])


def read(folder: Path) -> list[Record]:
    """Return the records of a campaign."""
    return [json.loads(line) for line in (folder / "results.jsonl").read_text().splitlines()]


def markdown(records: Sequence[Record]) -> str:
    """Return all tables."""
    skipped = sum("skipped" in r for r in records)
    head = (
        f"{len(records) - skipped} cases; {skipped} more can't be made: a size out of the catalogue's ranges, or a "
        "gauge. Shares with 95 % intervals of Clopper and Pearson."
    )
    return "\n\n".join(
        (
            head,
            table(("quantity", "required", "reached"), figures(records)),
            "Single effects by name: named first or in the set, and what was said else.",
            table(("hidden", "found", "missed as"), misses(records)),
        )
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables, or write them into a document between its marks, with the confusion matrix."""
    parser = argparse.ArgumentParser(prog="python -m tests.hidden_effects.tally", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--markdown", type=Path)
    parser.add_argument("--figures", type=Path)
    options = parser.parse_args(arguments)
    records = read(options.folder)
    text = markdown(records)
    if options.figures:
        text += f"\n\n{FIGURE_TEXT}"
    if options.markdown:
        options.markdown.write_text(between_marks(options.markdown.read_text(), text))
    else:
        sys.stdout.write(text + "\n")
    rows, columns, counts = confusion(ran(records, "effect", "none", "shift"))
    with (options.folder / "confusion.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["hidden", *columns])
        writer.writerows([name, *line] for name, line in zip(rows, counts.tolist(), strict=True))
    if options.figures:
        options.figures.mkdir(parents=True, exist_ok=True)
        draw(rows, columns, counts, options.figures / "confusion.png")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
