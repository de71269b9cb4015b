"""The same messages over Foxglove's own protocol, by its SDK: `hil-forceps[foxglove]`.

Topics, schemas and bytes are those of a recording, so one layout serves both. The SDK's server asks for no token and
looks at no `Origin`: any page in a browser on this machine that finds it could read along. So it listens where none
looks, on an address in 127.0.0.0/8 and a port that are drawn anew for every run, 2**37 of them; nobody else is told.
It takes nothing from its clients.
"""

import secrets
from contextlib import suppress
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hil_forceps.live.description import Description

CDR_HEAD: Final = b"\x00\x01\x00\x00"  # little-endian, no options


class FoxgloveServer:
    """Serves the topics of one run. `address` is host:port. RuntimeError where none can be had."""

    def __init__(self, description: Description) -> None:
        import foxglove  # noqa: PLC0415 - an optional extra, and heavy

        self._context = context = foxglove.Context()  # channels close when it is gone
        self._topics = description.topics
        self._times = [topic.dtype.fields[topic.time][1] for topic in description.topics if topic.dtype.fields]
        self._channels = [
            [
                foxglove.Channel(
                    f"/{axis}{topic.name}" if axis else topic.name,
                    schema=foxglove.Schema(name=topic.schema_name, encoding="ros2msg", data=topic.schema.encode()),
                    message_encoding="cdr",
                    context=context,
                )
                for axis in description.axes
            ]
            for topic in description.topics
        ]
        host = hidden_host()
        self._server: Any = foxglove.start_server(
            name=description.title, host=host, port=0, capabilities=[], context=context
        )
        self.address = f"{host}:{self._server.port}"

    def send(self, slots: NDArray[np.void]) -> None:
        """Hand over messages as they came out of the channel; those of no topic are left out."""
        for slot in slots:
            topic, axis = int(slot["topic"]), int(slot["axis"])
            if topic >= len(self._channels) or axis >= len(self._channels[topic]):
                continue
            body = slot["data"].tobytes()[: int(slot["size"])]
            at = self._times[topic]
            time_ns = int.from_bytes(body[at : at + 8], "little", signed=True)
            self._channels[topic][axis].log(CDR_HEAD + body, log_time=max(time_ns, 0))

    def close(self) -> None:
        """Stop serving."""
        with suppress(RuntimeError):
            self._server.stop()


def hidden_host() -> str:
    """Return an address of this machine's own that nobody guesses: 24 bits, besides those of the port."""
    draw = secrets.randbelow
    return f"127.{draw(256)}.{draw(256)}.{1 + draw(254)}"
