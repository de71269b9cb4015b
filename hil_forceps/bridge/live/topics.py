"""What a live page gets of a service: the topics of a recording, and one more for each tick of the loop."""

import math
from typing import Final

from hil_forceps.bridge.pipeline import VERDICT_NAMES
from hil_forceps.bridge.results import Stage
from hil_forceps.data.recording import format as recording
from hil_forceps.live.description import Code, Description, Field, Lane, Panel, Topic, Trace

SAMPLE_TOPIC: Final = 0
REFERENCE_TOPIC: Final = 1
BENCH_TOPIC: Final = 2
TICK_TOPIC: Final = 3

STAGES: Final = tuple(Stage)
_DEG: Final = math.degrees(1.0)

_TICK_FIELDS: Final = (
    recording.Field("int64", "tick_ns", "host's clock"),
    recording.Field("int64", "late_ns", "how much later than due the tick began"),
    recording.Field("int64", "age_ns", "from the sample to the reference made of it, of the last that was sent"),
    recording.Field("float64", "theta_j_estimate_rad", "jaw angle by motor angle and estimated elongation"),
    recording.Field("float64", "jaw_error_rad", "wanted jaw angle less the estimated one"),
    recording.Field("uint32", "overruns", "ticks so far that ended after the next was due"),
    recording.Field("uint8", "stage", "0 connecting, 1 enabling, 2 running, 3 stopping, 4 stopped, 5 ended"),
)


def _topic(topic: recording.Topic, time: str) -> Topic:
    fields = tuple(Field(field.type, field.name) for field in topic.fields)
    return Topic(topic.topic, time, fields, topic.schema, topic.schema_text())


TICK: Final = recording.Topic(4, "/tick", "hil_forceps/msg/Tick", _TICK_FIELDS)
TOPICS: Final = (
    _topic(recording.SAMPLE, "received_ns"),
    _topic(recording.REFERENCE, "tick_ns"),
    _topic(recording.BENCH, "received_ns"),
    _topic(TICK, "tick_ns"),
)

PANELS: Final = (
    Panel(
        "Motor angle θ_m",
        "°",
        _DEG,
        (
            Trace("/reference", "passed_rad", "θ_m ref, passed", holds=True),
            Trace("/sample", "theta_m_rad", "θ_m"),
            Trace("/reference", "requested_rad", "requested", holds=True),
        ),
    ),
    Panel(
        "Jaw angle θ_j",
        "°",
        _DEG,
        (
            Trace("/reference", "theta_j_ref_rad", "θ_j ref", holds=True),
            Trace("/tick", "theta_j_estimate_rad", "θ_j estimated"),
            Trace("/bench", "theta_j_rad", "θ_j measured"),
        ),
    ),
    Panel("Jaw error", "°", _DEG, (Trace("/tick", "jaw_error_rad", "θ_j ref − estimated"),)),
    Panel(
        "Reaction torque τ_w",
        "mN m",
        1e3,
        (
            Trace("/sample", "tau_w_estimate_N_m", "τ_w estimated"),
            Trace("/bench", "tau_w_N_m", "τ_w measured"),
        ),
    ),
    Panel("Motor current", "A", 1.0, (Trace("/sample", "current_A", "i", holds=True),)),
    Panel("Wire elongation", "µm", 1e6, (Trace("/sample", "elongation_estimate_m", "x estimated"),)),
    Panel(
        "Loop",
        "µs",
        1e-3,
        (Trace("/tick", "age_ns", "sample to reference"), Trace("/tick", "late_ns", "tick late")),
    ),
)

_STAGE_LEVELS: Final = {Stage.RUNNING: "ok", Stage.ENABLING: "note", Stage.STOPPING: "warn", Stage.STOPPED: "bad"}
_STATES: Final = (("disabled", "off"), ("armed", "note"), ("operational", "ok"), ("fault", "bad"))


def _verdict_level(name: str) -> str:
    if name.startswith(("PASSED", "OPENED")):
        return "ok"
    if name.startswith("NOTHING"):
        return "off"
    return "warn" if name.startswith(("LIMITED", "STALE", "FROZEN")) else "bad"


LANES: Final = (
    Lane(
        "/tick",
        "stage",
        "run",
        tuple((place, Code(stage.value, _STAGE_LEVELS.get(stage, "off"))) for place, stage in enumerate(STAGES)),
    ),
    Lane("/sample", "state", "drive", tuple((place, Code(*named)) for place, named in enumerate(_STATES))),
    Lane(
        "/reference",
        "verdict",
        "gate",
        tuple(
            (code, Code(name.lower().replace("_", " "), _verdict_level(name))) for code, name in VERDICT_NAMES.items()
        ),
    ),
)


def description_of(title: str, axes: tuple[str, ...], start_ns: int) -> Description:
    """Return what a page is told of a service; a single axis has the empty name."""
    return Description(title, axes, TOPICS, PANELS, LANES, start_ns)
