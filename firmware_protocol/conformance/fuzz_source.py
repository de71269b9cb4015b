"""What the fuzzers feed: frames and packets that are right, nearly right, or nonsense. Same chance, same bytes."""

import random
from binascii import crc_hqx
from typing import Final, NamedTuple

from fastcrc.crc8 import autosar

from firmware_protocol import codec
from firmware_protocol.frames import Frame, arbitration_id
from firmware_protocol.layouts import LAYOUTS
from firmware_protocol.messages import ParamOp, ParamRequest
from firmware_protocol.parameters import Index
from firmware_protocol.serial_framing import FD_LENGTHS, MAX_FD_PAYLOAD_BYTES, encode_serial

NODE: Final = 1
SERIAL_NUMBER: Final = 0x5F0C_0000_0001
PROBE_EVERY: Final = 16  # chunks or frames between two good ones
MAX_PACKET_BYTES: Final = MAX_FD_PAYLOAD_BYTES + 5
GOOD: Final = codec.encode(ParamRequest(NODE, ParamOp.READ, Index.NODE, 0))
_LENGTHS: Final = sorted(FD_LENGTHS)


class Finding(AssertionError):  # noqa: N818 - a finding, not an error of the program
    """Something that must always hold did not; the text has the seed and the place."""


class Outcome(NamedTuple):
    """What a campaign did: bytes fed, good frames that had to be found among them, frames that got through."""

    bytes_in: int
    probes: int
    frames: int


def require(condition: bool, finding: str) -> None:
    """Raise Finding unless the condition holds."""
    if not condition:
        raise Finding(finding)


def mutated(chance: random.Random, data: bytes) -> bytes:
    """Return the bytes with a few of them changed, left out or repeated."""
    out = bytearray(data)
    for _ in range(chance.randrange(4)):
        at = chance.randrange(len(out)) if out else 0
        kind = chance.randrange(3)
        if kind == 0 and out:
            out[at] ^= 1 << chance.randrange(8)
        elif kind == 1 and out:
            del out[at]
        else:
            out[at:at] = out[at : at + chance.randrange(1, 9)]
    return bytes(out)


def random_frame(chance: random.Random) -> Frame:
    """Return a frame: any id and bytes, or one that is right but for a few bits, or right."""
    style = chance.randrange(4)
    is_fd = chance.random() < 0.3
    if style == 0:
        return Frame(chance.randrange(1 << 11), chance.randbytes(chance.choice(_LENGTHS)), is_fd)
    function = chance.choice(list(LAYOUTS))
    layout = LAYOUTS[function]
    identifier = arbitration_id(function, chance.choice((0, NODE, NODE, NODE, 30)))
    length = chance.choice(_LENGTHS) if layout.length < 0 or style == 1 else layout.length
    if layout.check is layout.check.CRC16 and length >= 2:
        body = chance.randbytes(length - 2)
        crc = crc_hqx(identifier.to_bytes(2, "little") + body, codec.CRC16_INIT)
        frame = Frame(identifier, body + crc.to_bytes(2, "little"), True)
    elif layout.check is layout.check.CRC8 and length >= 1:
        body = chance.randbytes(length - 1)
        frame = Frame(identifier, body + bytes((autosar(identifier.to_bytes(2, "little") + body),)))
    else:
        frame = Frame(identifier, chance.randbytes(length))
    return frame._replace(data=mutated(chance, frame.data)) if style == 2 else frame


def random_packet(chance: random.Random) -> bytes:
    """Return a packet of the serial line around such a frame, or a good one where it can be on none."""
    frame = random_frame(chance)
    fits = len(frame.data) in FD_LENGTHS if frame.is_fd else len(frame.data) <= 8
    return encode_serial(frame if fits else GOOD)
