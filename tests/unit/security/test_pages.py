"""Nothing out of data becomes markup: a diagnosis, a certificate and a JUnit file whose every text is hostile."""

import dataclasses
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol.conformance.catalogue import REQUIREMENTS
from firmware_protocol.conformance.report import junit
from firmware_protocol.conformance.suite import Result, Verdict
from hil_forceps.diagnosis.result import Diagnosis
from hil_forceps.report.diagnosis.files import write_report
from hil_forceps.report.diagnosis.page import POLICY, page
from hil_forceps.report.diagnosis.sections import SEVERITIES
from hil_forceps.report.diagnosis.words import VERDICTS
from tests.unit.report.diagnosis.cases import wire_slack

HOSTILE = (
    "<script>alert(1)</script>",
    '"><img src=x onerror=alert(1)>',
    "'><svg onload=alert(1)>",
    "javascript:alert(1)",
    "</style><script>alert(1)</script>",
    "</title><iframe src=//evil>",
    "--><b onmouseover=alert(1)>",
    "&lt;script&gt;&#x3c;script&#x3e;",
    "<a href=javascript:alert(1)>",
    "\x00<script>\x1b[2J",
)
ELEMENTS = {
    "html", "head", "meta", "title", "style", "body", "main", "header", "div", "h1", "h2", "h3", "p", "nav", "a",
    "section", "footer", "figure", "img", "figcaption", "table", "thead", "tbody", "tr", "th", "td", "code", "span",
    "ul", "ol", "li", "b", "i", "sub", "sup", "details", "summary",
}  # fmt: skip
ATTRIBUTES = {"lang", "charset", "name", "content", "http-equiv", "id", "class", "href", "src", "alt"}


class Markup(HTMLParser):
    """Collects what a browser would make of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, tuple[tuple[str, str | None], ...]]] = []
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, tuple(attrs)))

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, tuple(attrs)))

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def hostile(value: Any, texts: Iterator[str]) -> Any:
    """Return a value with every text in it replaced, keys too; numbers, shapes and severities stay."""
    if isinstance(value, str):
        return value if value in SEVERITIES else next(texts)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        return dataclasses.replace(value, **{name: hostile(each, texts) for name, each in fields.items()})
    if isinstance(value, tuple) and hasattr(value, "_fields"):  # a named tuple
        return type(value)(*(hostile(each, texts) for each in value))
    if isinstance(value, list | tuple):
        return type(value)(hostile(each, texts) for each in value)
    if isinstance(value, dict):
        return {hostile(key, texts): hostile(each, texts) for key, each in value.items()}
    return value


def texts() -> Iterator[str]:
    """Yield the hostile texts in turn, each with a number, so that keys stay different."""
    place = 0
    while True:
        yield f"{HOSTILE[place % len(HOSTILE)]}{place}"
        place += 1


def looked_at(text: str) -> Markup:
    markup = Markup()
    markup.feed(text)
    markup.close()
    return markup


def require_ours(markup: Markup) -> None:
    assert {tag for tag, _ in markup.found} <= ELEMENTS
    for tag, attributes in markup.found:
        assert {name for name, _ in attributes} <= ATTRIBUTES, (tag, attributes)
        for name, value in attributes:
            assert name != "href" or (value or "").startswith("#"), value
            assert name != "src" or (value or "").startswith("data:image/"), value
            assert name != "id" or (value or "").strip("s").isdecimal(), value


@pytest.mark.parametrize("verdict", list(VERDICTS))
def test_a_diagnosis_whose_every_text_is_hostile_has_no_markup_of_its_own(verdict: Any) -> None:
    sound = wire_slack(runs=2)
    made: Diagnosis = hostile(sound, texts())
    made = dataclasses.replace(made, verdict=verdict)
    said = page(made, {})
    markup = looked_at(said)
    require_ours(markup)
    assert "<script" not in said
    shown = "".join(markup.text)
    assert "<script>alert(1)</script>" in shown  # as text
    assert said == page(made, {})


def test_names_of_runs_in_the_whole_report_are_text(tmp_path: Path) -> None:
    sound = wire_slack(runs=2)
    turns = texts()
    runs = tuple(dataclasses.replace(run, name=next(turns)) for run in sound.runs)
    made = dataclasses.replace(
        sound,
        runs=runs,
        held_out=tuple(run.name for run in runs if run.held_out),
        sentence=HOSTILE[1],
        reasons=HOSTILE,
    )
    write_report(made, tmp_path / "report.html")
    markup = looked_at((tmp_path / "report.html").read_text(encoding="utf-8"))
    require_ours(markup)
    assert sum(tag == "img" for tag, _ in markup.found) > 5


def test_the_pages_policy_lets_no_script_run() -> None:
    found = looked_at(page(wire_slack(runs=2), {})).found
    kind = ("http-equiv", "Content-Security-Policy")
    policies = [dict(attributes)["content"] for _, attributes in found if kind in attributes]
    assert policies == [POLICY]
    directives = dict(each.strip().partition(" ")[::2] for each in POLICY.split(";"))
    assert directives["default-src"] == "'none'"
    assert not set(directives) & {"script-src", "script-src-elem", "connect-src", "object-src", "frame-src"}
    place = [tag for tag, _ in found].index("style")
    assert any(kind in attributes for _, attributes in found[:place])


@pytest.mark.parametrize("text", HOSTILE)
def test_a_junit_file_says_it_as_text(text: str) -> None:
    number = next(iter(REQUIREMENTS))
    results = [Result(REQUIREMENTS[number], verdict, text, (), True) for verdict in Verdict]
    tree = ET.fromstring(junit(results, text.replace("\x00", "").replace("\x1b", "")))
    assert {element.tag for element in tree.iter()} == {
        "testsuite", "testcase", "failure", "error", "skipped", "system-out",
    }  # fmt: skip
    failure = tree.find(".//failure")
    assert failure is not None
    assert failure.attrib == {"message": "".join(c if c.isprintable() else "?" for c in text)}


def test_replacing_reaches_every_text() -> None:
    made = hostile(wire_slack(runs=2), texts())
    left = [each for each in _texts(made) if not any(each.startswith(one) for one in (*HOSTILE, *SEVERITIES))]
    assert left == []


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        for field in dataclasses.fields(value):
            yield from _texts(getattr(value, field.name))
    elif isinstance(value, dict):
        for pair in value.items():
            yield from _texts(pair)
    elif isinstance(value, list | tuple):
        for each in value:
            yield from _texts(each)
