"""What a client gets: every row where it keeps up, else an envelope with every peak, and counts of the rest."""

import json
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from hil_forceps.live.channel import SLOT
from hil_forceps.live.description import Description, Field, Panel, Topic, Trace
from hil_forceps.live.history import ENVELOPE_PAIRS, HISTORY_S, MAX_ROWS_PER_FRAME, Cursor, History, envelope

S = 1_000_000_000
DESCRIPTION = Description(
    "test",
    ("left", "right"),
    (
        Topic("/a", "t_ns", (Field("int64", "t_ns"), Field("float64", "x"), Field("uint8", "unused"))),
        Topic("/b", "t_ns", (Field("int64", "t_ns"), Field("int32", "y"))),
    ),
    (Panel("p", "m", 1.0, (Trace("/a", "x", "x"), Trace("/b", "y", "y"))),),
    (),
    5 * S,
)
LEFT_A, RIGHT_A, LEFT_B, RIGHT_B = range(4)


def slots(topic: int, axis: int, rows: list[tuple[float, ...]], size: int | None = None) -> NDArray[np.void]:
    """Return slots as they come out of the channel."""
    record = DESCRIPTION.topics[topic].record if topic < 2 else struct.Struct("<q")
    made = np.zeros(len(rows), SLOT)
    for place, row in enumerate(rows):
        data = record.pack(*row)
        made[place] = (place + 1, 0, topic, axis, len(data) if size is None else size, data.ljust(80, b"\0"))
    return made


