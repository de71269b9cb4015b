"""What came of a run: the certificate as plain data, a JUnit file, and whether all is well."""

import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Collection, Sequence
from typing import Any, Final, Protocol

from firmware_protocol.conformance.session import Session
from firmware_protocol.conformance.suite import SUITE_VERSION, CheckResult, Result, Suite, Verdict
from firmware_protocol.messages import PROTOCOL_MAJOR, PROTOCOL_MINOR
from firmware_protocol.parameters import BY_INDEX

CERTIFICATE_FORMAT: Final = 1


class _Judged(Protocol):
    @property
    def number(self) -> int: ...
    @property
    def title(self) -> str: ...
    @property
    def level(self) -> str: ...
    @property
    def name(self) -> str: ...


class Verdicted(Protocol):
    """What a suite found of something that it judges: this one of a requirement, others of what they hold drives to."""

    @property
    def requirement(self) -> _Judged:
        """What was judged."""

    @property
    def verdict(self) -> Verdict:
        """What can be said of it."""

    @property
    def evidence(self) -> str:
        """Why."""

    @property
    def applies(self) -> bool:
        """Whether there was anything to judge."""


def is_well(results: Sequence[Verdicted], named: Collection[int]) -> bool:
    """Tell whether nothing failed or stayed open that was asked for.

    A MUST that failed or could not be told is never well; a SHOULD only when it failed. What was not run is, unless
    the user has named it.
    """
    for result in results:
        if result.verdict is Verdict.FAIL:
            return False
        if result.verdict is Verdict.INCONCLUSIVE and (result.requirement.level == "MUST" or named):
            return False
        if result.verdict is Verdict.NOT_RUN and result.requirement.number in named:
            return False
    return True


def certificate(suite: Suite, line: str, results: Sequence[Result]) -> dict[str, Any]:
    """Return the certificate: who was judged, over which line and with which margins, and each verdict.

    In virtual time the same drive gives the same certificate, to the byte.
    """
    session = suite.session
    return {
        "certificate_format": CERTIFICATE_FORMAT,
        "suite_version": SUITE_VERSION,
        "protocol_version": f"{PROTOCOL_MAJOR}.{PROTOCOL_MINOR}",
        "device": _device(session),
        "line": line,
        "time": "virtual" if session.virtual else "real",
        "motion_allowed": suite.allow_motion,
        "margins": suite.margins._asdict(),
        "verdicts": _counts(results),
        "requirements": [_requirement(result) for result in results],
    }


def _device(session: Session) -> dict[str, Any]:
    identity = session.identity
    assert identity is not None, "a suite that was never opened has nothing to certify"
    return {
        "serial_number": f"{session.serial_number:012x}",
        "node": session.home,
        "protocol_version": f"{identity.protocol_major}.{identity.protocol_minor}",
        "fd": session.fd,
        "parameters": {BY_INDEX[index].name: value for index, value in session.originals.items()},
    }


def _counts(results: Sequence[Verdicted]) -> dict[str, int]:
    counted = Counter(result.verdict.value for result in results)
    return {verdict.value: counted[verdict.value] for verdict in Verdict}


def _requirement(result: Result) -> dict[str, Any]:
    requirement = result.requirement
    return {
        "id": requirement.name,
        "level": requirement.level,
        "title": requirement.title,
        "verdict": result.verdict.value,
        "evidence": result.evidence,
        "applies": result.applies,
        "checks": [_check(each) for each in result.checks],
    }


def _check(result: CheckResult) -> dict[str, Any]:
    worst: dict[str, dict[str, Any]] = {}
    for time in result.timings:
        row = worst.setdefault(
            time.name,
            {"count": 0, "least_us": time.measured_us, "most_us": time.measured_us},
        )
        row["count"] += 1
        row["least_us"] = min(row["least_us"], time.measured_us)
        row["most_us"] = max(row["most_us"], time.measured_us)
        row["allowed_us"] = [time.low_us, time.high_us]
    return {
        "name": result.name,
        "verdict": result.verdict.value,
        "evidence": result.evidence,
        "attempts": result.attempts,
        "timings": worst,
    }


def junit(results: Sequence[Verdicted], name: str) -> str:
    """Return a JUnit file: a case for each requirement, what could not be told as an error."""
    counted = _counts(results)
    suite = ET.Element(
        "testsuite",
        name=name,
        tests=str(len(results)),
        failures=str(counted[Verdict.FAIL.value]),
        errors=str(counted[Verdict.INCONCLUSIVE.value]),
        skipped=str(counted[Verdict.NOT_RUN.value]),
    )
    tags = {Verdict.FAIL: "failure", Verdict.INCONCLUSIVE: "error", Verdict.NOT_RUN: "skipped"}
    for result in results:
        requirement = result.requirement
        prefix = requirement.name.split("-")[0]
        case = ET.SubElement(suite, "testcase", classname=prefix, name=f"{requirement.name} {requirement.title}")
        if result.verdict in tags:
            ET.SubElement(case, tags[result.verdict], message=_printable(result.evidence))
        else:
            ET.SubElement(case, "system-out").text = _printable(result.evidence)
    ET.indent(suite)
    return ET.tostring(suite, encoding="unicode", xml_declaration=True) + "\n"


def _printable(text: str) -> str:
    return "".join(c if c.isprintable() else "?" for c in text)
