"""What is larger than any hardware has it only acts like its entry: the name is told with little confidence."""

import pytest

from hil_forceps.diagnosis.result import Estimate
from hil_forceps.diagnosis.validation.verdict import plausibility
from hil_forceps.rig.catalogue import EFFECTS


def estimates(**values: float) -> dict[str, Estimate]:
    return {name: Estimate(value, value, value, "") for name, value in values.items()}


@pytest.mark.parametrize(
    ("effect_id", "values", "expected"),
    [
        ("pulley_eccentricity", {"sine": 0.02, "cosine": -0.08}, 1.0),
        ("pulley_eccentricity", {"sine": 0.02, "cosine": -0.2}, 0.25),
        ("pulley_eccentricity", {"sine": 0.5, "cosine": 0.0}, 0.04),
        ("wire_creep", {"share": 0.88, "time_constant_s": 0.087}, (0.35 / 0.88) ** 2),
        ("loaded_presliding", {"mu": 0.35, "angle_rad": 0.04}, 1.0),
        ("wire_slack", {"half_width_m": 1.0}, 1.0),  # lengths have the size of their machine
    ],
)
def test_a_size_beyond_what_hardware_has_takes_confidence(
    effect_id: str, values: dict[str, float], expected: float
) -> None:
    assert plausibility(effect_id, estimates(**values)) == pytest.approx(expected)


def test_usual_sizes_are_plausible() -> None:
    for entry in EFFECTS:
        usual = {p.name: Estimate(p.typical, p.typical, p.typical, p.unit) for p in entry.parameters}
        assert plausibility(entry.id, usual) == 1.0, entry.id
        assert all(p.plausible <= max(abs(p.minimum), abs(p.maximum)) or p.plausible > 1e300 for p in entry.parameters)
