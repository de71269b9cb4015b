"""The comparison on held-out runs as a table and as files."""

import csv
import json
import math
from pathlib import Path

from hil_forceps.estimation import transmission
from hil_forceps.runs.instrument_comparison import PUBLISHED_PROTOCOL, Comparison, HeldOut
from hil_forceps.runs.instrument_report import (
    CLOSING,
    PUBLISHED_THETA_J_RMSE_RAD,
    WHOLE,
    PUBLISHED_TAU_W_RMSE_N_m,
    Table,
)
from hil_forceps.runs.transmission_fit import TransmissionFit

PUBLISHED = PUBLISHED_TAU_W_RMSE_N_m, PUBLISHED_THETA_J_RMSE_RAD


def comparison_tables(comparison: Comparison) -> list[tuple[str, Table]]:
    """Per split a table of errors, each source's best whole-motion torque first; the published figures end the last."""
    headers = ("driven by", "method", "whole: τ_w (mN m)", "θ_j (deg)", "closing: τ_w (mN m)", "θ_j (deg)")
    tables = []
    for split in dict.fromkeys(score.split for score in comparison.overall):
        pairs: dict[tuple[str, str], dict[str, HeldOut]] = {}
        for score in comparison.overall:
            if score.split == split:
                pairs.setdefault((score.source, score.method), {})[score.part] = score
        ordered = sorted(pairs.items(), key=lambda pair: (pair[0][0] != "tau_m_N_m", _rank(pair[1])))
        rows = [(*key, *_cells(parts.get(WHOLE)), *_cells(parts.get(CLOSING))) for key, parts in ordered]
        if split == PUBLISHED_PROTOCOL:
            rows.append(("motor side", "published network", "-", "-", *_numbers(*PUBLISHED)))
        tables.append((split, Table(headers, tuple(rows))))
    return tables


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
        "residuals": [residual._asdict() for residual in comparison.residuals],
        "published": {"tau_w_rmse_N_m": PUBLISHED_TAU_W_RMSE_N_m, "theta_j_rmse_rad": PUBLISHED_THETA_J_RMSE_RAD},
    }
    summary.write_text(json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")
    with runs.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(HeldOut._fields)
        writer.writerows(comparison.per_run)
    return summary, runs


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
