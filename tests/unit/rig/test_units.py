"""Units in key names."""

import math

import pytest

from hil_forceps.rig import units


@pytest.mark.parametrize(
    ("given", "wanted", "factor"),
    [
        ("mm", "m", 1e-3),
        ("um", "m", 1e-6),
        ("cm", "m", 1e-2),
        ("inch", "m", 0.0254),
        ("g_mm2", "kg_m2", 1e-9),
        ("g_cm2", "kg_m2", 1e-7),
        ("kg_cm2", "kg_m2", 1e-4),
        ("mN_m", "N_m", 1e-3),
        ("mNm", "N_m", 1e-3),
        ("N_mm", "N_m", 1e-3),
        ("N_per_mm", "N_per_m", 1e3),
        ("kN_per_m", "N_per_m", 1e3),
        ("mNm_per_A", "N_m_per_A", 1e-3),
        ("mA", "A", 1e-3),
        ("ms", "s", 1e-3),
        ("us", "s", 1e-6),
        ("min", "s", 60.0),
        ("kHz", "Hz", 1e3),
        ("rad_per_s", "Hz", 1.0 / (2.0 * math.pi)),
        ("deg", "rad", math.pi / 180.0),
        ("rev", "rad", 2.0 * math.pi),
        ("rpm", "rad_per_s", 2.0 * math.pi / 60.0),
        ("A_per_deg", "A_per_rad", 180.0 / math.pi),
        ("A_ms_per_rad", "A_s_per_rad", 1e-3),
        ("kg_m2_per_s", "N_m_s_per_rad", 1.0),  # the paper's unit of D_m
        ("kbit_per_s", "bit_per_s", 1e3),
    ],
)
def test_factor(given: str, wanted: str, factor: float) -> None:
    found = units.factor(given, wanted)
    assert found is not None
    assert math.isclose(found, factor, rel_tol=1e-12)


@pytest.mark.parametrize(
    ("given", "wanted"),
    [("kg", "N_per_m"), ("m", "s"), ("furlong", "m"), ("", "m"), ("mm2", "m"), ("x2", "m"), ("2", "m")],
)
def test_what_does_not_convert(given: str, wanted: str) -> None:
    assert units.factor(given, wanted) is None


def test_every_mix_up_converts() -> None:
    for unit in units._MIX_UPS:
        for other in units.mix_ups(unit):
            assert units.factor(other, unit) is not None, (other, unit)


@pytest.mark.parametrize(
    ("unit", "shown"),
    [("m", "m"), ("kg_m2", "kg m²"), ("N_m_s_per_rad", "N m s/rad"), ("A_per_rad_s", "A/(rad s)"), ("", "")],
)
def test_shown(unit: str, shown: str) -> None:
    assert units.show_unit(unit) == shown
