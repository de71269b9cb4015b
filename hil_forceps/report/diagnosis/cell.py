"""A diagnosis for a notebook: a piece of HTML with all data escaped, without script and style."""

from collections.abc import Iterator

from hil_forceps.diagnosis.result import Diagnosis, Gain
from hil_forceps.report.diagnosis.names import parameter_words
from hil_forceps.report.diagnosis.words import VERDICTS, bullets, effect_words, escaped, number, percent, table
from hil_forceps.report.diagnosis.words import with_interval as interval


def cell(diagnosis: Diagnosis) -> str:
    """Return the verdict, the effects with their parameters, the gain on runs held out, and the reasons of doubt."""
    mark, _ = VERDICTS[diagnosis.verdict]
    parts = [f"<p>{mark} <b>{escaped(diagnosis.verdict)}</b>: {escaped(diagnosis.sentence)}</p>"]
    if rows := list(_fitted(diagnosis)):
        parts.append(table(("cause", "parameter", "fitted (95 %)", "assumed"), rows, numbers_from=2))
    if diagnosis.gain:
        head = ("held-out runs", "RMSE before", "after", "noise floor", "explained")
        parts.append(table(head, [_gain(name, gain) for name, gain in diagnosis.gain.items()]))
    if diagnosis.reasons:
        parts.append(bullets(escaped(reason) for reason in diagnosis.reasons))
    if diagnosis.next_experiment is not None:
        following = diagnosis.next_experiment
        parts.append(f"<p>next experiment: {escaped(following.name)}; {escaped(following.why)}</p>")
    return f"<div>{''.join(parts)}</div>"


def _fitted(diagnosis: Diagnosis) -> Iterator[tuple[str, str, str, str]]:
    for effect in diagnosis.effects:
        for name, fitted in effect.parameters.items():
            yield effect_words(effect.id), escaped(name), interval(fitted), ""
    for name, shift in diagnosis.parameter_shifts.items():
        yield "another value", escaped(parameter_words(name)), interval(shift.fitted), number(shift.assumed)


def _gain(name: str, gain: Gain) -> tuple[str, ...]:
    explained = f"{percent(gain.explained_share)} ({percent(gain.low)} … {percent(gain.high)})"
    return escaped(name), number(gain.baseline_rmse), number(gain.extended_rmse), number(gain.floor_rmse), explained
