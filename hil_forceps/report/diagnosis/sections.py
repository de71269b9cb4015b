"""The sections of the page; a section without content is an empty text."""

import math

from hil_forceps.diagnosis.error_rates import DETECTION_POWER, FALSE_ALARMS
from hil_forceps.diagnosis.result import Diagnosis, Gain, NamedEffect, Shift
from hil_forceps.report.diagnosis.names import parameter_words, quantity
from hil_forceps.report.diagnosis.words import (
    DASH,
    MORE_IS_LEFT,
    VERDICTS,
    bullets,
    effect_words,
    equation,
    escaped,
    model_words,
    number,
    percent,
    table,
    unit_words,
    with_interval,
)
from hil_forceps.rig import catalogue
from hil_forceps.rig.catalogue import EFFECT_IDS, effect

SEVERITIES = ("problem", "warning", "note")


def verdict(diagnosis: Diagnosis) -> str:
    """Return the verdict, the named effects, and a summary."""
    (mark, kind), name = VERDICTS[diagnosis.verdict], escaped(diagnosis.verdict)
    if diagnosis.verdict == "effects" and diagnosis.varies_over:
        kind = MORE_IS_LEFT
    parts = [
        f'<header class="verdict {name}"><div class="kind">{mark} {name}</div>',
        f"<h1>{escaped(diagnosis.sentence or kind)}</h1>",
    ]
    if diagnosis.sentence:
        parts.append(f"<p>{escaped(kind)}</p>")
    if diagnosis.effects:
        named = ", ".join(f"{effect_words(one.id)}, confidence {percent(one.confidence)}" for one in diagnosis.effects)
        parts.append(f"<p>Named: {named}.</p>")
    if diagnosis.varies_over:
        over = ", ".join(escaped(quantity(name).words) for name in diagnosis.varies_over)
        parts.append(f"<p>The remaining residual varies over: {over}.</p>")
    if diagnosis.verdict == "undetermined" and diagnosis.reasons:
        parts.append(bullets(escaped(reason) for reason in diagnosis.reasons))
    parts.append(f"{_short_gain(diagnosis)}{_short_next(diagnosis)}{_short_audit(diagnosis)}</header>")
    return "".join(parts) + "".join(_card(one) for one in diagnosis.effects)


def trends(diagnosis: Diagnosis) -> str:
    """Tabulate how much smooth curves over one variable explain of the residual, relative to noise."""
    if not diagnosis.trends:
        return ""
    ranked = sorted(diagnosis.trends, key=lambda trend: -trend.before if math.isfinite(trend.before) else math.inf)
    rows = (
        (
            escaped(quantity(trend.channel).words),
            escaped(quantity(trend.variable).words),
            number(trend.before),
            number(trend.after),
        )
        for trend in ranked
    )
    head = ("residual of", "over", "ratio to threshold, before", "after")
    return "<h3>What the residual depends on</h3>" + table(head, rows, numbers_from=2)


def candidates(diagnosis: Diagnosis) -> str:
    """Tabulate the test of every entry, step by step."""
    if not diagnosis.candidates:
        return ""
    ranked = sorted(diagnosis.candidates, key=lambda c: (c.step, -c.score if math.isfinite(c.score) else math.inf))
    rows = (
        (effect_words(c.id), escaped(c.state), str(c.step + 1), number(c.score), number(c.threshold)) for c in ranked
    )
    head = ("entry", "result", "step", "decrease of χ²", "threshold")
    return f"<details><summary>All entries in numbers</summary>{table(head, rows, numbers_from=2)}</details>"


def shifts(diagnosis: Diagnosis) -> str:
    """Tabulate the parameters of the rig, assumed and fitted."""
    rows = (
        (
            escaped(parameter_words(name)),
            _assumed(shift),
            with_interval(shift.fitted),
            percent(shift.fitted.value / shift.assumed - 1) if shift.assumed else DASH,
        )
        for name, shift in diagnosis.parameter_shifts.items()
    )
    head = ("parameter", "assumed", "fitted (95 % interval)", "shift")
    return table(head, rows) if diagnosis.parameter_shifts else ""


