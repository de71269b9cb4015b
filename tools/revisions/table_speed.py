"""Time of reading a CSV of 117 MB, here and in another tree of this project; each twice, in turn, a process each.

Usage: python tools/revisions/table_speed.py OTHER_TREE
"""

import csv
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ROWS = 1_100_000
COLUMNS = ("theta_m_ref_rad", "theta_m_rad", "current_A", "theta_j_rad", "tau_w_N_m")
READ = """
import hashlib, resource, sys, time
from hil_forceps.data.readers.csv_table import read_csv
begin = time.perf_counter()
run = read_csv(sys.argv[1])
seconds = time.perf_counter() - begin
digest = hashlib.sha256(b"".join(values.tobytes() for values in run.columns.values())).hexdigest()[:12]
print(f"{seconds:.2f} s, {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10} MiB, {digest}")
"""


def main(other: str) -> None:
    """Write the file, read it in both trees, print what it took."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "large.csv"
        generator = np.random.default_rng(0)
        table = np.column_stack([np.arange(ROWS) / 1e4, generator.normal(size=(ROWS, len(COLUMNS)))])
        with path.open("w", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(("time_s", *COLUMNS))
            writer.writerows(table.tolist())
        here = str(Path(__file__).resolve().parents[2])
        for tree in (other, here, other, here):
            told = subprocess.run(
                [sys.executable, "-c", READ, path], cwd=tree, capture_output=True, text=True, check=True
            )
            print(f"{tree}: {told.stdout.strip()}")


if __name__ == "__main__":
    main(sys.argv[1])
