"""What a page is told: every topic of a service fits the channel, and comes out as it went in."""

import pytest

from hil_forceps.bridge.live.topics import LANES, PANELS, TOPICS, description_of
from hil_forceps.bridge.pipeline import VERDICT_NAMES
from hil_forceps.data.recording import format as recording
from hil_forceps.live.channel import PAYLOAD_BYTES
from hil_forceps.live.description import for_page, from_json, to_json

DESCRIBED = description_of("two <b>axes</b>", ("left", "right"), 123)


def test_a_description_comes_back_from_json() -> None:
    assert from_json(to_json(DESCRIBED)) == DESCRIBED


@pytest.mark.parametrize("text", ["", "[]", "{}", "[1,2,3,4,5,6]", '["t",[],[["/a"]],[],[],0]', "null"])
def test_other_texts_are_no_description(text: str) -> None:
    with pytest.raises(ValueError, match="no description"):
        from_json(text)


def test_the_topics_of_a_recording_are_the_same_live() -> None:
    for ours, theirs in zip(TOPICS, recording.TOPICS, strict=False):
        assert (ours.name, ours.schema_name, ours.schema) == (theirs.topic, theirs.schema, theirs.schema_text())
        assert ours.dtype == theirs.dtype
    assert all(topic.record.size <= PAYLOAD_BYTES for topic in TOPICS)


def test_cdr_wants_fields_in_order_of_falling_size() -> None:
    for topic in TOPICS:
        sizes = [topic.dtype[field.name].itemsize for field in topic.fields]
        assert sizes == sorted(sizes, reverse=True)


def test_what_is_drawn_is_there() -> None:
    fields = {topic.name: {field.name for field in topic.fields} for topic in TOPICS}
    for panel in PANELS:
        assert panel.title
        for trace in panel.traces:
            assert trace.field in fields[trace.topic]
    for lane in LANES:
        assert lane.field in fields[lane.topic]
    (gate,) = [lane for lane in LANES if lane.title == "gate"]
    assert {code for code, _ in gate.codes} == set(VERDICT_NAMES)


def test_the_page_gets_what_it_draws_and_no_more() -> None:
    told = for_page(DESCRIBED)
    assert [(each["topic"], each["axis"]) for each in told["streams"]][:3] == [
        ("/sample", 0), ("/sample", 1), ("/reference", 0),
    ]  # fmt: skip
    assert told["streams"][0]["fields"][0] == "received_ns"
    assert "theta_m_raw" not in told["streams"][0]["fields"]
    drawn = {trace.field for panel in PANELS for trace in panel.traces}
    assert len(drawn) >= 8
    assert drawn <= {field for each in told["streams"] for field in each["fields"]}
