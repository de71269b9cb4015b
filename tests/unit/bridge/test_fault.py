"""What a fault's line says beside its message: each number once."""

import math

import pytest

from hil_forceps.bridge.fault import compared


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("no_drive", "time to connect", 2.0, 2.0, "s"), "time to connect: 2 s, limit 2 s"),
        (("drive_lost", "time since the last sample", 101.0, 100.0, "ms"), "limit 100 ms"),
        (("reference_denied", "references denied in a row (STALE)", 5.0, 4.0, ""), "limit 4"),
        (("feedback_implausible", "encoder_jump", 1.15, 0.352, "rad"), ""),
        (("gate_latched", "tension", 4.0, 3.0, "N"), ""),
        (("drive_fault", "drive fault", math.nan, math.nan, ""), ""),
    ],
)
def test_no_number_is_said_twice(arguments: tuple[str, str, float, float, str], said: str) -> None:
    assert compared(*arguments) == said
