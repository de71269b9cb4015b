"""The one loop: from the link through the pipelines of its axes back to the link, on an absolute schedule.

The course of a run is `hil_forceps.bridge.course`. An exception out of the loop (a fault of this program) sends an
emergency stop to every drive before it passes on.

Each tick drains the link and feeds every sample of every axis; then each axis sends at most one reference and what its
drive's state machine has to say, in the order of the axes. What the link does not take at once is dropped and counted,
never kept for later. Nothing here logs or waits, and garbage collection rests while the loop runs (a tick makes no
cycles). Ticks are due at whole periods plus the phase on the host's clock; a tick that ends after the next was due is
an overrun, and the periods it ran over are skipped.

Of several axes none gets torque before all drives are ready, and none moves before all are operational. Where one
fails, the others are stopped as well. Axes that are to go on without the others don't wait for them either.
"""

import gc
import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Final

from firmware_protocol.frames import Frame
from hil_forceps.bridge.axis import Axis
from hil_forceps.bridge.live.sink import LiveSink
from hil_forceps.bridge.ports import Clock, Link, SendResult
from hil_forceps.bridge.results import ServiceConfig, ServiceResult, Stage, StopReason, Telemetry
from hil_forceps.bridge.statistics import LoopStatistics, make_loop_statistics
from hil_forceps.bridge.teleoperation.udp_server import UdpReferences
from hil_forceps.data.recording.writer import RECENT_NS

MAX_RECENT_TICKS: Final = 1 << 16
# Looked up once: members of an Enum cost as much as a call when asked for by their class.
_SENT: Final = SendResult.SENT


