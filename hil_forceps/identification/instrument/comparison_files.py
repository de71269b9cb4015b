"""The comparison on held-out runs as a table and as files."""

import csv
import json
import math
from collections.abc import Sequence
from pathlib import Path

from hil_forceps.estimation import transmission
from hil_forceps.identification.instrument.comparison import PUBLISHED_PROTOCOL, Comparison
from hil_forceps.identification.instrument.held_out_errors import HeldOut
from hil_forceps.identification.instrument.report import (
    CLOSING,
    PUBLISHED_THETA_J_RMSE_RAD,
    WHOLE,
    PUBLISHED_TAU_W_RMSE_N_m,
    Table,
)
from hil_forceps.identification.instrument.series_zeros import SeriesZeros
from hil_forceps.identification.instrument.transmission_fit import TransmissionFit

HEADERS = ("driven by", "method", "whole: τ_w (mN m)", "θ_j (deg)", "closing: τ_w (mN m)", "θ_j (deg)")
PUBLISHED = PUBLISHED_TAU_W_RMSE_N_m, PUBLISHED_THETA_J_RMSE_RAD


def comparison_tables(comparison: Comparison) -> list[tuple[str, Table]]:
    """Per split a table of errors, each source's best whole-motion torque first; the published figures end the last.

    Behind each split's table one with the zero of each series by its training runs, and how probable such zeros are.
    """
    tables = []
    for split in dict.fromkeys(score.split for score in comparison.overall):
        rows = _rows([score for score in comparison.overall if score.split == split])
        if split == PUBLISHED_PROTOCOL:
            rows.append(("motor side", "published network", "-", "-", *_numbers(*PUBLISHED)))
        tables.append((split, Table(HEADERS, tuple(rows))))
        if shifted := [score for score in comparison.by_series if score.split == split]:
            tables.append(
                (f"{split}, zero of each series{_chances(comparison, split)}", Table(HEADERS, (*_rows(shifted),)))
            )
    return tables


def _rows(scores: Sequence[HeldOut]) -> list[tuple[str, ...]]:
    pairs: dict[tuple[str, str], dict[str, HeldOut]] = {}
    for score in scores:
        pairs.setdefault((score.source, score.method), {})[score.part] = score
    ordered = sorted(pairs.items(), key=lambda pair: (pair[0][0] != "tau_m_N_m", _rank(pair[1])))
    return [(*key, *_cells(parts.get(WHOLE)), *_cells(parts.get(CLOSING))) for key, parts in ordered]


def _chances(comparison: Comparison, split: str) -> str:
    """Say how probable it is that series differ by chance alone, as the transmission estimator shows it."""
    said = []
    for name, zeros in comparison.zeros.items():
        own, source, part = name.split("/")
        if own == split and part == WHOLE and not math.isnan(zeros.theta_j_chance):
            said.append(f"{source}: τ_w {zeros.tau_w_chance:.2g}, θ_j {zeros.theta_j_chance:.2g}")
    return f" (by chance: {'; '.join(said)})" if said else ""


def _rank(parts: dict[str, HeldOut]) -> float:
    return (parts.get(WHOLE) or parts[CLOSING]).tau_w_rmse_N_m


def write_comparison(comparison: Comparison, out: Path) -> tuple[Path, Path]:
    """Write `instrument_comparison.json` (all) and `.csv` (a line per split, run, source, method, part)."""
    out.mkdir(parents=True, exist_ok=True)
    summary, runs = out / "instrument_comparison.json", out / "instrument_comparison.csv"
    content = {
        "schema": 1,
        "splits": [split._asdict() for split in comparison.splits],
        "fits": {name: _fit(fit) for name, fit in comparison.fits.items()},
        "overall": [score._asdict() for score in comparison.overall],
        "overall_zero_of_each_series": [score._asdict() for score in comparison.by_series],
        "series_zeros": {name: _zeros(zeros) for name, zeros in comparison.zeros.items()},
        "residuals": [residual._asdict() for residual in comparison.residuals],
        "published": {"tau_w_rmse_N_m": PUBLISHED_TAU_W_RMSE_N_m, "theta_j_rmse_rad": PUBLISHED_THETA_J_RMSE_RAD},
    }
    summary.write_text(json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")
    with runs.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(HeldOut._fields)
        writer.writerows(comparison.per_run)
    return summary, runs


def _zeros(zeros: SeriesZeros) -> dict[str, object]:
    return {
        "tau_w_N_m": {str(series): zero for series, zero in zeros.tau_w_N_m.items()},
        "theta_j_rad": {str(series): zero for series, zero in zeros.theta_j_rad.items()},
        "tau_w_chance": None if math.isnan(zeros.tau_w_chance) else zeros.tau_w_chance,
        "theta_j_chance": None if math.isnan(zeros.theta_j_chance) else zeros.theta_j_chance,
    }


def _fit(fit: TransmissionFit) -> dict[str, object]:
    return {
        "driven_by": fit.source,
        "low_pass_Hz": fit.structure.corner_rad_per_s / (2.0 * math.pi),
        "presliding_rad": fit.structure.presliding_rad,
        "range_rad": fit.structure.range_rad,
        "standstill": fit.structure.standstill,
        "terms": transmission.term_names(),
        "tau_w_coefficients": fit.torque.tolist(),
        "theta_j_coefficients": fit.angle.tolist(),
        "left_out_tau_w_rmse_N_m": fit.left_out_tau_w_rmse_N_m,
        "left_out_theta_j_rmse_rad": fit.left_out_theta_j_rmse_rad,
    }


def _cells(score: HeldOut | None) -> tuple[str, str]:
    return ("-", "-") if score is None else _numbers(score.tau_w_rmse_N_m, score.theta_j_rmse_rad)


def _numbers(tau_w_N_m: float, theta_j_rad: float) -> tuple[str, str]:
    return f"{tau_w_N_m * 1e3:.2f}", f"{math.degrees(theta_j_rad):.3f}"
