"""How long many logs take: N of 12 s are simulated and tracked; dry friction rises from the middle on.

    python -m tests.bench.trend_logs 1000 --out out/trend-logs

Logs that are there already are taken as they are. Said are wall time and processor time, of all processes.
"""

import argparse
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

from tests.trend.simulated_sessions import file_name, write_sessions

RISE = 0.3 / 50.0  # of dry friction, by session


def processor_s() -> float:
    """Return the processor time of all processes that were waited for."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    """Make the logs, track them, and tell what it took."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", type=int)
    parser.add_argument("--out", type=Path, default=Path("out/trend-logs"))
    parser.add_argument("--seconds", type=float, default=12.0)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    told = parser.parse_args()
    logs = told.out / "logs"
    there = sum((logs / f"{file_name(number)}.parquet").is_file() for number in range(told.count))
    for path in sorted(logs.glob("*.parquet"))[told.count :]:  # of an earlier, longer call
        path.unlink()
    write_sessions(logs, told.count, told.seconds, onset=told.count // 2, rise_a_session=RISE, first=there)
    began_s = time.perf_counter()
    command = [sys.executable, "-m", "hil_forceps.cli.main", "trend", str(logs), "--out", str(told.out / "result")]
    command += ["--jobs", str(told.jobs)]
    subprocess.run(command, check=True)
    wall_s, cpu_s = time.perf_counter() - began_s, processor_s()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)  # all is done already
    again_s = processor_s() - cpu_s
    sys.stdout.write(
        f"{told.count} logs of {told.seconds:g} s in {wall_s:.1f} s with {told.jobs} processes: "
        f"{cpu_s:.1f} s of processor time, {cpu_s / told.count:.2f} s a log; "
        f"where all is done already {again_s:.1f} s\n"
    )


if __name__ == "__main__":
    main()
