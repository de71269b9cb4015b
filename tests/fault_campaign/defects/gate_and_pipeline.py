"""Defects of the gate and of the pipeline."""

import math
from typing import Any

import pytest

from hil_forceps.bridge.axis import Axis
from hil_forceps.bridge.pipeline import NOWHERE_NS, Pipeline
from hil_forceps.control.gate import Gate, GateState, GateVerdict
from tests.fault_campaign.defects.table import around, defect
from tests.fault_campaign.schedule import Kind

MAKERS = ("odrive", "cia402", "moteus", "mit", "dynamixel", "vesc")


def _gate_with(patch: pytest.MonkeyPatch, **numbers: float) -> None:
    def init(old: Any, gate: Any, *arguments: Any) -> None:
        old(gate, *arguments)
        for name, value in numbers.items():
            setattr(gate, name, value)

    around(patch, Gate, "__init__", init)


@defect("limits", "gate")
def gate_lets_all_pass(patch: pytest.MonkeyPatch) -> None:
    """Whatever is requested passes."""

    def limit(_: Any, _gate: Any, _position: float, speed: float, requested: float, _dt: float, now_ns: int) -> Any:
        return GateState(True, True, requested, speed, now_ns), requested, GateVerdict.PASSED

    around(patch, Gate, "_limit", limit)


@defect("limits")
def gate_without_bounds(patch: pytest.MonkeyPatch) -> None:
    """Its bounds are those of another forceps."""
    _gate_with(patch, _low=-10.0, _high=10.0)


@defect("limits", "gate")
def gate_without_speed(patch: pytest.MonkeyPatch) -> None:
    """It doesn't bound the speed."""
    _gate_with(patch, _speed=1e6)


@defect("gate")
def gate_without_acceleration(patch: pytest.MonkeyPatch) -> None:
    """It doesn't bound the acceleration."""
    _gate_with(patch, _acceleration=1e9)


@defect("gate", among=(Kind.STOPPED, Kind.DROP, Kind.STALLED_ESTIMATOR))
def gate_never_closes(patch: pytest.MonkeyPatch) -> None:
    """However long it had no output, it goes on."""
    _gate_with(patch, _max_gap_ns=1 << 62)


@defect("gate", "limits")
def gate_counts_in_microseconds(patch: pytest.MonkeyPatch) -> None:
    """It takes its time for a thousand times longer than it is."""

    def limit(old: Any, gate: Any, position: float, speed: float, requested: float, dt_s: float, now_ns: int) -> Any:
        return old(gate, position, speed, requested, 1e3 * dt_s, now_ns)

    around(patch, Gate, "_limit", limit)


@defect("kick", profiles=MAKERS)
def gate_opens_elsewhere(patch: pytest.MonkeyPatch) -> None:
    """It opens at the middle of its bounds, not at the measured angle."""

    def opened(old: Any, gate: Any, _theta_m_rad: float, now_ns: int) -> GateState:
        middle: GateState = old(gate, 0.5 * (gate._low + gate._high), now_ns)
        return middle

    around(patch, Gate, "open", opened)


@defect("kick", profiles=MAKERS)
def holds_another_angle(patch: pytest.MonkeyPatch) -> None:
    """Before the drive follows, the reference isn't the measured angle but where the trajectory begins, and more."""

    def hold(_: Any, line: Any, newest: Any, now_ns: int) -> Any:
        line._gate_state = line._gate.open(line.sample.theta_m_rad - 0.05, now_ns)
        return line._through_gate(newest, NOWHERE_NS, now_ns, math.nan, 0.0, line.sample.theta_m_rad - 0.05)

    around(patch, Pipeline, "_hold", hold)


@defect("stale", among=(Kind.STOPPED, Kind.STALLED_ESTIMATOR, Kind.LATE_TICK, Kind.DELAY))
def any_sample_is_fresh(patch: pytest.MonkeyPatch) -> None:
    """No sample is too old."""

    def reference(old: Any, line: Any, now_ns: int) -> Any:
        line._max_age_ns = 1 << 62
        return old(line, now_ns)

    around(patch, Pipeline, "reference", reference)


@defect("stale")
def a_sample_serves_twice(patch: pytest.MonkeyPatch) -> None:
    """A sample that a reference was computed from counts as new once more."""

    def reference(old: Any, line: Any, now_ns: int) -> Any:
        made = old(line, now_ns)
        line._is_new = line.newest is not None
        return made

    around(patch, Pipeline, "reference", reference)


@defect("stale", profiles=("odrive", "cia402", "moteus", "mit", "vesc"), among=(Kind.CLOCK_STEP,))
def age_counts_from_a_clock_set_back(patch: pytest.MonkeyPatch) -> None:
    """A sample is taken for no older than its stamp says, though it arrived long before."""

    def reference(old: Any, line: Any, now_ns: int) -> Any:
        newest = line.newest
        if newest is not None and line._same_clock:
            line.newest = newest._replace(received_ns=max(newest.received_ns, newest.stamp_ns))
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
