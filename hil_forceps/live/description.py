"""Description of live data: topics with fixed messages, and the fields that a page draws.

Plain data, sent to the page's process as JSON. Names, titles and units are texts, never markup or code.
"""

import json
import struct
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

STRUCT_CODES = {"int64": "q", "float64": "d", "int32": "i", "uint32": "I", "uint8": "B"}


class Field(NamedTuple):
    """One number of a message."""

    type: str  # a key of `STRUCT_CODES`
    name: str


class Topic(NamedTuple):
    """One kind of message. `time` names the field with the host's time in ns that the page draws over."""

    name: str
    time: str
    fields: tuple[Field, ...]
    schema_name: str = ""
    schema: str = ""  # its ros2msg definition, for Foxglove

    @property
    def record(self) -> struct.Struct:
        """The message as a packed little-endian struct."""
        return struct.Struct("<" + "".join(STRUCT_CODES[field.type] for field in self.fields))

    @property
    def dtype(self) -> np.dtype[np.void]:
        """The message as a numpy type."""
        return np.dtype([(field.name, np.dtype(field.type).newbyteorder("<")) for field in self.fields])


class Trace(NamedTuple):
    """A field as a curve. `holds`: its value is held until the next, so that it is drawn as steps."""

    topic: str
    field: str
    label: str
    holds: bool = False


class Panel(NamedTuple):
    """Curves over one axis of values: `scale` times SI gives `unit`."""

    title: str
    unit: str
    scale: float
    traces: tuple[Trace, ...]


class Code(NamedTuple):
    """A value of a lane: its name and its level."""

    name: str
    level: str = "ok"  # ok, note, warn, bad, off


class Lane(NamedTuple):
    """A field with few values, drawn as a coloured band."""

    topic: str
    field: str
    title: str
    codes: tuple[tuple[int, Code], ...]


class Description(NamedTuple):
    """Everything that a page needs. A message belongs to an axis, by its index in `axes`."""

    title: str
    axes: tuple[str, ...]
    topics: tuple[Topic, ...]
    panels: tuple[Panel, ...]
    lanes: tuple[Lane, ...]
    start_ns: int  # origin of the page's time, host's clock

    def shown(self, topic: Topic) -> tuple[str, ...]:
        """Return the fields of a topic for the page: its time first, then the drawn fields, each once."""
        drawn = [trace.field for panel in self.panels for trace in panel.traces if trace.topic == topic.name]
        drawn += [lane.field for lane in self.lanes if lane.topic == topic.name]
        return (topic.time, *(name for name in dict.fromkeys(drawn) if name != topic.time))


class AxisStatus(NamedTuple):
    """Status of an axis besides its messages; texts for people, may be empty."""

    name: str
    stage: str
    reason: str = ""
    message: str = ""
    drive: str = ""
    fault: str = ""
    refusal: str = ""
    gate: str = ""
    trip: str = ""
    counters: Mapping[str, Mapping[str, Any]] = MappingProxyType({})

    def as_data(self) -> dict[str, Any]:
        """Return the status as data for the page."""
        return {**self._asdict(), "counters": dict(self.counters)}


def to_json(description: Description) -> str:
    """Return a description as one line of JSON."""
    return json.dumps(description)


def from_json(text: str) -> Description:
    """Return the description that `to_json` wrote; ValueError for anything else."""
    try:
        title, axes, topics, panels, lanes, start_ns = json.loads(text)
        return Description(
            title,
            tuple(axes),
            tuple(
                Topic(name, time, tuple(Field(*each) for each in fields), *more) for name, time, fields, *more in topics
            ),
            tuple(
                Panel(name, unit, scale, tuple(Trace(*each) for each in traces)) for name, unit, scale, traces in panels
            ),
            tuple(
                Lane(topic, field, title, tuple((int(key), Code(*code)) for key, code in codes))
                for topic, field, title, codes in lanes
            ),
            int(start_ns),
        )
    except (TypeError, ValueError) as error:
        raise ValueError(f"no description of live data: {error}") from error


def for_page(description: Description) -> dict[str, Any]:
    """Return the description for the page as plain data: every stream with its fields, panels and lanes."""
    return {
        "title": description.title,
        "axes": list(description.axes),
        "streams": [
            {"topic": topic.name, "axis": axis, "fields": list(description.shown(topic))}
            for topic in description.topics
            for axis in range(len(description.axes))
        ],
        "panels": [
            {**panel._asdict(), "traces": [trace._asdict() for trace in panel.traces]} for panel in description.panels
        ],
        "lanes": [
            {**lane._asdict(), "codes": {str(code): named._asdict() for code, named in lane.codes}}
            for lane in description.lanes
        ],
    }
