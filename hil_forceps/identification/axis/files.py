"""The comparison of an axis as tables and as files."""

import csv
import json
import math
from pathlib import Path

from hil_forceps.identification.axis.comparison import AxisComparison, RunEvidence
from hil_forceps.identification.axis.network_fit import NetworkFit
from hil_forceps.identification.axis.term_selection import Interval
from hil_forceps.identification.instrument.report import Table

WORDS = {
    "": "published: one friction",
    "asymmetric": "+ friction by direction",
    "dead_time": "+ dead time",
    "low_speed": "+ friction at low speed",
    "ripple": "+ ripple over the path",
    "position": "+ friction over the path",
}


def axis_tables(found: AxisComparison) -> list[tuple[str, Table]]:
    """Return title and cells: terms and force errors, numbers of the chosen model, and the open loop."""
    return [
        (f"Force error, terms chosen on {found.train.name} alone", _ladder(found)),
        (f"{WORDS[found.chosen.term]}: its numbers, 95 % intervals", _numbers(found)),
        ("Position, driven by the measured force alone, RMSE in mm", _open_loop(found)),
    ]


def _ladder(found: AxisComparison) -> Table:
    headers = ["model", "train (%)", "left out (%)", "gain (σ)", "stays"]
    for test in found.tests:
        headers += [f"{test.name} (%)", "95 %", "zero fitted (%)"]
    rows = []
    for rung in found.rungs:
        sigmas = f"{rung.gain_sigmas:.1f}" if math.isfinite(rung.gain_sigmas) else "-"
        row = [WORDS[rung.term], _percent(rung.error), _percent(rung.left_out_error), sigmas]
        row.append("yes" if rung.kept else "no")
        for error in found.errors:
            if error.term == rung.term:
                interval = f"{_percent(error.error.low)} … {_percent(error.error.high)}"
                row += [_percent(error.error.value), interval, _percent(error.with_zero)]
        rows.append(tuple(row))
    return Table(tuple(headers), tuple(rows))


def _numbers(found: AxisComparison) -> Table:
    rows = tuple(
        (name, _number(i.value), f"{_number(i.low)} … {_number(i.high)}") for name, i in found.intervals.items()
    )
    return Table(("number", "value", "95 %"), rows)


def _open_loop(found: AxisComparison) -> Table:
    headers = ("model", "fitted to", "train", "2nd half by 1st", *(test.name for test in found.tests))
    rows = [
        (WORDS[told.model], told.fitted_to, *(_mm(x) for x in (told.train_rmse_m, told.second_half_rmse_m)),
         *(_mm(x) for x in told.test_rmse_m))
        for told in found.open_loops
    ]  # fmt: skip
    for network in found.networks:
        end = network.told[-1]
        rows.append(
            (f"network, seed {network.seed}", "stretches", _mm(end.train_rmse_m), "", *map(_mm, end.test_rmse_m))
        )
    if found.networks:
        rows.append(("  while they were fitted, least to most", "", *_ranges(found)))
    driven = found.open_loop_chosen
    rows.append((f"chosen by train: {WORDS[driven.model]}", driven.fitted_to, "", "", *map(_mm, driven.test_rmse_m)))
    alone = [_mm(need.rmse_scale_only_m) for need in found.needed]
    rows.append(("  its friction scaled on the test run", "1 number", "", "", *alone))
    rows.append(("  and a constant force", "2 numbers", "", "", *(_mm(need.rmse_m) for need in found.needed)))
    return Table(headers, tuple(rows))


def _ranges(found: AxisComparison) -> list[str]:
    """Return from where to where errors went in the second half of all networks' fits."""
    late = [told for network in found.networks for told in network.told[len(network.told) // 2 :]]
    columns = list(zip(*((told.train_rmse_m, *told.test_rmse_m) for told in late), strict=True))
    train, *tests = (f"{_mm(min(column))} … {_mm(max(column))}" for column in columns)
    return [train, "", *tests]


def write_axis(found: AxisComparison, out: Path) -> tuple[Path, Path]:
    """Write `axis_comparison.json` (all but signals) and `axis_comparison.csv` (a line per model and run)."""
    out.mkdir(parents=True, exist_ok=True)
    summary, table = out / "axis_comparison.json", out / "axis_comparison.csv"
    text = json.dumps(_content(found), indent=1, ensure_ascii=False, allow_nan=False)
    summary.write_text(text + "\n", encoding="utf-8")
    with table.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("run", "model", "force_error", "low", "high", "force_error_zero_fitted"))
        for rung in found.rungs:
            writer.writerow((found.train.name, rung.term, rung.error, "", "", ""))
        for error in found.errors:
            writer.writerow((error.run, error.term, *error.error, "" if error.with_zero is None else error.with_zero))
    return summary, table


def _content(found: AxisComparison) -> dict[str, object]:
    return {
        "schema": 1,
        "train": found.train.name,
        "tests": [test.name for test in found.tests],
        "rungs": [
            {
                "term": rung.term,
                "kept": rung.kept,
                "train_error": rung.error,
                "left_out_error": rung.left_out_error,
                "gain_sigmas": _finite(rung.gain_sigmas),
                "shape": rung.fit.shape._asdict(),
                "coefficients": rung.fit.coefficients,
            }
            for rung in found.rungs
        ],
        "chosen": found.chosen.term,
        "intervals": {name: _interval(interval) for name, interval in found.intervals.items()},
        "force_errors": [error._asdict() | {"error": _interval(error.error)} for error in found.errors],
        "open_loop": [
            {key: value for key, value in told._asdict().items() if key != "fit"} for told in found.open_loops
        ],
        "open_loop_chosen": {"model": found.open_loop_chosen.model, "fitted_to": found.open_loop_chosen.fitted_to},
        "open_loop_of_inverse_model": [_interval(interval) for interval in found.open_loop_range_m],
        "networks": [_network(network) for network in found.networks],
        "needed_on_test": [need._asdict() for need in found.needed],
        "dead_time_profiles": {term: profile.tolist() for term, profile in found.profiles.items()},
        "runs": [_run(told) for told in found.evidence],
    }


def _network(network: NetworkFit) -> dict[str, object]:
    told = [
        {"steps": t.steps, "train_rmse_m": _finite(t.train_rmse_m), "test_rmse_m": [*map(_finite, t.test_rmse_m)]}
        for t in network.told
    ]
    return {"seed": network.seed, "told": told}


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _run(told: RunEvidence) -> dict[str, object]:
    return {
        "run": told.run,
        "ripple_period_m": told.ripple_period_m,
        "ripple_zero_m": told.ripple_zero_m,
        "acceleration_roll_off_decades": _finite(told.roll_off_decades),
        "bands": [band._asdict() for band in told.bands],
        "stiffness": told.stiffness._asdict() if told.stiffness else None,
        "strokes": [stroke._asdict() for stroke in told.strokes],
    }


def _interval(interval: Interval) -> dict[str, object]:
    return {"value": interval.value, "ci95": [interval.low, interval.high]}


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100.0 * share:.3f}"


def _mm(metres: float) -> str:
    return f"{1e3 * metres:.2f}" if math.isfinite(metres) else "not finite"


def _number(value: float) -> str:
    return f"{value:.4g}"