def tied(diagnosis: Diagnosis) -> str:
    """List the models that the data can't distinguish, and why."""
    parts = []
    if len(diagnosis.candidate_sets) > 1:
        parts.append("<p>Each of these models explains the data as well as the others; best first.</p>")
        parts.append("<ol>" + "".join(f"<li>{model_words(ids)}</li>" for ids in diagnosis.candidate_sets) + "</ol>")
    elif diagnosis.candidate_sets and diagnosis.verdict != "undetermined":
        parts.append(f"<p>The data select one model: {model_words(diagnosis.candidate_sets[0])}.</p>")
    if diagnosis.reasons and diagnosis.verdict != "undetermined":
        parts.append(bullets(escaped(reason) for reason in diagnosis.reasons))
    return "".join(parts)


def gains(diagnosis: Diagnosis, image: str) -> str:
    """Tabulate the gain of the extended model on runs held out."""
    if not diagnosis.gain:
        return ""
    names = ", ".join(escaped(name) for name in diagnosis.held_out)
    used = f"Held out: {names}." if names else "No run was held out: these figures are of the fitted runs."
    rows = []
    for name, gain in diagnosis.gain.items():
        here = quantity(name)
        unit = f" ({escaped(here.unit)})" if here.unit else ""
        numbers = (gain.baseline_rmse, gain.extended_rmse, gain.floor_rmse)
        rows.append((escaped(here.words) + unit, *(number(value) for value in numbers), _share(gain)))
    head = ("channel", "RMSE before", "RMSE after", "noise floor", "share explained (95 % interval)")
    return f"<p>{used}</p>{image}{table(head, rows)}"


def minimum_detectable(diagnosis: Diagnosis) -> str:
    """Tabulate the smallest detectable size of each effect."""
    rows = (
        (
            effect_words(name),
            f"<code>{escaped(least.parameter)}</code>",
            f"{number(least.value)} {unit_words(least.unit)}",
        )
        for name, least in diagnosis.minimum_detectable.items()
    )
    rates = f"{percent(DETECTION_POWER)} power, {percent(FALSE_ALARMS)} false alarms"
    text = f"<p>An effect smaller than this can be present without being detected ({rates}).</p>"
    return (
        text + table(("effect", "parameter", "smallest detectable size"), rows, numbers_from=2)
        if diagnosis.minimum_detectable
        else ""
    )


def audit(diagnosis: Diagnosis) -> str:
    """List the findings of the audit, the most severe first, and the use of each run."""
    parts = []
    if diagnosis.runs:
        rows = (
            (
                escaped(run.name),
                "held out" if run.held_out else "fitted",
                f"{len(run.time_s)}",
                number(float(run.time_s[-1] - run.time_s[0])) if len(run.time_s) else DASH,
                ", ".join(escaped(quantity(name).words) for name in run.measured if name != "time_s"),
            )
            for run in diagnosis.runs
        )
        parts.append(table(("run", "used", "rows", "length (s)", "channels"), rows, numbers_from=5))
    if diagnosis.data_audit:
        ranked = sorted(diagnosis.data_audit, key=lambda finding: SEVERITIES.index(finding.severity))
        findings = (
            (
                f'<span class="{found.severity}">{found.severity}</span>',
                escaped(found.run),
                escaped(quantity(found.channel).words),
                escaped(found.text),
            )
            for found in ranked
        )
        parts.append(table(("", "run", "channel", "finding"), findings, numbers_from=5))
    elif diagnosis.runs:
        parts.append("<p>No relevant gaps, repeats, saturation or skew.</p>")
    return "".join(parts)


def next_experiment(diagnosis: Diagnosis) -> str:
    """Describe the experiment that best separates the remaining models."""
    following = diagnosis.next_experiment
    if following is None:
        return ""
    parts = [f"<p><b>{escaped(following.name.replace('_', ' '))}</b>. {escaped(following.why)}</p>"]
    if following.separates:
        parts.append("<p>It would separate:</p>")
        parts.append(bullets(" <i>from</i> ".join(effect_words(one) for one in ids) for ids in following.separates))
    if math.isfinite(following.predicted_separation):
        size = number(following.predicted_separation)
        parts.append(f"<p>Predicted separation: {size} standard deviations (below 3 it is hardly detectable).</p>")
    return "".join(parts)


