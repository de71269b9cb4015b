"""The messages over Foxglove's protocol, by its SDK: `hil-forceps[foxglove]`.

Topics, schemas and bytes are those of a recording, so that one layout fits both. The SDK's server has no token and does
not check `Origin`: any page in a browser on this computer that finds it could read the data. Therefore its address in
127.0.0.0/8 and its port are random in each run, with 2**37 possibilities, and are printed to the user only. It accepts
no data from its clients.
"""

import secrets
from contextlib import suppress
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hil_forceps.live.description import Description

CDR_HEAD: Final = b"\x00\x01\x00\x00"  # little-endian, no options


class FoxgloveServer:
    """Server of the topics of one run. `address` is host:port. RuntimeError if it can't be started."""

    def __init__(self, description: Description) -> None:
        import foxglove  # noqa: PLC0415 - an optional extra, and heavy

        self._context = context = foxglove.Context()  # keeps the channels open
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
        """Send messages from the channel; those of unknown topics are dropped."""
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
    """Return a random loopback address: 24 bits, besides those of the port."""
    draw = secrets.randbelow
    return f"127.{draw(256)}.{draw(256)}.{1 + draw(254)}"
