"""What estimators gain by knowing an effect: errors of τ̂_w and θ̂_j on runs of the generator, true numbers given.

`python -m tests.hidden_effects.estimates` writes the table into docs/estimators.md.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hil_forceps.data.run import Run
from hil_forceps.diagnosis.validation.estimates import estimate, measured
from hil_forceps.diagnosis.validation.rows import Rows
from hil_forceps.rig import Rig
from hil_forceps.rig.catalogue import EFFECT_IDS, effect
from tests.hidden_effects.generator import HELD_OUT_SCENARIOS, make_case
from tests.hidden_effects.generator_sizes import Effects, scaled

PAGE = Path(__file__).parents[2] / "docs" / "estimators.md"
MARKS = ("<!-- table of effects: begin -->\n", "<!-- table of effects: end -->\n")
ALGORITHMS = ("improved", "kalman")
FACTOR = 3.0  # on the typical size
SEED = 11
SETTLING_S = 0.15


class Errors(NamedTuple):
    """Root mean square errors over the rows that count."""

    tau_w_N_m: float
    theta_j_rad: float


class Row(NamedTuple):
    """An effect and the errors with it in the data, of an estimator blind to it and of one that knows it."""

    effect_id: str
    algorithm: str
    blind: Errors
    told: Errors


def sized(effect_id: str, factor: float = FACTOR) -> Effects:
    """Return an effect at `factor` times its typical size; of the skews that of the motor angle alone."""
    values = {item.name: item.typical for item in effect(effect_id).parameters}
    if effect_id == "channel_skew":
        values = {"theta_m_s": values["theta_m_s"]}
    return scaled({effect_id: values}, factor)


def rows_of(effects: Effects, seed: int = SEED) -> Iterator[tuple[str, Errors, Errors]]:
    """Yield algorithm and errors, blind and told, on the runs of the kinds that are held out."""
    case = make_case(effects, seed, scenarios=((), HELD_OUT_SCENARIOS))
    records = [compared_rows(run) for run in case.held_out]
    for algorithm in ALGORITHMS:
        yield algorithm, errors(records, case.assumed, algorithm), errors(records, case.true, algorithm)


def compared_rows(run: Run) -> Rows:
    """Return a run as estimates take it; the first rows, in which an estimator settles, don't count."""
    columns = dict(run.columns)
    time_s = columns.pop("time_s")
    reference, load = columns.pop("theta_m_ref_rad"), columns.pop("tau_w_N_m")
    weights = np.where(time_s - time_s[0] < SETTLING_S, 0.0, 1.0)
    return Rows(run.name, float(time_s[1] - time_s[0]), time_s - time_s[0], reference, columns, load, weights)


def errors(records: list[Rows], rig: Rig, algorithm: str) -> Errors:
    """Return the errors of an estimator with this rig on all runs together."""
    squares = np.zeros(2)
    count = 0.0
    for record in records:
        found, truth = estimate(record, rig, algorithm), measured(record)
        for place, name in enumerate(Errors._fields):
            squares[place] += float(record.weights @ (truth[name] - getattr(found, name)) ** 2)
        count += float(record.weights.sum())
    return Errors(*np.sqrt(squares / count).tolist())


def table(seed: int = SEED) -> list[Row]:
    """Return a row for each effect and algorithm; first without any effect."""
    rows = [Row("none", *each) for each in rows_of({}, seed)]
    for effect_id in EFFECT_IDS:
        rows += [Row(effect_id, *each) for each in rows_of(sized(effect_id), seed)]
    return rows


def lines(rows: list[Row]) -> str:
    """Return the table as Markdown: load in µN m, jaw in mrad."""
    head = "| effect | " + " | ".join(f"`{a}` τ̂_w, µN m | θ̂_j, mrad" for a in ALGORITHMS) + " |\n"
    text = head + "|---" * (1 + 2 * len(ALGORITHMS)) + "|\n"
    for effect_id in dict.fromkeys(row.effect_id for row in rows):
        cells = []
        for row in rows:
            if row.effect_id == effect_id:
                cells.append(f"{row.blind.tau_w_N_m * 1e6:.1f} → {row.told.tau_w_N_m * 1e6:.1f}")
                cells.append(f"{row.blind.theta_j_rad * 1e3:.2f} → {row.told.theta_j_rad * 1e3:.2f}")
        name = "none" if effect_id == "none" else f"`{effect_id}`"
        text += f"| {name} | " + " | ".join(cells) + " |\n"
    return text


def main() -> None:
    """Write the table into the page."""
    before, rest = PAGE.read_text(encoding="utf-8").split(MARKS[0])
    after = rest.split(MARKS[1])[1]
    PAGE.write_text(before + MARKS[0] + lines(table()) + MARKS[1] + after, encoding="utf-8")


if __name__ == "__main__":
    main()
