"""What a tick of virtual time over the bus asks of the interpreter: calls and bytecodes, which no other load changes.

The difference between two runs of different length, so that what comes once (opening, compiling, closing) cancels.
"""

import cProfile
import pstats
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from hil_forceps.bench.execute import execute
from hil_forceps.bench.matrix import RunSpec
from hil_forceps.rig import Rig, load_rig

CONFIGS = Path(__file__).parents[2] / "configs"
SHORT_S, LONG_S = 0.2, 0.6


def calls(work: Callable[[], object]) -> int:
    """Return the calls of functions, of Python and of C."""
    profile = cProfile.Profile()
    profile.runcall(work)
    counted = pstats.Stats(profile)
    return sum(row[0] for row in counted.stats.values())  # type: ignore[attr-defined]


def bytecodes(work: Callable[[], object]) -> int:
    """Return the bytecodes that are executed."""
    count = 0

    def within(_frame: FrameType, event: str, _argument: Any) -> Any:
        nonlocal count
        count += event == "opcode"
        return within

    def entered(frame: FrameType, _event: str, _argument: Any) -> Any:
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        return within

    before = sys.gettrace()
    sys.settrace(entered)
    try:
        work()
    finally:
        sys.settrace(before)
    return count


@pytest.mark.parametrize("config", ["paper", "realistic"])
def test_calls_and_bytecodes_of_a_tick(tmp_path: Path, capsys: pytest.CaptureFixture[str], config: str) -> None:
    rig: Rig = load_rig(CONFIGS / f"{config}.yaml")

    def run(duration_s: float) -> Callable[[], object]:
        spec = RunSpec(2, "kalman", True, rig.bench.host_period_s, True, duration_s)
        return lambda: execute(spec, rig, 0, tmp_path)

    run(SHORT_S)()
    ticks = round((LONG_S - SHORT_S) / rig.bench.host_period_s)
    found = [(counted(run(LONG_S)) - counted(run(SHORT_S))) / ticks for counted in (calls, bytecodes)]
    assert min(found) > 0.0
    with capsys.disabled():
        sys.stdout.write(f"\na tick over the bus, {config}, kalman: {found[0]:.0f} calls, {found[1]:.0f} bytecodes\n")