class Service:
    """One run against one drive or several on one link; `run` once."""

    def __init__(
        self,
        link: Link,
        clock: Clock,
        axes: Sequence[Axis],
        config: ServiceConfig,
        stop_requested: Callable[[], bool] = lambda: False,
        telemetry: Callable[[Telemetry], None] | None = None,
        *,
        go_on: bool = False,
        live: LiveSink | None = None,
        remote: UdpReferences | None = None,
    ) -> None:
        """`config`: of the loop; the axes have their own, with the same period.

        `stop_requested` is asked once a tick (set the flag in a signal handler). `telemetry` is called after a tick's
        work, `config.telemetry_period_ns` apart, with each axis in turn, and takes its time from the slack. `go_on`:
        the other axes do where one fails. `live`: a page that shows the run, with a part for each axis.
        `remote`: whoever sends references to the axes from outside, and gets estimates.
        ValueError for no axis or a phase that isn't within the period.
        """
        if config.period_ns <= 0 or not 0 <= config.phase_ns < config.period_ns:
            raise ValueError(f"phase {config.phase_ns} ns must lie within the period of {config.period_ns} ns")
        if not axes:
            raise ValueError("a service has one axis at least")
        self.statistics: LoopStatistics = make_loop_statistics()
        recent_ticks = min(RECENT_NS // config.period_ns + 1, MAX_RECENT_TICKS)
        self.lateness: deque[tuple[int, int]] = deque(maxlen=recent_ticks)  # time of each tick, and its lateness
        self._link = link
        self._clock = clock
        self._axes = tuple(axes)
        self._config = config
        self._stop_requested = stop_requested
        self._telemetry = telemetry
        self._live = live
        self._remote = remote
        self._is_steered = live is not None or remote is not None
        self._stops_all = len(self._axes) > 1 and not go_on
        for axis in self._axes:
            axis.pipeline.is_waiting = self._stops_all
        self.counters = dict.fromkeys(("ticks", "overruns", "skipped_periods", "frames_sent", "queue_full"), 0)
        self._has_run = False
        self._bus_down = False
        self._next_telemetry_ns = 0
        self._looked_at = 0

    def run(self) -> tuple[ServiceResult, ...]:
        """Run until something ends every axis; return how each ended.

        The link and the recorders stay open and belong to the caller.
        """
        if self._has_run:
            raise ValueError("a service runs once")
        self._has_run = True
        for axis in self._axes:
            axis.pipeline.warm_up()
        now_ns = self._clock.now_ns()
        for axis in self._axes:
            axis.begin(now_ns, self._stop_requested, self._may_enable)
        try:
            with _no_collection():
                self._loop(now_ns)
            self._show(now_ns, 0, is_last=True)
        except BaseException:
            for axis in self._axes:
                self._link.send(axis.drive.estop_frame())
            raise
        timing = self.statistics.summary()
        return tuple(axis.result(self.counters, self._link.counters, timing) for axis in self._axes)

    def _loop(self, now_ns: int) -> None:
        period_ns, phase_ns = self._config.period_ns, self._config.phase_ns
        due_ns = ((now_ns - phase_ns) // period_ns + 1) * period_ns + phase_ns
        before_ns: int | None = None
        axes, clock, tick = self._axes, self._clock, self._tick
        add_lateness, add_period = self.statistics.lateness.add, self.statistics.period.add
        keep = self.lateness.append
        sleep_until_ns, clock_ns = clock.sleep_until_ns, clock.now_ns
        while not (axes[0].has_ended and all(axis.has_ended for axis in axes)):
            sleep_until_ns(due_ns)
            now_ns = clock_ns()
            late_ns = now_ns - due_ns
            add_lateness(late_ns)
            keep((now_ns, late_ns))
            if before_ns is not None:
                add_period(now_ns - before_ns)
            before_ns = now_ns
            self.counters["ticks"] += 1
            tick(now_ns)
            if self._live is not None:
                self._show(now_ns, late_ns)
            due_ns += period_ns
            late_ns = clock_ns() - due_ns
            if late_ns >= 0:
                skipped = late_ns // period_ns + 1
                self.counters["overruns"] += 1
                self.counters["skipped_periods"] += skipped
                due_ns += skipped * period_ns

    def _tick(self, now_ns: int) -> None:
        received = self._link.receive()
        for axis in self._axes:
            axis.receive(received)
        clock_ns = self._clock.now_ns
        now_ns = clock_ns()  # estimators take their time: a sample that has become too old by it is too old
        if not self._link.is_up():
            self._bus_down = True
        if self._is_steered:
            self._listen(now_ns)
        for axis in self._axes:
            if not axis.has_ended:
                axis.tick(now_ns, self._send, clock_ns)
                if self._bus_down and not axis.has_ended:
                    axis.course.bus_is_down()
        if self._stops_all:
            self._stop_others(now_ns)
            self._begin_together()
        if self._remote is not None:
            self._remote.reply(self._axes)
        if now_ns >= self._next_telemetry_ns:
            self._tell(now_ns)

    def _tell(self, now_ns: int) -> None:
        self._next_telemetry_ns = now_ns + self._config.telemetry_period_ns
        if self._telemetry is not None:
            self._looked_at = (self._looked_at + 1) % len(self._axes)
            self._telemetry(self._look(self._axes[self._looked_at]))

    def _stop_others(self, now_ns: int) -> None:
        failed = next((axis for axis in self._axes if axis.has_failed), None)
        if failed is None:
            return
        for axis in self._axes:
            if axis.course.reason is None:
                words = f"stopped, because axis {failed.name} ended: {failed.course.message}"
                axis.course.stop(StopReason.OTHER_AXIS, words, now_ns)

    def _may_enable(self) -> bool:
        """Tell whether drives may get torque: without `go_on`, once all are ready."""
        return not self._stops_all or all(axis.is_ready for axis in self._axes)

    def _begin_together(self) -> None:
        """Let the axes follow their trajectories, once all are operational."""
        if self._axes[0].pipeline.is_waiting and all(axis.course.stage is Stage.RUNNING for axis in self._axes):
            for axis in self._axes:
                axis.pipeline.is_waiting = False

    def _listen(self, now_ns: int) -> None:
        """Take references from outside, and do what an operator at the page asks for."""
        if self._remote is not None:
            self._remote.receive(now_ns)
        live = self._live
        if live is None:
            return
        if live.stop_asked():
            for axis in self._axes:
                axis.emergency_stop(now_ns, self._send)
        if live.clear_asked():
            for axis in self._axes:
                axis.course.clear(now_ns)

    def _show(self, now_ns: int, late_ns: int, *, is_last: bool = False) -> None:
        if self._live is not None:
            self._live.tick(now_ns, late_ns, self._axes, self.counters, self._link.counters, is_last=is_last)

    def _send(self, frame: Frame) -> SendResult:
        result = self._link.send(frame)
        if result is _SENT:
            self.counters["frames_sent"] += 1
        elif result is SendResult.QUEUE_FULL:
            self.counters["queue_full"] += 1
        else:
            self._bus_down = True
        return result

    def _look(self, axis: Axis) -> Telemetry:
        pipeline = axis.pipeline
        newest, zero_ns = pipeline.newest, pipeline.zero_ns
        time_s = math.nan if newest is None or zero_ns is None else (newest.stamp_ns - zero_ns) * 1e-9
        return Telemetry(
            stage=axis.course.stage,
            time_s=time_s,
            theta_m_rad=pipeline.sample.theta_m_rad,
            reference_rad=axis.reference_rad,
            tau_w_N_m=pipeline.estimate.tau_w_N_m,
            elongation_m=pipeline.estimate.elongation_m,
            frames_sent=self.counters["frames_sent"],
            frames_received=axis.course.frames_received,
            overruns=self.counters["overruns"],
            axis=axis.name,
        )


@contextmanager
def _no_collection() -> Iterator[None]:
    """Keep the cyclic collector still: one full collection takes longer than several ticks."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()
