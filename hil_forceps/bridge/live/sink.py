"""What a service tells a live page, and what an operator there asks of it. Nothing here waits.

The same calls as a recorder's go for each axis to an `AxisSink`; `tick` follows each tick's work. A message costs the
loop about a microsecond. The status, with all counters, goes out five times a second.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Final

from firmware_protocol.host.samples import RawBench, RawSample
from firmware_protocol.scales import ANGLE_LSB_RAD, BENCH_TORQUE_LSB_N_M, CURRENT_LSB_A
from firmware_protocol.states import HostPhase
from hil_forceps.bridge.axis import Axis
from hil_forceps.bridge.live.topics import BENCH_TOPIC, REFERENCE_TOPIC, SAMPLE_TOPIC, STAGES, TICK_TOPIC, TOPICS
from hil_forceps.bridge.results import Stage
from hil_forceps.data.recording.writer import Reference
from hil_forceps.estimation.interface import Estimate, Sample
from hil_forceps.live.channel import STATUS_PERIOD_NS, Writer
from hil_forceps.live.description import AxisStatus
from hil_forceps.rig.plant import PlantParameters

_PACK_SAMPLE, _PACK_REFERENCE, _PACK_BENCH, _PACK_TICK = (topic.record.pack for topic in TOPICS)
_RUNNING: Final = Stage.RUNNING
_STAGE_CODES: Final = {stage: code for code, stage in enumerate(STAGES)}


class AxisSink:
    """Takes what a recorder takes, of one axis."""

    def __init__(self, writer: Writer, axis: int, plant: PlantParameters) -> None:
        self.theta_j_ref_rad = math.nan
        self._put = writer.put
        self._axis = axis
        self._plant = plant

    def sample(self, raw: RawSample, sample: Sample, estimate: Estimate) -> None:
        """Show one sample with what the estimator made of it."""
        sequence, stamp_ns, theta_m, current, state, fault, setpoint_sequence, received_ns = raw
        message = _PACK_SAMPLE(
            stamp_ns, received_ns, theta_m, sample[1], current * CURRENT_LSB_A, sample[2], *estimate,
            current, sequence, setpoint_sequence, state, fault,
        )  # fmt: skip
        self._put(SAMPLE_TOPIC, self._axis, message)

    def reference(self, reference: Reference, sent_ns: int, outcome: int, setpoint_sequence: int) -> None:
        """Show one tick's reference, whatever came of it."""
        tick_ns, stamp_ns, trajectory_ns, raw, theta_j_ref, elongation, requested, passed, verdict, sample = reference
        if math.isfinite(theta_j_ref):  # a tick without a new sample has none
            self.theta_j_ref_rad = theta_j_ref
        message = _PACK_REFERENCE(
            tick_ns, sent_ns, stamp_ns, trajectory_ns, raw or 0, theta_j_ref, elongation, requested, passed,
            verdict, outcome, sample, setpoint_sequence,
        )  # fmt: skip
        self._put(REFERENCE_TOPIC, self._axis, message)

    def bench(self, raw: RawBench) -> None:
        """Show one pair of bench values."""
        sequence, theta_j, tau_w, received_ns = raw
        message = _PACK_BENCH(
            received_ns, theta_j * ANGLE_LSB_RAD, tau_w * BENCH_TORQUE_LSB_N_M, theta_j, tau_w, sequence
        )
        self._put(BENCH_TOPIC, self._axis, message)

    def tick(self, now_ns: int, late_ns: int, axis: Axis, overruns: int) -> None:
        """Show one tick of the loop."""
        pipeline, plant = axis.pipeline, self._plant
        wound_m = plant.motor_pulley_radius_m * pipeline.sample.theta_m_rad
        theta_j_rad = (wound_m - pipeline.estimate.elongation_m) / plant.jaw_pulley_radius_m
        stage = axis.course.stage
        error_rad = self.theta_j_ref_rad - theta_j_rad if stage is _RUNNING else math.nan
        message = _PACK_TICK(
            now_ns, late_ns, axis.age_ns, theta_j_rad, error_rad, overruns & 0xFFFFFFFF, _STAGE_CODES[stage]
        )  # fmt: skip
        self._put(TICK_TOPIC, self._axis, message)


class LiveSink:
    """All axes of a service. `control`: what an operator at the page asks for counts."""

    def __init__(self, writer: Writer, plants: Sequence[PlantParameters], *, control: bool = False) -> None:
        self.axes = tuple(AxisSink(writer, place, plant) for place, plant in enumerate(plants))
        self.control = control
        self._writer = writer
        self._next_ns = 0
        self._clears = writer.clears_asked()

    def stop_asked(self) -> bool:
        """Tell whether an operator wants an emergency stop."""
        return self.control and self._writer.stop_asked()

    def clear_asked(self) -> bool:
        """Tell whether an operator has asked to clear it since the last call."""
        if not self.control or (clears := self._writer.clears_asked()) == self._clears:
            return False
        self._clears = clears
        return True

    def tick(
        self,
        now_ns: int,
        late_ns: int,
        axes: Sequence[Axis],
        counters: Mapping[str, int],
        link: Mapping[str, int],
        *,
        is_last: bool = False,
    ) -> None:
        """Show one tick, and now and then the status."""
        overruns = counters["overruns"]
        for sink, axis in zip(self.axes, axes, strict=True):
            sink.tick(now_ns, late_ns, axis, overruns)
        if is_last or now_ns >= self._next_ns:
            self._next_ns = now_ns + STATUS_PERIOD_NS
            self._writer.post(
                {
                    "axes": [_status(axis).as_data() for axis in axes],
                    "counters": {"loop": dict(counters), "link": dict(link)},
                }
            )


def _status(axis: Axis) -> AxisStatus:
    course, pipeline, drive = axis.course, axis.pipeline, axis.drive
    trip = pipeline.gate.trip
    state = drive.drive_state
    return AxisStatus(
        axis.name,
        course.stage.value,
        reason="" if course.reason is None else course.reason.value,
        message=course.message,
        drive="not heard yet" if state is None else state.name.lower(),
        fault=drive.fault_words() if drive.phase is HostPhase.FAULT else "",
        refusal=drive.refusal,
        gate=pipeline.gate.state.value,
        trip="" if trip is None else str(trip),
        counters={
            "run": {"references_sent": axis.references_sent, "frames_received": course.frames_received},
            "pipeline": dict(pipeline.counters),
            "gate": {verdict.value: count.references for verdict, count in pipeline.gate_tally.told().items()},
            "host": dict(drive.counters),
            "outside": {} if axis.outside is None else dict(axis.outside.counters),
        },
    )
