"""A diagnosis in words: numbers with units, equations, names of effects, as escaped HTML."""

import html
import math
import re
from collections.abc import Iterable, Sequence

from hil_forceps.diagnosis.result import Estimate
from hil_forceps.rig.catalogue import EFFECT_IDS, effect
from hil_forceps.rig.units import show_unit

VERDICTS = {
    "consistent": ("✓", "The simulation agrees with the measurement to within noise."),
    "parameters": ("≈", "Known parameters differ from the rig file; refitting them explains the data."),
    "effects": ("▲", "The simulation lacks the effects named here; with them it agrees with the measurement."),
    "unnamed": ("?", "No entry of the catalogue explains the data."),
    "undetermined": ("–", "The data do not allow a verdict."),
}
MORE_IS_LEFT = (
    "The simulation lacks the effects named here; with them the residual is smaller, but still more than noise."
)
DASH = "–"


def escaped(text: str) -> str:
    """Escape text for HTML."""
    return html.escape(text, quote=True)


def number(value: float | None, digits: int = 3) -> str:
    """Format a number: 3 digits, with a power of ten if it is far from 1; a dash if it isn't finite."""
    if value is None or not math.isfinite(value):
        return DASH
    exponent = _exponent([value])
    return _mantissa(value, exponent, digits) + _power(exponent)


def with_interval(estimate: Estimate) -> str:
    """Write `2.06 (1.98 … 2.14) × 10⁻³ N m`, with as many digits as the interval allows."""
    if not math.isfinite(estimate.value):
        return DASH
    finite = [value for value in (estimate.value, estimate.low, estimate.high) if math.isfinite(value)]
    exponent = _exponent(finite)
    width = (max(finite) - min(finite)) / 10.0**exponent
    decimals = min(max(1 - math.floor(math.log10(width)), 0), 6) if width > 0 else 3
    value, low, high = (
        f"{v / 10.0**exponent:.{decimals}f}".replace("-", "−") if math.isfinite(v) else DASH
        for v in (estimate.value, estimate.low, estimate.high)
    )
    unit = f" {unit_words(estimate.unit)}" if estimate.unit else ""
    return f'<span class="n">{value} ({low} … {high}){_power(exponent)}{unit}</span>'


def unit_words(unit: str) -> str:
    """Write `rad_per_s` as `rad/s`."""
    return escaped(f"1/{show_unit(unit[4:])}" if unit.startswith("per_") else show_unit(unit))


def percent(share: float) -> str:
    """Format a share as a percentage; a dash if it isn't finite."""
    return f"{100 * share:.3g} %".replace("-", "−") if math.isfinite(share) else DASH


def equation(text: str) -> str:
    """Write an equation of the catalogue: `θ_m` gets a subscript."""
    return re.sub(r"_([A-Za-z0-9]+)", r"<sub>\1</sub>", escaped(text))


def effect_words(effect_id: str) -> str:
    """Write an effect: what it is, and its id."""
    if effect_id not in EFFECT_IDS:
        return f"<code>{escaped(effect_id)}</code>"
    return f"{escaped(effect(effect_id).summary)} (<code>{escaped(effect_id)}</code>)"


def model_words(ids: Sequence[str]) -> str:
    """Write a model as its effects joined by plus."""
    return " <b>+</b> ".join(effect_words(one) for one in ids) if ids else "the refitted rig alone, no effect"


def table(head: Sequence[str], rows: Iterable[Sequence[str]], *, numbers_from: int = 1) -> str:
    """Return a table of HTML cells; columns from `numbers_from` on are right-aligned."""

    def cells(tag: str, row: Sequence[str]) -> str:
        kinds = ("" if place < numbers_from else ' class="r"' for place in range(len(row)))
        return "".join(f"<{tag}{kind}>{cell}</{tag}>" for kind, cell in zip(kinds, row, strict=True))

    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    return f'<div class="wide"><table><thead><tr>{cells("th", head)}</tr></thead><tbody>{body}</tbody></table></div>'


def bullets(items: Iterable[str]) -> str:
    """Return a list of HTML items."""
    return "<ul>" + "".join(f"<li>{item}</li>" for item in items) + "</ul>"


def _exponent(values: Sequence[float]) -> int:
    largest = max(abs(value) for value in values)
    if largest == 0:
        return 0
    exponent = math.floor(math.log10(largest))
    return 0 if -3 < exponent < 4 else exponent


def _mantissa(value: float, exponent: int, digits: int) -> str:
    scaled = float(f"{value / 10.0**exponent:.{digits}g}")
    text = f"{scaled:.{digits + 2}f}"
    return (text.rstrip("0").rstrip(".") or "0").replace("-", "−")


def _power(exponent: int) -> str:
    return f" × 10<sup>{str(exponent).replace('-', '−')}</sup>" if exponent else ""
