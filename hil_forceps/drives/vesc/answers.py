"""A VESC's answers, put together from their fragments.

FILL_RX_BUFFER has an offset and up to seven bytes; PROCESS_RX_BUFFER ends an answer with who sent it, its length and
a CRC-16 over it (polynomial 1021h, from 0). Source: comm/comm_can.c, `comm_can_send_buffer`.
"""

import binascii
import struct
from typing import Final, NamedTuple

MAX_ANSWER_BYTES: Final = 255  # that one byte of offset reaches
_END: Final = struct.Struct(">BBHH")
_ANSWER: Final = 1  # second byte of PROCESS_RX_BUFFER: for the host, not to be processed


class Answer(NamedTuple):
    """An answer to this host."""

    node: int  # who sent it
    payload: bytes  # empty where it didn't come whole
    arrived_ns: int  # of its first fragment: the values were taken right before that was sent


class Answers:
    """Takes fragments in, gives answers out; one at a time, for fragments don't say whose they are."""

    def __init__(self, counters: dict[str, int]) -> None:
        """`counters`: those of the profile, with `torn_answers` among them."""
        self._counters = counters
        self._payload = b""
        self._arrived_ns = 0

    def fill(self, data: bytes, now_ns: int) -> None:
        """Take FILL_RX_BUFFER; what doesn't continue the bytes so far is counted, and they are forgotten."""
        if len(data) < 2 or len(data) > 8:
            self._tear()
        elif data[0] == 0:
            if self._payload:
                self._tear()
            self._payload, self._arrived_ns = data[1:], now_ns
        elif data[0] == len(self._payload) and data[0] + len(data) - 1 <= MAX_ANSWER_BYTES:
            self._payload += data[1:]
        else:
            self._tear()

    def process(self, data: bytes) -> Answer | None:
        """Take PROCESS_RX_BUFFER; return the answer that it ends, None for a frame that ends none."""
        payload, self._payload = self._payload, b""
        if len(data) != _END.size or data[1] != _ANSWER:
            self._counters["torn_answers"] += 1
            return None
        node, _, length, crc = _END.unpack(data)
        if length != len(payload) or crc != binascii.crc_hqx(payload, 0):
            self._counters["torn_answers"] += 1
            payload = b""
        return Answer(node, payload, self._arrived_ns)

    def _tear(self) -> None:
        self._counters["torn_answers"] += 1
        self._payload = b""
