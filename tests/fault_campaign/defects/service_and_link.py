"""Defects of the service, of a run's course, and of the link."""

import math
from typing import Any

import pytest

from hil_forceps.bench.session import SessionResult
from hil_forceps.bridge.axis import Axis
from hil_forceps.bridge.course import Course
from hil_forceps.bridge.links.can_link import VirtualTimeLink
from hil_forceps.bridge.ports import SendResult
from hil_forceps.bridge.results import ServiceResult, Stage, StopReason
from hil_forceps.bridge.service import Service
from tests.fault_campaign.defects.table import around, defect
from tests.fault_campaign.schedule import Kind
from virtual_bus.bus.host_node import HostNode


@defect("stale")
def age_is_judged_before_the_estimate(patch: pytest.MonkeyPatch) -> None:
    """A tick goes by the time at its beginning, however long the estimator took."""

    class Still:
        def __init__(self, clock: Any, now_ns: int) -> None:
            self.now_ns, self.sleep_until_ns = lambda: now_ns, clock.sleep_until_ns

    def tick(old: Any, service: Any, now_ns: int) -> None:
        clock, service._clock = service._clock, Still(service._clock, now_ns)
        try:
            old(service, now_ns)
        finally:
            service._clock = clock

    around(patch, Service, "_tick", tick)


@defect("burst", among=(Kind.FULL_QUEUE,))
def what_was_refused_is_sent_later(patch: pytest.MonkeyPatch) -> None:
    """Frames that found the queue full are kept and sent with the next that finds room."""

    def send(old: Any, service: Any, frame: Any) -> Any:
        kept = service.__dict__.setdefault("kept", [])
        result = old(service, frame)
        if result is SendResult.QUEUE_FULL:
            kept.append(frame)
        elif result is SendResult.SENT:
            while kept and old(service, kept[0]) is SendResult.SENT:
                del kept[0]
        return result

    around(patch, Service, "_send", send)


@defect("burst")
def a_tick_sends_two_references(patch: pytest.MonkeyPatch) -> None:
    """Each tick computes a second reference from the same sample."""

    def send(old: Any, axis: Any, now_ns: int, *more: Any) -> None:
        old(axis, now_ns, *more)
        axis.pipeline._is_new = axis.pipeline.gate._is_fresh = axis.pipeline.newest is not None
        old(axis, now_ns + 1, *more)

    around(patch, Axis, "_send_reference", send)


@defect("end")
def forgets_to_disable(patch: pytest.MonkeyPatch) -> None:
    """The end of a run doesn't ask the drive for anything."""

    def stop(old: Any, course: Any, *why: Any) -> None:
        disable = course._host.disable
        course._host.disable = lambda: None
        old(course, *why)
        course._host.disable = disable

    around(patch, Course, "_stop", stop)


@defect("end")
def claims_the_drive_disabled(patch: pytest.MonkeyPatch) -> None:
    """The run ends as soon as it has asked, and says that the drive has no torque."""

    def stopping(_: Any, course: Any, _now_ns: int) -> None:
        course.drive_disabled, course.stage = True, Stage.ENDED

    around(patch, Course, "_stopping", stopping)


@defect("end")
def never_has_enough(patch: pytest.MonkeyPatch) -> None:
    """No run ends by itself."""
    around(patch, Course, "_enough", lambda _old, _course: None)


@defect("end")
def trouble_counts_as_success(patch: pytest.MonkeyPatch) -> None:
    """A drive that was lost ends the run as completed."""
    around(patch, Course, "_trouble", lambda _old, _course, _now_ns: (StopReason.COMPLETED, "completed"))


@defect("end")
def ends_too_early(patch: pytest.MonkeyPatch) -> None:
    """The duration is taken for microseconds in places."""

    def enough(old: Any, course: Any) -> Any:
        whole, course._config = course._config, course._config._replace(duration_ns=course._config.duration_ns // 4)
        try:
            return old(course)
        finally:
            course._config = whole

    around(patch, Course, "_enough", enough)


@defect("end", among=(Kind.FULL_DISK,))
def a_full_disk_is_no_reason(patch: pytest.MonkeyPatch) -> None:
    """Failures of files don't reach the exit code."""
    patch.setattr(SessionResult, "failures", property(lambda _: []))


@defect("end", among=(Kind.BUS_GONE, Kind.BUS_OFF, Kind.BROWN_OUT, Kind.DROP))
def disabled_or_not_is_well(patch: pytest.MonkeyPatch) -> None:
    """A run counts as good whatever the drive said at its end."""
    patch.setattr(ServiceResult, "ok", property(lambda result: result.reason is StopReason.COMPLETED))


@defect("end")
def any_reason_is_well(patch: pytest.MonkeyPatch) -> None:
    """A run counts as good whatever ended it, as long as the drive is disabled."""
    patch.setattr(ServiceResult, "ok", property(lambda result: result.drive_disabled))


@defect("end", among=(Kind.FULL_QUEUE,))
def a_full_queue_ends_the_program(patch: pytest.MonkeyPatch) -> None:
    """A frame that isn't taken raises."""

    def send(old: Any, link: Any, frame: Any) -> Any:
        result = old(link, frame)
        if result is SendResult.QUEUE_FULL:
            raise RuntimeError("no room")
        return result

    around(patch, VirtualTimeLink, "send", send)


@defect("burst", among=(Kind.FULL_QUEUE,))
def link_keeps_what_was_refused(patch: pytest.MonkeyPatch) -> None:
    """The link has a queue of its own behind a full one."""

    def send(old: Any, link: Any, frame: Any) -> Any:
        kept = link.__dict__.setdefault("kept", [])
        while kept and old(link, kept[0]) is SendResult.SENT:
            del kept[0]
        result = old(link, frame)
        if result is SendResult.QUEUE_FULL:
            kept.append(frame)
        return result

    around(patch, VirtualTimeLink, "send", send)


@defect("stale", among=(Kind.FULL_QUEUE,))
def link_says_sent_whatever_happened(patch: pytest.MonkeyPatch) -> None:
    """A frame that wasn't taken is told as sent."""

    def send(old: Any, link: Any, frame: Any) -> Any:
        old(link, frame)
        return SendResult.SENT

    around(patch, VirtualTimeLink, "send", send)


@defect("end", among=(Kind.FULL_DISK,))
def link_stamps_nothing(patch: pytest.MonkeyPatch) -> None:
    """All frames have the same time of arrival."""

    def receive(old: Any, link: Any) -> Any:
        return [(1, frame) for _, frame in old(link)]

    around(patch, VirtualTimeLink, "receive", receive)


@defect("limits", "kick")
def references_are_in_degrees(patch: pytest.MonkeyPatch) -> None:
    """Behind the gate somebody converts once more."""

    def send(old: Any, axis: Any, *more: Any) -> None:
        setpoint = axis.drive.setpoint
        axis.drive.setpoint = lambda raw: setpoint(round(math.degrees(raw)))
        try:
            old(axis, *more)
        finally:
            axis.drive.setpoint = setpoint

    around(patch, Axis, "_send_reference", send)


@defect("wire burst", profiles=("odrive",), among=(Kind.CURRENT_STUCK, Kind.FULL_DISK))
def adapter_bundles_frames(patch: pytest.MonkeyPatch) -> None:
    """The adapter keeps frames and sends them all together, every 25 ms."""

    def send(old: Any, node: Any, frame: Any, now_ns: int) -> int:
        return int(old(node, frame, now_ns // 25_000_000 * 25_000_000 + 25_000_000))

    around(patch, HostNode, "send", send)
