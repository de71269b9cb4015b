"""Why a run ended otherwise than it was meant to: which check failed, at what value, against what limit."""

import math
from typing import Final, NamedTuple

from hil_forceps.bridge.course import SILENT_PERIODS
from hil_forceps.bridge.pipeline import VERDICT_NAMES, Pipeline
from hil_forceps.bridge.results import ServiceConfig, Stage, StopReason
from hil_forceps.control.gate import GateTrip
from hil_forceps.control.gate.trip import WORDS as GATE_CHECKS

CRASHED = "crashed"  # this program failed
VALUE_IN_MESSAGE: Final = frozenset({StopReason.REFERENCE_DENIED.value, StopReason.DRIVE_LOST.value})
BY_THE_GATE: Final = frozenset({StopReason.REFERENCE_DENIED, StopReason.FEEDBACK_IMPLAUSIBLE, StopReason.GATE_LATCHED})


class FaultReason(NamedTuple):
    """The check that failed. `value` and `limit` are NaN where nothing was compared."""

    reason: str  # a `StopReason`'s word, or `CRASHED`
    check: str
    value: float
    limit: float
    unit: str
    time_ns: int  # host's clock
    stage: str  # that the run was in
    message: str

    @property
    def comparison(self) -> str:
        """What was compared, in words; see `compared`."""
        return compared(self.reason, self.check, self.value, self.limit, self.unit)


def compared(reason: str, check: str, value: float, limit: float, unit: str) -> str:
    """Return what was compared, in words, as far as the message of such an end doesn't have it; else nothing."""
    if check in GATE_CHECKS or not (math.isfinite(value) and math.isfinite(limit)):
        return ""
    unit = f" {unit}" if unit else ""
    found = f"limit {limit:.6g}{unit}"
    return found if reason in VALUE_IN_MESSAGE else f"{check}: {value:.6g}{unit}, {found}"


class Situation(NamedTuple):
    """Where an axis was when it ended."""

    stage: Stage  # that it left
    entered_ns: int
    now_ns: int
    last_sample_ns: int


def reason_of(
    reason: StopReason, message: str, where: Situation, pipeline: Pipeline, config: ServiceConfig, trip: GateTrip | None
) -> FaultReason:
    """Return what failed; a gate's own trip says it better than the references that it denied since."""
    if trip is not None and reason in BY_THE_GATE:
        found = FaultReason("", trip.check, trip.value, trip.limit, trip.unit, trip.time_ns, "", "")
    else:
        found = FaultReason("", *_compared(reason, where, pipeline, config), where.now_ns, "", "")
    return found._replace(reason=reason.value, stage=where.stage.value, message=message)


def _compared(
    reason: StopReason, where: Situation, pipeline: Pipeline, config: ServiceConfig
) -> tuple[str, float, float, str]:
    """Return check, value, limit and unit."""
    spent_s = (where.now_ns - where.entered_ns) / 1e9
    if reason is StopReason.NO_DRIVE:
        return "time to connect", spent_s, config.connect_timeout_ns / 1e9, "s"
    if reason is StopReason.ENABLE_FAILED:
        return "time to become operational", spent_s, config.enable_timeout_ns / 1e9, "s"
    if reason is StopReason.REFERENCE_DENIED:
        verdict = VERDICT_NAMES.get(pipeline.verdict, str(pipeline.verdict))
        denied = float(pipeline.denied_in_a_row)
        return f"references denied in a row ({verdict})", denied, float(config.max_denied_in_a_row - 1), ""
    if reason is StopReason.DRIVE_LOST and where.stage is Stage.RUNNING:
        silent_ms = (where.now_ns - where.last_sample_ns) / 1e6
        limit_ms = max(config.silence_timeout_ns, SILENT_PERIODS * config.period_ns) / 1e6
        if silent_ms > limit_ms:
            return "time since the last sample", silent_ms, limit_ms, "ms"
    return reason.value.replace("_", " "), math.nan, math.nan, ""
