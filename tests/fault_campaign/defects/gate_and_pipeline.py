"""Defects of the gate and of the pipeline."""

from typing import Any

import pytest

from hil_forceps.bridge.axis import Axis
from hil_forceps.bridge.pipeline import Pipeline
from hil_forceps.control.gate import Gate, GateVerdict
from hil_forceps.control.gate.feedback import FeedbackMonitor
from hil_forceps.control.gate.limiter import AccelerationLimiter
from tests.fault_campaign.defects.table import around, defect
from tests.fault_campaign.schedule import Kind

MAKERS = ("odrive", "cia402", "moteus", "mit", "dynamixel", "vesc")


def _with(patch: pytest.MonkeyPatch, owner: Any, **numbers: Any) -> None:
    """Have what is made with other numbers."""
    init = owner.__init__

    def made(self: Any, *arguments: Any, **named: Any) -> None:
        init(self, *arguments, **named)
        for name, value in numbers.items():
            setattr(self, name, value)

    patch.setattr(owner, "__init__", made)


@defect("limits", "gate")
def gate_lets_all_pass(patch: pytest.MonkeyPatch) -> None:
    """Whatever is requested passes."""

    def step(_: Any, _limiter: Any, motion: Any, requested: float, _dt_s: float, _bounds: Any) -> Any:
        return (requested, motion[1], 0.0), GateVerdict.PASSED

    around(patch, AccelerationLimiter, "step", step)


@defect("limits")
def gate_without_bounds(patch: pytest.MonkeyPatch) -> None:
    """Its bounds are those of another forceps."""
    _with(patch, Gate, _bounds=(-10.0, 10.0))


@defect("limits", "gate")
def gate_without_speed(patch: pytest.MonkeyPatch) -> None:
    """It doesn't bound the speed."""
    _with(patch, AccelerationLimiter, _speed=1e6)


@defect("gate")
def gate_without_acceleration(patch: pytest.MonkeyPatch) -> None:
    """It doesn't bound the acceleration."""
    _with(patch, AccelerationLimiter, _acceleration=1e9)


@defect("gate", among=(Kind.STOPPED, Kind.DROP, Kind.STALLED_ESTIMATOR))
def gate_never_closes(patch: pytest.MonkeyPatch) -> None:
    """However long it had no output, it goes on."""
    _with(patch, Gate, _max_gap_ns=1 << 62)


@defect("gate", among=(Kind.LATE_TICK, Kind.STOPPED, Kind.STALLED_ESTIMATOR))
def gate_catches_up_at_once(patch: pytest.MonkeyPatch) -> None:
    """Behind a late tick the reference goes as far as it would have gone without."""
    _with(patch, Gate, _max_step_ns=1 << 62)


@defect("gate", "limits")
def gate_counts_in_microseconds(patch: pytest.MonkeyPatch) -> None:
    """It takes its time for a thousand times longer than it is."""

    def step(old: Any, limiter: Any, motion: Any, requested: float, dt_s: float, bounds: Any) -> Any:
        return old(limiter, motion, requested, 1e3 * dt_s, bounds)

    around(patch, AccelerationLimiter, "step", step)


@defect("kick", profiles=MAKERS)
def gate_opens_elsewhere(patch: pytest.MonkeyPatch) -> None:
    """It opens at the middle of its bounds, not at the measured angle."""

    def opened(old: Any, gate: Any, now_ns: int) -> None:
        measured, gate._theta_rad = gate._theta_rad, 0.5 * sum(gate._bounds)
        old(gate, now_ns)
        gate._theta_rad = measured

    around(patch, Gate, "open", opened)


@defect("implausible", profiles=("native", "native_fd"), among=(Kind.ENCODER_JUMP,))
def gate_sees_no_jump(patch: pytest.MonkeyPatch) -> None:
    """Samples go past the checks of the feedback."""
    around(patch, FeedbackMonitor, "see", lambda *_: False)


@defect("kick", profiles=MAKERS)
def holds_another_angle(patch: pytest.MonkeyPatch) -> None:
    """Before the drive follows, the reference isn't the measured angle."""

    def hold(old: Any, line: Any, newest: Any, now_ns: int) -> Any:
        made = old(line, newest, now_ns)
        raw = made.reference_raw
        return made if raw is None else made._replace(reference_raw=raw - (1 << 17))

    around(patch, Pipeline, "_hold", hold)


@defect("stale", among=(Kind.STOPPED, Kind.STALLED_ESTIMATOR, Kind.LATE_TICK, Kind.DELAY))
def any_sample_is_fresh(patch: pytest.MonkeyPatch) -> None:
    """No sample is too old."""

    def reference(old: Any, line: Any, now_ns: int) -> Any:
        line._max_age_ns = line.gate._max_age_ns = 1 << 62
        return old(line, now_ns)

    around(patch, Pipeline, "reference", reference)


@defect("stale")
def a_sample_serves_twice(patch: pytest.MonkeyPatch) -> None:
    """A sample that a reference was computed from counts as new once more."""

    def reference(old: Any, line: Any, now_ns: int) -> Any:
        made = old(line, now_ns)
        line._is_new = line.gate._is_fresh = line.newest is not None
        return made

    around(patch, Pipeline, "reference", reference)


@defect("stale", profiles=("odrive", "cia402", "moteus", "mit", "vesc"), among=(Kind.CLOCK_STEP,))
def age_counts_from_a_clock_set_back(patch: pytest.MonkeyPatch) -> None:
    """A sample is taken for no older than its stamp says, though it arrived long before."""

    def reference(old: Any, line: Any, now_ns: int) -> Any:
        newest = line.newest
        if newest is not None and line._same_clock:
            line.newest = newest._replace(received_ns=max(newest.received_ns, newest.stamp_ns))
            line.gate._received_ns = line.newest.received_ns
        return old(line, now_ns)

    around(patch, Pipeline, "reference", reference)


@defect("recorded", profiles=("native", "native_fd"))
def old_samples_are_estimated_again(patch: pytest.MonkeyPatch) -> None:
    """The same sample is fed twice, and recorded twice."""

    def feed(old: Any, line: Any, raw: Any) -> bool:
        fed = bool(old(line, raw))
        return fed or raw.stamp_ns > 0

    around(patch, Pipeline, "feed", feed)

    def receive(old: Any, axis: Any, received: Any) -> None:
        take = axis.drive.take_samples

        def twice() -> list[Any]:
            samples = take()
            return [*samples, *samples[-1:]]

        axis.drive.take_samples = twice
        try:
            old(axis, received)
        finally:
            axis.drive.take_samples = take

    around(patch, Axis, "receive", receive)
