"""The last seconds of every stream as columns, and the position of each client. No clock, no IO.

A stream is one topic of one axis. A client without backlog gets every row. A client with a backlog of more than
`MAX_BACKLOG_S` gets the rows of the backlog as an envelope: for each interval a row of minima and a row of maxima, so
that no peak is missed, and the number of rows that it replaces. Rows older than the history are lost to the client, and
counted.
"""

import json
import struct
from collections import deque
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.live.description import Description

HISTORY_S: Final = 60.0
MAX_BACKLOG_S: Final = 1.0
ENVELOPE_PAIRS: Final = 250  # of rows, for each backlog of one stream
MAX_ROWS_PER_FRAME: Final = 2_000  # of one stream in a frame; the rest is in the next frame
_HEAD: Final = struct.Struct("<II")

Columns = NDArray[np.float64]  # fields × rows


class Piece(NamedTuple):
    """Rows of one stream; `first` is the number of the first row since the beginning of the run."""

    first: int
    columns: Columns


class Stream:
    """The rows of one topic and axis that are still kept."""

    def __init__(self) -> None:
        self.pieces: deque[Piece] = deque()
        self.rows = 0  # so far

    @property
    def first(self) -> int:
        """Number of the oldest row that is kept."""
        return self.pieces[0].first if self.pieces else self.rows

    def add(self, columns: Columns) -> None:
        """Append rows, and drop those older than the history."""
        if not columns.shape[1]:
            return
        self.pieces.append(Piece(self.rows, columns))
        self.rows += columns.shape[1]
        oldest_s = columns[0, -1] - HISTORY_S
        while len(self.pieces) > 1 and self.pieces[0].columns[0, -1] < oldest_s:
            self.pieces.popleft()

    def since(self, row: int) -> list[Columns]:
        """Return the rows from `row` on."""
        found: list[Columns] = []
        for piece in reversed(self.pieces):
            if piece.first + piece.columns.shape[1] <= row:
                break
            found.append(piece.columns[:, max(0, row - piece.first) :])
        return found[::-1]


class History:
    """All streams of a description, in its order."""

    def __init__(self, description: Description) -> None:
        self._axes = len(description.axes)
        self._start_ns = description.start_ns
        self._dtypes = [topic.dtype for topic in description.topics]
        self._shown = [description.shown(topic) for topic in description.topics]
        self.streams = [Stream() for _ in range(len(self._dtypes) * self._axes)]
        self.not_understood = 0

    def add(self, slots: NDArray[np.void]) -> None:
        """Append messages of the channel to their streams; messages of unknown topics are counted."""
        known = (slots["topic"] < len(self._dtypes)) & (slots["axis"] < self._axes)
        for topic, dtype in enumerate(self._dtypes):
            known &= (slots["topic"] != topic) | (slots["size"] == dtype.itemsize)
        self.not_understood += int(np.count_nonzero(~known))
        for place, stream in enumerate(self.streams):
            topic, axis = divmod(place, self._axes)
            rows = slots[known & (slots["topic"] == topic) & (slots["axis"] == axis)]
            if len(rows):
                stream.add(self._columns(topic, rows))

    def _columns(self, topic: int, slots: NDArray[np.void]) -> Columns:
        dtype = self._dtypes[topic]
        data = np.ascontiguousarray(slots["data"]).view(np.uint8).reshape(len(slots), -1)
        rows = np.ascontiguousarray(data[:, : dtype.itemsize]).view(dtype)[:, 0]
        columns = np.array([rows[name] for name in self._shown[topic]], dtype=np.float64)
        columns[0] = (rows[self._shown[topic][0]] - self._start_ns) * 1e-9
        return columns


class Cursor:
    """Position of one client; `frame` continues from there."""

    def __init__(self, history: History) -> None:
        self._history = history
        self._rows = [stream.first for stream in history.streams]
        self._is_current = False  # was sent the whole history once
        self.enveloped = 0  # rows that were sent as an envelope
        self.lost = 0  # rows dropped before the client received them

    def frame(self) -> bytes | None:
        """Return the new rows as one binary message, None if there are none."""
        parts: list[dict[str, int]] = []
        blocks: list[bytes] = []
        is_rest = False
        for place, stream in enumerate(self._history.streams):
            gone = max(0, stream.first - self._rows[place])
            self.lost += gone
            self._rows[place] += gone
            pieces = stream.since(self._rows[place])
            if not pieces:
                continue
            columns = pieces[0] if len(pieces) == 1 else np.concatenate(pieces, axis=1)
            stands_for = 0
            if self._is_current and columns[0, -1] - columns[0, 0] > MAX_BACKLOG_S:
                stands_for = columns.shape[1]
                self._rows[place] = stream.rows
                columns = envelope(columns, ENVELOPE_PAIRS)
                self.enveloped += stands_for
            else:
                columns = columns[:, :MAX_ROWS_PER_FRAME]
                self._rows[place] += columns.shape[1]
                is_rest = is_rest or self._rows[place] < stream.rows
            parts.append({"stream": place, "rows": columns.shape[1], "stands_for": stands_for})
            blocks.append(np.ascontiguousarray(columns, dtype="<f8").tobytes())
        self._is_current = self._is_current or not is_rest
        if not parts:
            return None
        head = json.dumps({"parts": parts, "enveloped": self.enveloped, "lost": self.lost}).encode()
        head += b" " * (-(len(head) + _HEAD.size) % 8)  # doubles must be aligned to their size
        return b"".join((_HEAD.pack(1, len(head)), head, *blocks))


def envelope(columns: Columns, pairs: int) -> Columns:
    """Return alternating minima and maxima of each block of rows; their times are those of its first and last row."""
    rows = columns.shape[1]
    if rows <= 2 * pairs:
        return columns
    edges = np.linspace(0, rows, pairs + 1).astype(np.intp)[:-1]
    result = np.empty((columns.shape[0], 2 * pairs))
    result[:, 0::2] = np.fmin.reduceat(columns, edges, axis=1)
    result[:, 1::2] = np.fmax.reduceat(columns, edges, axis=1)
    return result
