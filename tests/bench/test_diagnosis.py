"""How long a diagnosis takes: six runs of 12 s at 1 kHz, through `hf.diagnose` on two threads, reading left out.

Sets as the campaign of hidden effects draws them, with all six runs of 12 s. The least of two rounds counts; the first
compiles what isn't compiled yet.
"""

import resource
import statistics
import sys
import time
from dataclasses import replace

import pytest

import hil_forceps as hf
from tests.hidden_effects.drawn_cases import draw, make

MOTIONS = ("multisine", "trapezoid", "hold", "teleoperation", "grasp", "slow")  # 12 s each; the last two are held out
SETS = (
    ("none", 9700), ("none", 9701), ("none", 9702), ("none", 9703), ("shift", 9700), ("shift", 9702),
    ("effect", 9701), ("effect", 9702), ("pair", 9702), ("pair", 9703), ("triple", 9701), ("triple", 9702),
)  # fmt: skip
ROUNDS, THREADS = 2, 2
REQUIRED_MEDIAN_S, REQUIRED_WORST_S, REQUIRED_MB = 8.0, 30.0, 1000.0


def test_diagnosis_of_six_runs(capsys: pytest.CaptureFixture[str]) -> None:
    seconds: list[float] = []
    for kind, seed in SETS:
        case = make(replace(draw(kind, seed, usual=True), motions=MOTIONS, held_out=2))
        runs = [*case.fit, *case.held_out]
        taken = []
        for _ in range(ROUNDS):
            began = time.perf_counter()
            found = hf.diagnose(runs, case.assumed, hold_out=[run.name for run in case.held_out], jobs=THREADS)
            taken.append(time.perf_counter() - began)
        seconds.append(min(taken))
        named = " + ".join(effect.id for effect in found.causes) or found.verdict
        with capsys.disabled():
            sys.stdout.write(
                f"\n{kind} {seed}, {sum(len(run.columns['time_s']) for run in runs)} rows: {seconds[-1]:.1f} s, {named}"
            )
    peak_MB = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    with capsys.disabled():
        sys.stdout.write(
            f"\ndiagnosis of six runs of 12 s, {THREADS} threads: median {statistics.median(seconds):.1f} s, worst "
            f"{max(seconds):.1f} s, memory {peak_MB:.0f} MB (wanted: at most {REQUIRED_MEDIAN_S:.0f} s, "
            f"{REQUIRED_WORST_S:.0f} s, {REQUIRED_MB:.0f} MB)\n"
        )
