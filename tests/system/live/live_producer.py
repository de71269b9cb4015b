"""A loop at 1 kHz that does nothing but tell of eight signals, with a live page beside it."""

import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from websockets.sync.client import ClientConnection, connect

from hil_forceps.live.channel import Writer
from hil_forceps.live.description import Code, Description, Field, Lane, Panel, Topic, Trace
from hil_forceps.live.view import LiveOptions, View, live_view

HOSTILE = "<script>window.bad=1</script><img src=x onerror=window.bad=1>"
PERIOD_NS = 1_000_000
SIGNALS = tuple(f"s{place}" for place in range(8))
FIELDS = (Field("int64", "t_ns"), *(Field("float64", name) for name in SIGNALS), Field("uint8", "state"))
TOPIC = Topic("/x", "t_ns", FIELDS, "test/X", "")


def described(title: str = "producer") -> Description:
    """Return a page of eight signals in four panels; every text of it is as hostile as the title."""
    word = title if title == HOSTILE else ""
    panels = tuple(
        Panel(f"panel {place} {word}", f"V {word}", 1.0,
              (Trace("/x", f"s{2 * place}", f"sine {word}"), Trace("/x", f"s{2 * place + 1}", f"count {word}", True)))
        for place in range(4)
    )  # fmt: skip
    codes = ((0, Code(f"off {word}", "off")), (1, Code(f"on {word}", "ok")))
    return Description(title, (word or "",), (TOPIC,), panels, (Lane("/x", "state", f"state {word}", codes),), 0)


class Producer:
    """Writes a row a millisecond until it is stopped; what it has written is known."""

    def __init__(self, view: View, word: str = "") -> None:
        self.view = view
        self.rows = 0
        self._word = word
        self._pack = TOPIC.record.pack
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        due_ns = time.monotonic_ns()
        while not self._is_over.is_set():
            while due_ns <= time.monotonic_ns():
                self._write(self.view.writer)
                due_ns += PERIOD_NS
            time.sleep(5e-4)

    def _write(self, writer: Writer) -> None:
        row = self.rows
        values = [math.sin(row / 100 + place) if place % 2 == 0 else float(row) for place in range(8)]
        writer.put(0, 0, self._pack(row * PERIOD_NS, *values, row // 500 % 2))
        self.rows = row + 1
        if row % 200 == 0:
            writer.post(status(self._word, stage="stopped" if writer.stop_asked() else "running", rows=row))

    def stop(self) -> None:
        """Write no more."""
        self._is_over.set()
        self._thread.join()


def status(word: str, *, stage: str, rows: int) -> dict[str, Any]:
    """Return a status as a service's, with a text of somebody else's in each place."""
    axis = {
        "name": word, "stage": stage, "reason": word, "message": word, "drive": word or "operational", "fault": word,
        "refusal": word, "gate": word or "open", "trip": word, "counters": {f"host {word}": {f"rows {word}": rows}},
    }  # fmt: skip
    return {"axes": [axis], "counters": {"loop": {"ticks": rows}}}


class Produced(NamedTuple):
    """A producer and how its page is reached."""

    producer: Producer
    address: str

    @property
    def token(self) -> str:
        """What the address carries behind #."""
        return self.address.partition("#")[2]

    @property
    def host(self) -> str:
        """Host and port."""
        return self.address.split("/")[2]

    @property
    def memory_writer(self) -> Writer:
        """The channel's writing end."""
        return self.producer.view.writer

    @contextmanager
    def client(self, **options: Any) -> Iterator[ClientConnection]:
        """Open a socket as the page does, token and all."""
        given = {"origin": f"http://{self.host}", "max_size": None, "compression": None, **options}
        with connect(f"ws://{self.host}/live", **given) as socket:
            socket.send(self.token)
            yield socket


@contextmanager
def produced(title: str = "producer", **options: Any) -> Iterator[Produced]:
    """Serve a page of eight signals at 1 kHz."""
    with live_view(described(title), LiveOptions(**options)) as view:
        producer = Producer(view, title if title == HOSTILE else "")
        try:
            yield Produced(producer, view.address)
        finally:
            producer.stop()
