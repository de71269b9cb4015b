"""Write three logs as somebody's bench might: German names, milliseconds, degrees, decimal commas, a preamble.

They are of a simulated forceps whose motor cogs, which the rig does not know.
"""

import sys
from pathlib import Path

import numpy as np

import hil_forceps as hf

RIG = "docs/examples/bench_rig.yaml"
COGGING = {"effects": {"cogging": {"sine_N_m": 2e-4, "cosine_N_m": 1e-4, "harmonic": 6.0}}}
PREAMBLE = "Pruefstand 3;;;;;\nDatum;27.11.2026;;;;\n;;;;;\n"
NAMES = "Zeit [ms];Sollwert [deg];Position [deg];Iq [mA];Klemme [deg];Last [mNm]\n"
COLUMNS = {  # of a run, and what one of its SI units is in the log's
    "time_s": 1e3,
    "theta_m_ref_rad": np.degrees(1.0),
    "theta_m_rad": np.degrees(1.0),
    "current_A": 1e3,
    "theta_j_rad": np.degrees(1.0),
    "tau_w_N_m": 1e3,
}


def trajectory(middle: float, size: float, rates_Hz: tuple[float, float], time_s: np.ndarray) -> hf.Trajectory:
    """Return two sines that begin and end at rest."""
    ease = np.minimum(1.0, np.minimum(time_s, time_s[-1] - time_s) / 0.5)
    swing = np.sin(2 * np.pi * rates_Hz[0] * time_s) + 0.5 * np.sin(2 * np.pi * rates_Hz[1] * time_s)
    return hf.Trajectory(tuple(time_s.tolist()), tuple((middle - size * ease * swing).tolist()))


folder = Path(sys.argv[1])
folder.mkdir(parents=True, exist_ok=True)
time_s = np.arange(0.0, 6.01, 0.01)
for day in (1, 2, 3):
    motion = trajectory(np.pi / 2, 0.4, (0.3 + 0.2 * day, 1.3 + 0.3 * day), time_s)
    load = trajectory(0.0, 1.5e-3, (0.2 * day, 0.9), time_s)
    with hf.virtual_bench(hf.load_rig(RIG).with_changes(COGGING), load_N_m=load, seed=day) as bench:
        run = bench.run(motion).recorded
    assert run is not None
    rows = np.column_stack([factor * run[name] for name, factor in COLUMNS.items()])
    lines = (";".join(f"{value:.6f}" for value in row).replace(".", ",") for row in rows.tolist())
    path = folder / f"messung{day}.csv"
    path.write_text(PREAMBLE + NAMES + "\n".join(lines) + "\n", encoding="utf-8")
    print(f"{path}: {len(rows)} rows")
