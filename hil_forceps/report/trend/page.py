"""The page of a trend: changes, each instrument's parameters over days, sessions, method."""

from collections.abc import Iterable, Mapping, Sequence

from hil_forceps.diagnosis.result import TWO_SIDED_95, Estimate
from hil_forceps.drift.result import InstrumentTrend, ParameterTrend, SessionLine, Trend
from hil_forceps.drift.words import name_of
from hil_forceps.report.diagnosis.page import POLICY, STYLE
from hil_forceps.report.diagnosis.words import DASH, escaped, number, unit_words, with_interval

SOURCES = {
    "table": "sessions.csv",
    "recording": "recording",
    "name": "file name",
    "file": "file time",
    "": "unknown",
}


def page(trend: Trend, images: Mapping[str, str]) -> str:
    """Return the page; `images`: figures by instrument, as HTML."""
    sections = [("Changes", _changes(trend))]
    sections += [
        (f"Instrument {each.name}", images.get(each.name, "") + _parameters(each)) for each in trend.instruments
    ]
    sections += [("Sessions", _sessions(trend.sessions)), ("Method", _how(trend))]
    contents = "".join(f'<a href="#s{place}">{escaped(title)}</a>' for place, (title, _) in enumerate(sections, 1))
    body = "".join(
        f'<section id="s{place}"><h2>{escaped(title)}</h2>{content}</section>'
        for place, (title, content) in enumerate(sections, 1)
    )
    used = sum(line.reason is None for line in trend.sessions)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>Parameters over sessions</title><style>{STYLE}</style></head>\n"
        f"<body><main><h1>Parameters over {used} of {len(trend.sessions)} sessions</h1><nav>{contents}</nav>{body}"
        "<footer>hil-forceps. Not a medical device.</footer></main></body></html>\n"
    )


def _changes(trend: Trend) -> str:
    said = [
        f"<li><b>{escaped(instrument.name)}</b>: {escaped(text)}</li>"
        for instrument in trend.instruments
        for parameter in instrument.parameters
        for text in parameter.sentences()
    ]
    if not said:
        return "<p>No change was found beyond the scatter between sessions.</p>"
    return f"<ul>{''.join(said)}</ul>"


def _parameters(instrument: InstrumentTrend) -> str:
    if not instrument.parameters:
        return "<p>No session measures any parameter.</p>"
    headers = ("parameter", "verdict", "begins", "first level", "last level", "scatter", "p", "sessions", "outliers")
    return _table(headers, (_row(each) for each in instrument.parameters))


def _row(p: ParameterTrend) -> list[str]:
    onsets = [
        f"{escaped(c.onset.session)}, {c.onset.date[:10]} ({c.low.date[:10]} … {c.high.date[:10]})" for c in p.changes
    ]
    return [
        escaped(name_of(p.name)),
        p.verdict,
        "<br>".join(onsets) or DASH,
        _level(p, 0),
        _level(p, -1),
        f"{number(p.scatter)} {unit_words(p.unit)}, φ = {p.correlation:.2g}",
        number(p.p_value, 2),
        str(len(p.sessions)),
        escaped(", ".join(p.apart)) or DASH,
    ]


def _level(p: ParameterTrend, place: int) -> str:
    value, reach = float(p.level[place]), TWO_SIDED_95 * float(p.level_sd[place])
    return with_interval(Estimate(value, value - reach, value + reach, p.unit))


def _sessions(lines: Sequence[SessionLine]) -> str:
    headers = ("session", "instrument", "date (UTC)", "date from", "not used because", "notes")
    rows = (
        [
            escaped(line.name),
            escaped(line.instrument),
            line.date or DASH,
            SOURCES[line.date_from],
            f'<span class="problem">{escaped(line.reason)}</span>' if line.reason else "",
            escaped(line.notes or ""),
        ]
        for line in lines
    )
    return _table(headers, rows)


def _how(trend: Trend) -> str:
    return (
        "<p>In each session the known parameters of the rig are fitted by the likelihood of that session alone. Points "
        "are these estimates with their 95 % intervals. Sessions differ by more than that (temperature, how the wire "
        "lies): this scatter, and its correlation from one session to the next, are estimated with the level. The line "
        "is the level with its 95 % interval. A dashed line is the first session of a change, shaded its 95 % "
        "interval. A cross is an outlier and is excluded.</p>"
        f"<p>The false-alarm rate of an instrument is at most {100.0 * trend.false_alarms:.3g} %, over "
        "all its sessions and parameters.</p>"
    )


def _table(headers: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    head = "".join(f"<th>{escaped(each)}</th>" for each in headers)
    body = "".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    return f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'
