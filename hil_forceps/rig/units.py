"""Units as they stand in key names (`N_per_m`, `A_s_per_rad`): converting between them, for helpful errors only."""

import math
from typing import NamedTuple

_Dimension = tuple[int, int, int, int]  # exponents of m, kg, s, A; an angle counts as a number


class _Scale(NamedTuple):
    size: float  # of the unit, in SI
    dimension: _Dimension


_SYMBOLS = {
    "m": _Scale(1.0, (1, 0, 0, 0)),
    "g": _Scale(1e-3, (0, 1, 0, 0)),
    "s": _Scale(1.0, (0, 0, 1, 0)),
    "A": _Scale(1.0, (0, 0, 0, 1)),
    "N": _Scale(1.0, (1, 1, -2, 0)),
    "Nm": _Scale(1.0, (2, 1, -2, 0)),
    "Hz": _Scale(2.0 * math.pi, (0, 0, -1, 0)),  # turns per second, as a corner frequency is
    "rad": _Scale(1.0, (0, 0, 0, 0)),
    "deg": _Scale(math.pi / 180.0, (0, 0, 0, 0)),
    "rev": _Scale(2.0 * math.pi, (0, 0, 0, 0)),
    "turn": _Scale(2.0 * math.pi, (0, 0, 0, 0)),
    "bit": _Scale(1.0, (0, 0, 0, 0)),
    "ppm": _Scale(1.0, (0, 0, 0, 0)),
}
_UNPREFIXED = {
    "rpm": _Scale(2.0 * math.pi / 60.0, (0, 0, -1, 0)),
    "min": _Scale(60.0, (0, 0, 1, 0)),
    "inch": _Scale(0.0254, (1, 0, 0, 0)),
}
_PREFIXES = {"": 1.0, "n": 1e-9, "u": 1e-6, "m": 1e-3, "c": 1e-2, "k": 1e3, "M": 1e6}

# What people mean when a number is out of all reason in the unit of the key, most likely first.
_MIX_UPS = {
    "m": ("mm", "um", "cm"),
    "kg_m2": ("g_mm2", "g_cm2", "kg_mm2"),
    "N_m_s_per_rad": ("mN_m_s_per_rad", "uN_m_s_per_rad"),
    "N_m": ("mN_m", "uN_m"),
    "N_per_m": ("N_per_mm", "kN_per_m"),
    "N_m_per_A": ("mN_m_per_A",),
    "s": ("ms", "us", "ns"),
    "A": ("mA", "uA"),
    "rad": ("deg", "mrad"),
    "rad_per_s": ("deg_per_s", "rpm"),
    "rad_per_s2": ("deg_per_s2",),
    "Hz": ("kHz", "rad_per_s"),
    "bit_per_s": ("kbit_per_s", "Mbit_per_s"),
    "A_per_rad": ("mA_per_rad",),
}


def show_unit(unit: str) -> str:
    """Write `N_m_s_per_rad` as `N m s/rad`."""
    above, _, below = _parts(unit.replace("2", "²").replace("3", "³"))
    shown = above.replace("_", " ")
    if below:
        shown = shown or "1"
        shown += f"/({below.replace('_', ' ')})" if "_" in below else f"/{below}"
    return shown


def factor(given: str, wanted: str) -> float | None:
    """Return what a number in unit `given` is multiplied by to be in unit `wanted`; None when they don't convert."""
    source, target = _parse(given), _parse(wanted)
    if source is None or target is None or source.dimension != target.dimension:
        return None
    ratio = source.size / target.size
    exponent = round(math.log10(ratio))
    return 10.0**exponent if math.isclose(ratio, 10.0**exponent, rel_tol=1e-12) else ratio


def mix_ups(unit: str) -> tuple[str, ...]:
    """Return the units that a number meant for `unit` is most often given in by mistake."""
    return _MIX_UPS.get(unit, ())


def _parts(unit: str) -> tuple[str, str, str]:
    return ("", "", unit.removeprefix("per_")) if unit.startswith("per_") else unit.partition("_per_")


def _parse(unit: str) -> _Scale | None:
    above, _, below = _parts(unit)
    size = 1.0
    dimension = (0, 0, 0, 0)
    for part, sign in ((above, 1), (below, -1)):
        for token in part.split("_") if part else ():
            scale = _parse_token(token)
            if scale is None:
                return None
            size *= scale.size**sign
            dimension = _added(dimension, scale.dimension, sign)
    return _Scale(size, dimension)


def _parse_token(token: str) -> _Scale | None:
    symbol, power = (token[:-1], int(token[-1])) if token[-1:] in {"2", "3"} else (token, 1)
    scale = _UNPREFIXED.get(symbol) or _prefixed(symbol)
    return scale and _Scale(scale.size**power, _added((0, 0, 0, 0), scale.dimension, power))


def _added(total: _Dimension, one: _Dimension, times: int) -> _Dimension:
    return (total[0] + times * one[0], total[1] + times * one[1], total[2] + times * one[2], total[3] + times * one[3])


def _prefixed(symbol: str) -> _Scale | None:
    for prefix, size in _PREFIXES.items():
        base = _SYMBOLS.get(symbol.removeprefix(prefix)) if symbol.startswith(prefix) else None
        if base is not None:
            return _Scale(size * base.size, base.dimension)
    return None