def ticks(first: int, count: int, step_ns: int = S // 1000) -> NDArray[np.void]:
    return slots(0, 0, [(5 * S + k * step_ns, float(k), 7) for k in range(first, first + count)])


def parsed(frame: bytes | None) -> tuple[dict[str, Any], dict[int, NDArray[np.float64]]]:
    assert frame is not None
    kind, length = struct.unpack_from("<II", frame)
    assert kind == 1
    assert (8 + length) % 8 == 0
    head: dict[str, Any] = json.loads(frame[8 : 8 + length])
    at, found = 8 + length, {}
    for part in head["parts"]:
        width = 2
        found[part["stream"]] = np.frombuffer(frame, "<f8", width * part["rows"], at).reshape(width, -1)
        at += 8 * width * part["rows"]
    assert at == len(frame)
    return head, found


def all_of(cursor: Cursor) -> dict[int, NDArray[np.float64]]:
    """Return every row that a client gets until there is nothing new."""
    found: dict[int, list[NDArray[np.float64]]] = {}
    while (frame := cursor.frame()) is not None:
        for stream, columns in parsed(frame)[1].items():
            found.setdefault(stream, []).append(columns)
    return {stream: np.concatenate(columns, axis=1) for stream, columns in found.items()}


def test_messages_go_to_their_streams_in_seconds_since_the_start() -> None:
    history = History(DESCRIPTION)
    history.add(slots(0, 1, [(6 * S, 2.5, 9)]))
    history.add(slots(1, 0, [(5 * S + S // 2, -3)]))
    _, found = parsed(Cursor(history).frame())
    assert {stream: columns[:, 0].tolist() for stream, columns in found.items()} == {
        RIGHT_A: [1.0, 2.5],
        LEFT_B: [0.5, -3.0],
    }


def test_a_client_that_keeps_up_gets_every_row_once() -> None:
    history = History(DESCRIPTION)
    cursor, seen = Cursor(history), []
    for k in range(0, 3000, 30):
        history.add(ticks(k, 30))
        seen += all_of(cursor)[LEFT_A][1].tolist()
    assert seen == [float(k) for k in range(3000)]
    assert (cursor.enveloped, cursor.lost) == (0, 0)
    assert cursor.frame() is None


def test_a_page_that_is_opened_later_gets_the_whole_history_row_by_row() -> None:
    history = History(DESCRIPTION)
    history.add(ticks(0, 5 * MAX_ROWS_PER_FRAME))
    cursor = Cursor(history)
    head, found = parsed(cursor.frame())
    assert found[LEFT_A].shape[1] == MAX_ROWS_PER_FRAME
    assert head["enveloped"] == 0
    rest = all_of(cursor)[LEFT_A]
    assert rest[1].tolist() == [float(k) for k in range(MAX_ROWS_PER_FRAME, 5 * MAX_ROWS_PER_FRAME)]


def test_a_slow_client_gets_an_envelope_that_has_every_peak() -> None:
    history = History(DESCRIPTION)
    cursor = Cursor(history)
    history.add(ticks(0, 10))
    all_of(cursor)
    wild = np.random.default_rng(1).normal(size=4000)
    wild[1234], wild[3333] = 99.0, -77.0
    history.add(slots(0, 0, [(5 * S + (10 + k) * S // 1000, x, 0) for k, x in enumerate(wild)]))
    head, found = parsed(cursor.frame())
    (part,) = head["parts"]
    assert (part["stands_for"], head["enveloped"], head["lost"]) == (4000, 4000, 0)
    columns = found[LEFT_A]
    assert columns.shape == (2, 2 * ENVELOPE_PAIRS)
    assert (columns[1].max(), columns[1].min()) == (99.0, -77.0)
    assert (np.diff(columns[0]) >= 0).all()
    assert (columns[0, 0], columns[0, -1]) == pytest.approx((0.010, 4.009))
    history.add(ticks(4010, 30))  # and from then on every row again
    head, found = parsed(cursor.frame())
    assert found[LEFT_A][1].tolist() == [float(k) for k in range(4010, 4040)]
    assert cursor.enveloped == 4000


def test_what_is_older_than_the_history_is_lost_and_counted() -> None:
    history = History(DESCRIPTION)
    cursor = Cursor(history)
    history.add(ticks(0, 10))
    all_of(cursor)
    late = round(2 * HISTORY_S * 1000)
    history.add(ticks(10, 1000))
    history.add(ticks(late, 5))
    seen = all_of(cursor)[LEFT_A][1].tolist()
    assert seen[-5:] == [float(k) for k in range(late, late + 5)]
    assert cursor.lost == 1000
    assert history.streams[LEFT_A].rows == 1015


def test_one_slow_client_changes_nothing_for_another() -> None:
    history = History(DESCRIPTION)
    slow, quick = Cursor(history), Cursor(history)
    seen = []
    for k in range(0, 5000, 50):
        history.add(ticks(k, 50))
        seen += all_of(quick)[LEFT_A][1].tolist()
    assert seen == [float(k) for k in range(5000)]
    assert slow.frame() is not None


def test_what_is_of_no_topic_is_counted_and_harms_nothing() -> None:
    history = History(DESCRIPTION)
    history.add(slots(7, 0, [(0,)]))
    history.add(slots(0, 9, [(5 * S, 1.0, 0)]))
    history.add(slots(0, 0, [(5 * S, 1.0, 0)], size=3))
    history.add(ticks(0, 1))
    assert history.not_understood == 3
    assert all_of(Cursor(history)).keys() == {LEFT_A}


@given(st.lists(st.floats(-1e9, 1e9) | st.just(float("nan")), min_size=1, max_size=200), st.integers(1, 20))
def test_an_envelope_keeps_the_extremes_and_the_ends(values: list[float], pairs: int) -> None:
    columns = np.array([np.arange(len(values), dtype=np.float64), values])
    made = envelope(columns, pairs)
    assert made.shape[1] <= max(2 * pairs, len(values))
    assert made[0, 0] == 0.0
    assert made[0, -1] == len(values) - 1
    assert np.fmin.reduce(made[1]) == pytest.approx(np.fmin.reduce(columns[1]), nan_ok=True)
    assert np.fmax.reduce(made[1]) == pytest.approx(np.fmax.reduce(columns[1]), nan_ok=True)
