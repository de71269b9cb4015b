"""The section on the ladder: gain of each named entry, and the remaining residual."""

from hil_forceps.diagnosis.result import Diagnosis, Rung
from hil_forceps.report.diagnosis.names import quantity
from hil_forceps.report.diagnosis.words import DASH, effect_words, escaped, number, percent, table, with_interval

FIRST = "known parameters"
MOST_TRENDS = 3


def ladder_section(diagnosis: Diagnosis, image: str) -> str:
    """Tabulate the steps with gain and parameters, and describe the remaining residual."""
    if not diagnosis.ladder:
        return ""
    names = list(diagnosis.ladder[0].rmse)
    rows = []
    for rung in diagnosis.ladder:
        parameters = "<br>".join(
            f"<code>{escaped(name)}</code> {with_interval(estimate)}" for name, estimate in rung.parameters.items()
        )
        cells = []
        for name in names:
            cells += [number(rung.rmse.get(name)), percent(rung.gain[name]) if name in rung.gain else DASH]
        rows.append((effect_words(rung.id) if rung.id else escaped(FIRST), parameters, *cells))
    head = ["step", "parameters (95 % interval)"]
    for name in names:
        unit = quantity(name).unit
        head += [escaped(f"{quantity(name).words}, RMSE" + (f" ({unit})" if unit else "")), "gain of the step"]
    used = "the runs held out" if diagnosis.held_out else "the fitted runs, because none was held out"
    text = (
        f"<p>Errors on {used}. The gain of a step is its share of the squared error that the known parameters leave "
        "above the noise floor. A negative gain means that the channel became worse.</p>"
    )
    return text + image + table(head, rows, numbers_from=2) + _left(diagnosis)


def _left(diagnosis: Diagnosis) -> str:
    last, parts = diagnosis.ladder[-1], []
    for name, error in last.rmse.items():
        floor = noise_floor(diagnosis, name)
        if floor and error > floor:
            parts.append(f"{escaped(quantity(name).words)} {number(error / floor)} times its noise floor")
    if not parts:
        return ""
    over = ", ".join(escaped(quantity(name).words) for name in diagnosis.varies_over) or _trends(diagnosis)
    return f"<p>Remaining error: {', '.join(parts)}{f'; it varies over {over}' if over else ''}.</p>"


def _trends(diagnosis: Diagnosis) -> str:
    """Name the smooth curves that explain most of the residual, if the verdict names none."""
    ranked = sorted((trend for trend in diagnosis.trends if trend.after > 1.0), key=lambda trend: -trend.after)
    return ", ".join(
        f"{escaped(quantity(trend.variable).words)} ({escaped(quantity(trend.channel).words)}, "
        f"{number(trend.after)} times the threshold)"
        for trend in ranked[:MOST_TRENDS]
    )


def noise_floor(diagnosis: Diagnosis, name: str) -> float:
    """Return the noise floor of a channel on the runs of the ladder; 0 if unknown."""
    gain = diagnosis.gain.get(name)
    return gain.floor_rmse if gain is not None else diagnosis.noise_sd.get(name, 0.0)


def label(rung: Rung) -> str:
    """Name a step in a figure."""
    return f"+ {rung.id.replace('_', ' ')}" if rung.id else FIRST
