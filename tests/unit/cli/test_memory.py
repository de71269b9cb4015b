"""Freed memory stays with the process."""

import subprocess
import sys

import pytest

HELD = """
import numpy as np
from hil_forceps.cli.memory import keep_pages

if {kept}:
    keep_pages()

def resident_MB():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096 // 1_000_000

before = resident_MB()
large = np.ones(25_000_000)  # 200 MB
del large
print(resident_MB() - before)
"""


def _resident_after_freeing_MB(*, kept: bool) -> int:
    run = subprocess.run([sys.executable, "-c", HELD.format(kept=kept)], capture_output=True, text=True, check=True)
    return int(run.stdout)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="/proc and the C library of GNU")
def test_freed_memory_is_kept() -> None:
    assert _resident_after_freeing_MB(kept=False) < 50
    assert _resident_after_freeing_MB(kept=True) > 150
