"""How long a drive's motor is led on behind the last fresh reference: measured, beside the published time.

    python -m tests.fault_campaign.torque_free --out out/torque-free

At a time drawn from a seed, while references leave, the host's process is killed, or in every other run it hears
nothing any more and goes on as it does then. From the last fresh reference that reached the drive's watchdog until
nothing leads its motor any more. Every protocol that there is but Dynamixel's, whose torque stays on; in virtual time.
"""

import argparse
import json
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from pathlib import Path
from random import Random
from typing import Final

import matplotlib.pyplot as plt

from hil_forceps.drives.registry import torque_free_within_s
from tests.fault_campaign.invariants.times import newest
from tests.fault_campaign.rigs import PROFILES, rig_of
from tests.fault_campaign.run import run
from tests.fault_campaign.schedule import FOREVER_NS, Fault, Kind, Schedule

RUNS: Final = 200  # of each protocol
LET_GO: Final = tuple(profile for profile in PROFILES if profile != "dynamixel")
SETTLED_NS: Final = 10_000_000  # behind the first reference, and before the last
BINS: Final = 120


def published_ms(profile: str) -> float:
    """Return the time within which it has to be over."""
    within_s = torque_free_within_s(rig_of(profile))
    assert within_s is not None
    return 1e3 * within_s


@cache
def references_leave(profile: str) -> tuple[int, int]:
    """Return from when to when they do in a run without a fault [ns]."""
    sent = [each.bus_ns for each in run(Schedule(0, profile, ())).bus.sent if each.is_fresh]
    return sent[0] + SETTLED_NS, sent[-1] - SETTLED_NS


def measured_ms(profile: str, seed: int) -> float:
    """Return the time of one run."""
    begin_ns = round(Random(f"torque free {profile} {seed}").uniform(*references_leave(profile)))
    deaf = Fault(Kind.DROP, begin_ns, FOREVER_NS, 1.0, "to_host")
    record = run(Schedule(0, profile, (deaf if seed % 2 else Fault(Kind.KILLED, begin_ns),)))
    moments, fed = record.drives[0].forceps.moments, record.drives[0].fed
    led = [moment.reference_rad is not None for moment in moments]
    end_ns = moments[len(led) - led[::-1].index(True)].at_ns
    return 1e-6 * (end_ns - newest(fed, end_ns))


def draw(times_ms: dict[str, Sequence[float]], path: Path) -> None:
    """Draw the histograms, each with its published time."""
    size = (7.0, 0.7 * len(times_ms) + 0.8)
    figure, panels = plt.subplots(len(times_ms), 1, figsize=size, layout="constrained", sharex=True)
    longest = max(published_ms(profile) for profile in times_ms)
    for panel, (profile, values) in zip(panels, times_ms.items(), strict=True):
        panel.hist(values, bins=BINS, range=(0.0, 1.05 * longest), color="tab:blue")
        panel.axvline(published_ms(profile), color="tab:red", linewidth=1.0)
        panel.set_ylabel(profile, rotation=0, ha="right", va="center")
        panel.set_yticks([])
    panels[0].set_title("from the last fresh reference until the motor is let go; red: published", fontsize=9)
    panels[-1].set_xlabel("ms")
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main() -> None:
    """Measure, print a table, leave JSON and figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=RUNS)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    times: dict[str, Sequence[float]] = {}
    with ProcessPoolExecutor(given.jobs) as pool:
        for profile in LET_GO:
            times[profile] = sorted(pool.map(partial(measured_ms, profile), range(given.runs)))
            of = times[profile]
            sys.stdout.write(
                f"{profile:12} least {of[0]:6.1f}  median {of[len(of) // 2]:6.1f}  most {of[-1]:6.1f}  "
                f"published {published_ms(profile):6.1f} ms\n"
            )
            sys.stdout.flush()
    (given.out / "torque_free.json").write_text(json.dumps(times) + "\n", encoding="utf-8")
    draw(times, given.out / "torque_free.png")


if __name__ == "__main__":
    main()