def how() -> str:
    """Describe the method in short, with the equations of the catalogue."""
    lines = [line.strip() for line in (catalogue.__doc__ or "").splitlines() if line.startswith("    ")]
    chain = "".join(f"<li>{equation(line)}</li>" for line in lines)
    return (
        "<p>The data are audited before any model. If the drive's law is known, an extended Kalman filter predicts "
        "each row from the rows before it. Otherwise the measured motion drives the simulation. The known "
        "parameters are fitted to the errors of the prediction, with priors from the rig. Every entry of the "
        "catalogue is then scored: the errors are whitened, and what the fitted parameters explain is projected "
        f"out. The threshold is the score that chance exceeds in {percent(FALSE_ALARMS)} of data sets, for the whole "
        "catalogue together. The best entries are refitted, and added one by one as long as they exceed the "
        "threshold. Models that are too close to the best one are kept as a set. Smooth curves without physics test "
        "what remains. The gain is computed on runs used neither for fitting nor for selection. Residuals in the "
        "figures are measured less simulated.</p>"
        f'<h3>Equations of the simulation</h3><ul class="chain">{chain}</ul>'
    )


def _card(named: NamedEffect) -> str:
    known = named.id in EFFECT_IDS
    title = escaped(effect(named.id).summary if known else named.id)
    head = f'<div class="card"><h3>{title} <span class="note"><code>{escaped(named.id)}</code></span></h3>'
    text = f"in the {escaped(named.location)}, confidence {percent(named.confidence)}"
    if not known:
        return f"{head}<p>{text}</p>{_parameters(named)}</div>"
    entry = effect(named.id)
    source = f'<p class="note">Visible in: {escaped(entry.shown_by)}. Source: {escaped(entry.source)}.</p>'
    return f'{head}<span class="eq">{equation(entry.equation)}</span><p>{text}</p>{_parameters(named)}{source}</div>'


def _parameters(named: NamedEffect) -> str:
    meanings = {p.name: p.meaning for p in effect(named.id).parameters} if named.id in EFFECT_IDS else {}
    rows = (
        (f"<code>{escaped(name)}</code>", equation(meanings.get(name, "")), with_interval(estimate))
        for name, estimate in named.parameters.items()
    )
    return table(("parameter", "", "value (95 % interval)"), rows, numbers_from=2) if named.parameters else ""


def _assumed(shift: Shift) -> str:
    if shift.assumed is None:
        return "unknown"
    return f'<span class="n">{number(shift.assumed)} {unit_words(shift.fitted.unit)}</span>'


def _share(gain: Gain) -> str:
    if not math.isfinite(gain.explained_share):
        return DASH
    return f'<span class="n">{percent(gain.explained_share)} ({percent(gain.low)} … {percent(gain.high)})</span>'


def _short_gain(diagnosis: Diagnosis) -> str:
    parts = [
        f"{escaped(quantity(name).words)} {percent(gain.explained_share)}"
        for name, gain in diagnosis.gain.items()
        if math.isfinite(gain.explained_share)
    ]
    where = "on held-out runs" if diagnosis.held_out else "(no run was held out)"
    return f"<p>Explained {where}: {', '.join(parts)}.</p>" if parts else ""


def _short_next(diagnosis: Diagnosis) -> str:
    following = diagnosis.next_experiment
    return f"<p>To measure next: {escaped(following.name.replace('_', ' '))}.</p>" if following else ""


def _short_audit(diagnosis: Diagnosis) -> str:
    problems = sum(found.severity == "problem" for found in diagnosis.data_audit)
    if not problems:
        return ""
    return f'<p class="problem">{problems} problem{"s" if problems > 1 else ""} in the data, see below.</p>'
