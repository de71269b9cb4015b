"""Labels of columns, variables and parameters: words, symbols, units with SI prefixes. No matplotlib here."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hil_forceps.report.traces import Array
from hil_forceps.rig.units import show_unit


class Quantity(NamedTuple):
    """Label of a column or a variable."""

    symbol: str  # mathtext
    words: str
    unit: str  # shown with an SI prefix in front; "" for a pure number


class Scale(NamedTuple):
    """A prefix that keeps the largest number on an axis between 0.1 and 1000."""

    factor: float
    unit: str


_QUANTITIES = {
    "theta_m_rad": Quantity(r"$\theta_m$", "motor angle", "rad"),
    "theta_drive_rad": Quantity(r"$\theta_d$", "angle before the gear", "rad"),
    "theta_m_ref_rad": Quantity(r"$\theta_m^{\mathrm{ref}}$", "reference", "rad"),
    "current_A": Quantity("$i$", "motor current", "A"),
    "voltage_V": Quantity("$u$", "motor voltage", "V"),
    "theta_j_rad": Quantity(r"$\theta_j$", "jaw angle", "rad"),
    "tau_w_N_m": Quantity(r"$\tau_w$", "load", "N m"),
    "tau_m_N_m": Quantity(r"$\tau_m$", "motor torque", "N m"),
    "tau_w_estimate_N_m": Quantity(r"$\hat\tau_w$", "estimated load", "N m"),
    "theta_j_estimate_rad": Quantity(r"$\hat\theta_j$", "estimated jaw angle", "rad"),
    "theta": Quantity(r"$\theta_m$", "motor angle", "rad"),
    "theta_m": Quantity(r"$\theta_m$", "motor angle", "rad"),
    "theta_j": Quantity(r"$\theta_j$", "jaw angle", "rad"),
    "omega": Quantity(r"$\omega_m$", "motor speed", "rad/s"),
    "acceleration": Quantity(r"$\dot\omega_m$", "acceleration", "rad/s²"),
    "tension": Quantity("$f$", "wire tension", "N"),
    "elongation": Quantity("$x$", "wire stretch", "m"),
    "load": Quantity(r"$\tau_w$", "load", "N m"),
    "current": Quantity("$i$", "motor current", "A"),
    "time": Quantity("$t$", "time", "s"),
    "time_since_reversal": Quantity(r"$t-t_{\mathrm{rev}}$", "time since reversal", "s"),
}
_UNIT_SUFFIXES = ("rad_per_s", "N_m", "rad", "A", "V", "N", "m", "s")
_PREFIXES = {0: "", -1: "m", -2: "µ", -3: "n", 1: "k", 2: "M"}
# Kilo-radians are not in use, and milliseconds only on short axes.
_UNPREFIXED_ABOVE = {"rad", "s", "rad/s", "rad/s²"}


def quantity(name: str) -> Quantity:
    """Return the label of `name`; an unknown name is split into words and the unit at its end."""
    known = _QUANTITIES.get(name)
    if known:
        return known
    for suffix in _UNIT_SUFFIXES:
        if name.endswith(f"_{suffix}"):
            words = plain(name.removesuffix(f"_{suffix}").replace("_", " "))
            return Quantity(words, words, show_unit(suffix))
    words = plain(name.replace("_", " "))
    return Quantity(words, words, "")


def scale_for(unit: str, values: Array | Sequence[float]) -> Scale:
    """Choose the SI prefix of `unit` for the largest finite of `values`."""
    finite = np.abs(np.asarray(values, dtype=np.float64))
    finite = finite[np.isfinite(finite)]
    largest = float(finite.max()) if finite.size else 0.0
    if not unit or largest == 0:
        return Scale(1.0, unit)
    power = math.log10(largest) + 1e-9
    thousands = math.floor(power / 3) if power >= 3 else min(math.floor((power + 1) / 3), 0)
    thousands = max(min(thousands, 2), -3)
    if thousands > 0 and unit in _UNPREFIXED_ABOVE:
        thousands = 0
    return Scale(10.0 ** (-3 * thousands), _PREFIXES[thousands] + unit)


def axis_label(name: str, scale: Scale, *, words: bool = True) -> str:
    """Return the label of an axis: words, symbol and unit."""
    here = quantity(name)
    text = here.symbol if not words or here.words == here.symbol else f"{here.words} {here.symbol}"
    return f"{text} ({scale.unit})" if scale.unit else text


_PARAMETERS = {
    "motor_viscous_N_m_s_per_rad": "viscous friction, motor",
    "motor_coulomb_N_m": "Coulomb friction, motor",
    "jaw_coulomb_N_m": "Coulomb friction, jaw",
}


def plain(text: str) -> str:
    """Return external text for a figure: on one line, without mathematics."""
    return " ".join(text.split()).replace("$", r"\$")


def parameter_words(name: str) -> str:
    """Write `forceps.wire_stiffness_N_per_m` as `wire stiffness`, what it belongs to in front where that says more."""
    section, _, key = name.rpartition(".")
    words = _PARAMETERS.get(key, key)
    for suffix in _UNITS:
        words = words.removesuffix(suffix)
    words = words.replace("_", " ")
    return words if section in ("forceps", "motor", "") else f"{section}: {words}"


_UNITS = ("_N_m_s_per_rad", "_N_m_per_A", "_N_per_m", "_kg_m2", "_N_m", "_m", "_A", "_s", "_rad", "_Hz")
