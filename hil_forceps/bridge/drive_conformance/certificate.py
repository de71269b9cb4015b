"""What came of a run, as plain data: who was judged, over which line, each verdict with all that was measured."""

from collections import Counter
from collections.abc import Sequence
from typing import Any, Final

from firmware_protocol.conformance.suite import Verdict
from hil_forceps.bridge.drive_conformance.suite import SUITE_VERSION, Result, Suite
from hil_forceps.rig.sections import MotorDriver

CERTIFICATE_FORMAT: Final = 1


def certificate(suite: Suite, settings: MotorDriver, line: str, results: Sequence[Result]) -> dict[str, Any]:
    """Return the certificate. In virtual time the same drive gives the same, to the byte."""
    session, counted = suite.session, Counter(result.verdict.value for result in results)
    promises = session.promises
    return {
        "certificate_format": CERTIFICATE_FORMAT,
        "suite": "drive",
        "suite_version": SUITE_VERSION,
        "motor_driver": settings.model_dump(mode="json"),
        "limits": session.limits.model_dump(mode="json"),
        "promises": {
            "state_report_s": promises.state_report_s,
            "starved": promises.starved,
            "tells_state": promises.tells_state,
            "tells_watchdog": promises.tells_watchdog,
            "current_step_A": promises.current_step_A,
        },
        "line": line,
        "time": "virtual" if session.is_virtual else "real",
        "motion_allowed": suite.allow_motion,
        "margins": session.margins._asdict(),
        "bounds": session.bounds._asdict(),
        "verdicts": {verdict.value: counted[verdict.value] for verdict in Verdict},
        "requirements": [_promise(result) for result in results],
    }


def _promise(result: Result) -> dict[str, Any]:
    promise = result.requirement
    return {
        "id": promise.name,
        "level": promise.level,
        "title": promise.title,
        "why": promise.why,
        "verdict": result.verdict.value,
        "evidence": result.evidence,
        "applies": result.applies,
        "attempts": result.attempts,
        "measures": [measure._asdict() for measure in result.measures],
    }
